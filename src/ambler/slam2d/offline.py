"""Runs 2-D SLAM over a whole log: the background work inline, a final optimization, and a pose for every scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from ambler.core.base_motion import STILL, BaseMotion
from ambler.core.grid import OCC_OCCUPIED, GridSpec
from ambler.core.se2 import SE2, wrap_angle
from ambler.recordings.log_scans import LogScan
from ambler.registration.planar_scan import PlanarScan
from ambler.slam2d.back_end import LoopConstraint
from ambler.slam2d.config import Slam2dConfig
from ambler.slam2d.slam import Slam2d

_METRES_PER_RADIAN = 1.0
_SAMPLE_STEP = 8
LONG_WAY = 100.0  # m without a loop closure that are worth a warning


@dataclass(frozen=True, slots=True, eq=False)
class OfflineResult:
    """`poses` float64 (N, 3): map_from_base of every scan; `occupancy` int8 [iy, ix] on `spec`; `points_on_walls_ratio` is the share of
    returns within one cell of an occupied cell; `loops` are the closures in the final graph, `way` the
    metres driven, and `is_converged` says whether the last solution of the graph came to an end."""

    poses: NDArray[np.float64]
    spec: GridSpec
    occupancy: NDArray[np.int8]
    loop_closures: int
    nodes: int
    submaps: int
    points_on_walls_ratio: float
    loops: tuple[LoopConstraint, ...]
    way: float = 0.0
    is_converged: bool = True

    def warnings(self) -> list[str]:
        """Return what whoever uses the map should know, in words."""
        out = []
        if not self.loop_closures and self.way > LONG_WAY:
            out.append(f"no loop closure in {self.way:.0f} m: the map may be bent")
        if not self.is_converged:
            out.append("the graph of poses did not converge: the map is not the best that the scans give")
        return out


def run_offline(
    scans: Iterable[LogScan], config: Slam2dConfig | None = None, on_scan: Callable[[], None] | None = None
) -> OfflineResult:
    """Map all scans; `on_scan` is called after each."""
    slam, motion = Slam2d(config), BaseMotion()
    local: list[SE2] = []
    newest_node: list[int] = []
    samples: list[PlanarScan] = []
    for item in scans:
        for stamp_ns, odom_from_base in item.odometry:
            slam.add_odometry(stamp_ns, odom_from_base)
            motion.add_pose(stamp_ns, odom_from_base)
        twist = slam.twist(item.stamp_ns, item.duration) if item.duration > 0.0 else STILL
        scan = item.to_planar(motion.sweep(item.stamp_ns, item.duration, twist))
        local.append(slam.update(scan).local_from_base)
        newest_node.append(slam.nodes - 1)
        samples.append(replace(scan, points=scan.points[::_SAMPLE_STEP].copy(), free_points=scan.free_points[:0]))
        work = slam.take_background_work()
        if work is not None:
            slam.commit(work())
        if on_scan is not None:
            on_scan()
    slam.finish()
    poses = np.array([_global_pose(slam, pose, k).as_array() for pose, k in zip(local, newest_node, strict=True)])
    spec, occupancy = slam.render_map()
    poses = poses.reshape(-1, 3)
    agreement = points_on_walls(samples, poses, spec, occupancy)
    way = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    return OfflineResult(
        *(poses, spec, occupancy, slam.loop_closures, slam.nodes, slam.submaps, agreement, slam.loop_constraints()),
        *(way, slam.is_converged),
    )


def points_on_walls(
    scans: list[PlanarScan], poses: NDArray[np.float64], spec: GridSpec, occupancy: NDArray[np.int8]
) -> float:
    """Return the share of returns, placed by the final poses (N, 3), that lie within one cell of an occupied cell.

    What is missing to 1 are people, returns from glass and poses that do not fit the map.
    """
    near_wall = binary_dilation(occupancy == OCC_OCCUPIED, np.ones((3, 3), bool))
    on_wall = total = 0
    for scan, pose in zip(scans, poses, strict=True):
        cells = spec.cells_of(SE2.from_array(pose).transform(scan.points))
        inside = ((cells >= 0) & (cells < spec.shape)).all(axis=1)
        iy, ix = cells[inside].T
        on_wall += int(near_wall[iy, ix].sum())
        total += len(cells)
    return on_wall / total if total else 0.0


def _global_pose(slam: Slam2d, local_from_base: SE2, k: int) -> SE2:
    """Carry a scan's local pose into the map by the nodes before and after it, weighted by their nearness."""
    if k < 0:
        return local_from_base
    before = slam.map_from_node(k) @ (slam.local_from_node(k).inverse() @ local_from_base)
    if k + 1 >= slam.nodes:
        return before
    after = slam.map_from_node(k + 1) @ (slam.local_from_node(k + 1).inverse() @ local_from_base)
    to_before = _separation(slam.local_from_node(k), local_from_base)
    to_after = _separation(slam.local_from_node(k + 1), local_from_base)
    return before.interpolate(after, to_before / max(to_before + to_after, 1e-9))


def _separation(a: SE2, b: SE2) -> float:
    return a.distance_to(b) + _METRES_PER_RADIAN * abs(wrap_angle(a.yaw - b.yaw))
