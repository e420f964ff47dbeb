"""The transform tree: edges over time, interpolated on request; errors name the missing edge or the missing time."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

from ambler.core.errors import TransformError, TransformLoopError
from ambler.core.se3 import SE3


class _Edge:
    __slots__ = ("child_times", "is_static", "parent", "poses")

    def __init__(self, parent: str, is_static: bool) -> None:
        self.parent = parent
        self.is_static = is_static
        self.child_times: deque[int] = deque()
        self.poses: deque[SE3] = deque()


class TransformTree:
    """Holds `parent_from_child` edges for `history` seconds and composes them along the tree."""

    def __init__(self, history: float = 10.0, max_extrapolation: float = 0.25) -> None:
        self._edges: dict[str, _Edge] = {}
        self._history_ns = int(history * 1e9)
        self._max_extrapolation_ns = int(max_extrapolation * 1e9)

    def set_static(self, parent: str, child: str, parent_from_child: SE3) -> None:
        """Fix an edge for all times. Raises TransformError if the frames would hang under each other."""
        self._refuse_loop(parent, child)
        edge = _Edge(parent, is_static=True)
        edge.child_times.append(0)
        edge.poses.append(parent_from_child)
        self._edges[child] = edge

    def set(self, parent: str, child: str, stamp_ns: int, parent_from_child: SE3) -> None:
        """Add an edge's pose at a time; times must not decrease, an equal time replaces the last pose.

        Raises TransformError if the child already hangs under another parent, or the frames would hang under each other.
        """
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent:
            self._refuse_loop(parent, child)
        if edge is None:
            edge = self._edges[child] = _Edge(parent, is_static=False)
        elif edge.parent != parent:
            raise TransformError(f"{child} already hangs under {edge.parent}, cannot hang it under {parent}")
        times = edge.child_times
        if times and stamp_ns <= times[-1]:
            if stamp_ns == times[-1]:
                edge.poses[-1] = parent_from_child
            return
        times.append(stamp_ns)
        edge.poses.append(parent_from_child)
        while times[0] < stamp_ns - self._history_ns:
            times.popleft()
            edge.poses.popleft()

    def lookup(self, target: str, source: str, stamp_ns: int | None = None) -> SE3:
        """Return `target_from_source` at a time, or the newest when no time is given.

        Raises TransformError naming the missing edge, or the edge whose time range does not reach the instant.
        """
        up_source = self._chain(source)
        up_target = self._chain(target)
        common = next((f for f in up_source if f in set(up_target)), None)
        if common is None:
            raise TransformError(
                f"no connection from {source} to {target}: {up_source[-1]} and {up_target[-1]} share no parent"
            )
        common_from_source = self._descend(up_source, common, stamp_ns)
        common_from_target = self._descend(up_target, common, stamp_ns)
        return common_from_target.inverse() @ common_from_source

    def newest_ns(self, child: str) -> int | None:
        """Return the newest time of the edge above `child`, or None if there is none."""
        edge = self._edges.get(child)
        return None if edge is None else edge.child_times[-1]

    def _refuse_loop(self, parent: str, child: str) -> None:
        """Raise TransformError if `parent` is the child or hangs under it, at whatever depth."""
        if parent == child:
            raise TransformLoopError(f"{child} cannot hang under itself")
        if child in self._chain(parent):
            raise TransformLoopError(f"{child} cannot hang under {parent}, which hangs under it already")

    def _chain(self, frame: str) -> list[str]:
        chain = [frame]
        while chain[-1] in self._edges:
            chain.append(self._edges[chain[-1]].parent)
        return chain

    def _descend(self, chain: list[str], common: str, stamp_ns: int | None) -> SE3:
        pose = SE3()
        for child in chain:
            if child == common:
                return pose
            pose = self._at(child, stamp_ns) @ pose
        raise AssertionError("common frame is always on the chain")

    def _at(self, child: str, stamp_ns: int | None) -> SE3:
        edge = self._edges[child]
        times, poses = edge.child_times, edge.poses
        if edge.is_static or stamp_ns is None:
            return poses[-1]
        if stamp_ns >= times[-1]:
            if stamp_ns - times[-1] > self._max_extrapolation_ns:
                raise TransformError(
                    f"{edge.parent}_from_{child} ends {(stamp_ns - times[-1]) * 1e-9:.3f} s before the wanted time"
                )
            return poses[-1]
        if stamp_ns < times[0]:
            if times[0] - stamp_ns > self._max_extrapolation_ns:
                raise TransformError(
                    f"{edge.parent}_from_{child} begins {(times[0] - stamp_ns) * 1e-9:.3f} s after the wanted time"
                )
            return poses[0]
        k = bisect_right(times, stamp_ns)
        t0, t1 = times[k - 1], times[k]
        return poses[k - 1].interpolate(poses[k], (stamp_ns - t0) / (t1 - t0))
