"""What a bag offers, chosen by what is unambiguous: the only topic of a kind, the usual frames, and poses from transforms."""

from __future__ import annotations

import math
from dataclasses import replace

from ambler.core.errors import BadInputError, TransformError, TransformLoopError
from ambler.core.messages import Message, PointCloud, Transforms
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.core.transforms import TransformTree
from ambler.wire.bags import BagReader

BASE_FRAMES = ("base_link", "base_footprint", "base")
TRUTH = "/ground_truth/"
ODOM_FRAME = "odom"
FIXED_FRAMES = (ODOM_FRAME, "map", "world", "camera_init")  # the last is what LOAM and its heirs call the map
_SHORTEST_ROTATION = 1e-3
_ROTATION_TOLERANCE = 1e-2  # what rounding to float32 and a little carelessness leave; such rotations stay as they are
HISTORY = 1e9  # seconds: transforms of a recording are not forgotten

Track = list[tuple[int, SE2]]
"""Poses of the base under odometry by their stamps (ns)."""


def choose_topic(bag: BagReader, kind: type[Message], name: str | None, option: str) -> str | None:
    """Return the topic of a kind that is wanted, or the only one with messages; None without any. What a simulation recorded of the truth
    is no choice unless it is named, nor are clouds that somebody has laid into a fixed frame beside one of a sensor."""
    found = sorted(t.name for t in bag.topics() if t.message_class is kind and t.count > 0)
    if name is None:
        found = [topic for topic in found if not topic.startswith(TRUTH)]
    else:
        if name not in found:
            raise BadInputError(
                f"{bag.path}: {option} {name}: no {kind.__name__} there, only on {', '.join(found) or 'no topic'}"
            )
        return name
    if len(found) > 1 and kind is PointCloud:
        found = [topic for topic in found if _frame_of(bag, topic) not in FIXED_FRAMES] or found
    if len(found) > 1:
        raise BadInputError(f"{bag.path}: {kind.__name__} on several topics, choose with {option}: {', '.join(found)}")
    return found[0] if found else None


def _frame_of(bag: BagReader, topic: str) -> str:
    message = next(bag.messages({topic})).message
    return plain_frame(message.frame) if isinstance(message, PointCloud) else ""


def listed_topics(bag: BagReader) -> str:
    return ", ".join(f"{t.name} ({t.ros_type})" for t in bag.topics())


def plain_frame(frame: str) -> str:
    """Return a frame's name without the slash that it may begin with in ROS 1."""
    return frame.lstrip("/")


def usable_pose(pose: SE3) -> SE3 | None:
    """Return a recorded pose with a rotation of length one, or None where a number is not finite or the rotation is zero."""
    length = math.hypot(*pose.rotation)
    if not math.isfinite(length + sum(pose.translation)) or length < _SHORTEST_ROTATION:
        return None
    if abs(length - 1.0) < _ROTATION_TOLERANCE:
        return pose
    w, x, y, z = pose.rotation
    return replace(pose, rotation=(w / length, x / length, y / length, z / length))


class RecordedFrames:
    """The transforms of a recording. Those that are no poses, or would hang a frame under itself, are left out and counted."""

    def __init__(self) -> None:
        self._tree = TransformTree(HISTORY)
        self._without_pose = 0
        self._loops: dict[tuple[str, str], int] = {}
        self._odometry: dict[str, Track] = {}

    def add(self, message: Transforms, *, is_static: bool) -> None:
        """Take the edges of a message; of a frame under two parents the first one holds."""
        for edge in message.transforms:
            parent, child = plain_frame(edge.parent), plain_frame(edge.child)
            pose = usable_pose(edge.parent_from_child)
            if pose is None:
                self._without_pose += 1
                continue
            if parent == ODOM_FRAME and child != ODOM_FRAME:
                track = self._odometry.setdefault(child, [])
                if not track or track[-1][0] != edge.stamp_ns:  # our own recordings repeat the newest of every edge
                    track.append((edge.stamp_ns, pose.to_se2()))
            try:
                if is_static:
                    self._tree.set_static(parent, child, pose)
                else:
                    self._tree.set(parent, child, edge.stamp_ns, pose)
            except TransformLoopError:
                self._loops[parent, child] = self._loops.get((parent, child), 0) + 1
            except TransformError:
                continue

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out, in words."""
        loops = [
            f"left out: {count} transforms {parent} -> {child}, which would hang {child!r} under itself"
            for (parent, child), count in self._loops.items()
        ]
        if self._without_pose:
            loops.append(f"left out: {self._without_pose} transforms that are no pose (not finite, or no rotation)")
        return tuple(loops)

    def odometry_track(self) -> tuple[str | None, Track]:
        """Return the base frame and its poses under `odom`; the base by its usual names, else the only child."""
        for base in BASE_FRAMES:
            if base in self._odometry:
                return base, self._odometry[base]
        if len(self._odometry) == 1:
            return next(iter(self._odometry.items()))
        return None, []

    def lookup(self, target: str, source: str, stamp_ns: int | None = None) -> SE3:
        """Return target_from_source at a time, or the newest; raises TransformError."""
        return self._tree.lookup(plain_frame(target), plain_frame(source), stamp_ns)
