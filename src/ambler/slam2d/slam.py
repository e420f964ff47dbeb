"""2-D SLAM as one object: scans in, poses, covariance, health and map out. The background work is separable (see `BackEnd`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.registration.planar_scan import PlanarScan
from ambler.slam2d.back_end import BackEnd, JobResult, LoopConstraint
from ambler.slam2d.config import Slam2dConfig
from ambler.slam2d.extrapolator import PoseExtrapolator
from ambler.slam2d.front_end import FrontEnd
from ambler.slam2d.renderer import MapRenderer, PlacedSubmap

_COVARIANCE_FLOOR = (0.005, 0.001)
FINAL_ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Slam2dResult:
    """One scan's outcome. `map_from_odom` is smooth (corrections of loop closures arrive gradually) and `map_from_base` belongs to
    it; `covariance` float64 (3, 3) of (x, y, yaw) of this match; `node` is the new node's number when the scan was inserted."""

    stamp_ns: int
    map_from_base: SE2
    map_from_odom: SE2
    odom_from_base: SE2
    local_from_base: SE2
    covariance: NDArray[np.float64]
    score: float
    inlier_ratio: float
    degeneracy: float
    node: int | None
    finished_submap: int | None


class Slam2d:
    """Builds a map from planar scans and, when present, odometry and a gyroscope."""

    def __init__(self, config: Slam2dConfig | None = None) -> None:
        self.config = config or Slam2dConfig()
        self._extrapolator = PoseExtrapolator()
        self._front_end = FrontEnd(self.config.front_end)
        self._back_end = BackEnd(self.config.loop, self.config.graph, self.config.front_end.point_sigma)
        self._renderer = MapRenderer(self.config.render)
        self._last_ns: int | None = None
        self._node_ns: int | None = None
        self._smooth = SE2()
        self.map_version = 0

    @property
    def submaps(self) -> int:
        """How many submaps there are."""
        return len(self._back_end.submaps)

    @property
    def nodes(self) -> int:
        """How many scans were inserted."""
        return len(self._back_end.nodes)

    @property
    def loop_closures(self) -> int:
        """How many loop closures hold."""
        return self._back_end.loop_closures

    @property
    def is_converged(self) -> bool:
        """Whether the last solution of the graph came to an end."""
        return self._back_end.is_converged

    def add_odometry(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Take one odometry pose."""
        self._extrapolator.add_odometry(stamp_ns, odom_from_base)

    def add_imu(self, stamp_ns: int, wz: float) -> None:
        """Take one yaw rate (rad/s) in the base frame."""
        self._extrapolator.add_imu(stamp_ns, wz)

    def add_heading(self, stamp_ns: int, yaw: float) -> None:
        """Take one heading (rad) of odometry that is fused with a gyroscope; instead of `add_imu`."""
        self._extrapolator.add_heading(stamp_ns, yaw)

    def twist(self, stamp_ns: int, duration: float) -> NDArray[np.float64]:
        """Return the body twist (vx, vy, wz) expected from an instant on, for the motion compensation of a scan."""
        return self._extrapolator.twist(stamp_ns, duration)

    def update(self, scan: PlanarScan, *, may_insert: bool = True) -> Slam2dResult:
        """Match, insert and add one scan to the graph; where its pose is in doubt it must not be inserted. Stamps must increase."""
        local = self._front_end.update(scan, self._extrapolator.predict(scan.stamp_ns), may_insert=may_insert)
        self._extrapolator.add_matched(scan.stamp_ns, local.local_from_base, None if local.submaps else self._node_ns)
        node = None
        if local.submaps:
            node = len(self._back_end.nodes)
            self._back_end.add(local, self._odometry_since_node(scan.stamp_ns))
            self._node_ns = scan.stamp_ns
            self.map_version += 1
        map_from_local = self._smoothed(scan.stamp_ns)
        self._last_ns = scan.stamp_ns
        map_from_base = map_from_local @ local.local_from_base
        odom_from_base = self._extrapolator.odom_from_base(scan.stamp_ns) or local.local_from_base
        match = local.match
        covariance = np.diag([0.01, 0.01, 0.01])
        if match is not None:
            covariance = match.covariance(self.config.front_end.point_sigma, _COVARIANCE_FLOOR)
            c, s = math.cos(map_from_local.yaw), math.sin(map_from_local.yaw)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            covariance = turn @ covariance @ turn.T
        return Slam2dResult(
            scan.stamp_ns,
            map_from_base,
            map_from_base @ odom_from_base.inverse(),
            odom_from_base,
            local.local_from_base,
            covariance,
            match.score if match else 0.0,
            match.inlier_ratio if match else 0.0,
            match.degeneracy if match else 0.0,
            node,
            local.finished.index if local.finished else None,
        )

    def take_background_work(self) -> Callable[[], JobResult] | None:
        """Return a pure job on snapshots when there is one; run it anywhere and `commit` its result. One at a time."""
        return self._back_end.take_work()

    def commit(self, result: JobResult) -> None:
        """Apply the result of a background job."""
        self._back_end.commit(result)
        self.map_version += 1

    def final_work(self) -> Iterator[Callable[[], JobResult]]:
        """Yield the jobs that search what still waits, then many nodes again and again until that moves the map no more; `commit` each result
        before the next is taken."""
        yield from self._waiting_work()
        for _ in range(FINAL_ROUNDS):
            before = self._back_end.moves
            self._back_end.queue_final()
            yield from self._waiting_work()
            if self._back_end.moves == before:
                break

    def _waiting_work(self) -> Iterator[Callable[[], JobResult]]:
        return iter(lambda: self._back_end.take_work(is_final=True), None)

    def finish(self) -> None:
        """Do all final work at once; for the end of a recording."""
        for work in self.final_work():
            self.commit(work())

    def render_map(self) -> tuple[GridSpec, NDArray[np.int8]]:
        """Return the map's geometry and occupancy int8 [iy, ix] (-1 unknown, 0 free, 100 occupied)."""
        back_end = self._back_end
        return self._renderer.render([PlacedSubmap(s, back_end.submap_pose(s)) for s in back_end.submaps])

    def loop_constraints(self) -> tuple[LoopConstraint, ...]:
        """Return the loop closures that hold now, as relations between scans."""
        return self._back_end.loop_constraints()

    def map_from_node(self, index: int) -> SE2:
        """Return the optimized pose of a node."""
        return self._back_end.graph.pose(self._back_end.nodes[index].vertex)

    def stamp_of_node(self, index: int) -> int:
        """Return the stamp of a node's scan."""
        return self._back_end.nodes[index].stamp_ns

    def points_of_node(self, index: int) -> NDArray[np.float32]:
        """Return the points of a node's scan by which it was matched, float32 (N, 2) in the base frame."""
        return self._back_end.nodes[index].match_points

    def local_from_node(self, index: int) -> SE2:
        """Return a node's pose in the local frame, as it was matched."""
        return self._back_end.nodes[index].local_from_base

    def _odometry_since_node(self, stamp_ns: int) -> SE2 | None:
        if self._node_ns is None:
            return None
        return self._extrapolator.odometry_motion(self._node_ns, stamp_ns)

    def _smoothed(self, stamp_ns: int) -> SE2:
        """Let the published map_from_local follow the optimized one with a time constant."""
        target = self._back_end.map_from_local()
        if self._last_ns is None:
            self._smooth = target
        else:
            dt = (stamp_ns - self._last_ns) * 1e-9
            self._smooth = self._smooth.interpolate(target, 1.0 - math.exp(-dt / self.config.correction_time))
        return self._smooth
