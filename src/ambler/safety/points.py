"""Points around the robot for the protective field, straight from a sensor: no map, nothing shared with mapping.

Of a cloud, means of small patches count: of the thousands of returns of a wall close by, the nearest two lie 4 cm before it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan, PointCloud
from ambler.core.se3 import SE3
from ambler.kernels import gate_points as kernels
from ambler.kernels.blind import bridge
from ambler.kernels.floor_walk import RING, SECTORS, heights_over, walk_floor
from ambler.safety.floor_memory import FloorMemory

F64 = NDArray[np.float64]

PATCH = (math.radians(0.5), 0.05)  # azimuth and distance from the sensor that share one mean
FLOOR_GAP = 0.5  # metres without floor across which a slope goes on: from under the robot to where its scanner sees
STANDING, ABOVE_LOWEST = (
    1.4,
    math.radians(5.0),
)  # metres, and angle above the lowest beam: who is seen there stands on the floor
SOME = 13  # no divisor of a scanner's number of rings
GAP, GAP_STEP = 0.15, 0.05  # metres between remembered points that nothing passes through, and that are left open
PATCHES_BEHIND = 3  # patches behind a lone return within which a surface makes it that surface's noise


@dataclass(slots=True)
class Floor:
    """A floor that rises by at most `slope` (m per m) within `reach` metres of a robot. `under` (m): the robot's own reach; `lean`: how it leans, as rise per metre along x and y;
    `memory`: what was seen before of it, and `odom_from_level`: where the level base is."""

    slope: float
    reach: float
    under: float
    lean: tuple[float, float]
    memory: FloorMemory
    odom_from_level: SE3
    _heights: F64 = field(init=False)

    def __post_init__(self) -> None:
        self._heights = np.zeros((SECTORS, math.ceil(self.reach / RING)))

    def find(self, points: F64) -> None:
        """Find the floor in points (N, 3), level base frame, and in what is remembered."""
        together = np.concatenate((points, self.memory.update(points, self.odom_from_level, self.under)))
        walk_floor(together, self.slope, FLOOR_GAP, self.under, np.array(self.lean), self._heights)

    def heights(self, points: F64) -> F64:
        """Return how high points (N, 3), level base frame, are over the floor below them, float64 (N,)."""
        out = np.empty(len(points))
        heights_over(points, self._heights, out)
        return out

    def holds(self, points: F64, within: float) -> NDArray[np.bool_]:
        """Say which points (N, 3), level base frame, lie `within` metres of the floor, above or below it. What lies lower is none: behind a robot that has climbed away from it, floor
        may not be known, and the last height that was found is told instead."""
        return np.asarray(np.abs(self.heights(points)) < within)


def has_measured(scan: LaserScan | PointCloud) -> bool:
    """Whether a scanner tells anything, if only that nothing is near: no returns but NaN, or none at all, say nothing about what stands there."""
    if isinstance(scan, PointCloud):
        return bool(np.isfinite(scan.points).any())
    return bool((scan.ranges >= scan.range_min).any())  # also inf; NaN is not


def points_of_scan(scan: LaserScan, base_from_sensor: SE3, twist: F64) -> F64:
    """Return the returns of a planar scan in the base frame of its stamp, float64 (N, 3); `twist` (vx, vy, wz) of the base."""
    ranges = scan.ranges.astype(np.float64)
    beam = np.arange(len(ranges), dtype=np.float64)
    is_return = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    ranges, beam = ranges[is_return], beam[is_return]
    angles = scan.angle_min + beam * scan.angle_increment
    points = np.stack((ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(len(ranges))), axis=1)
    return carried_to_stamp(base_from_sensor.transform(points), scan.time_increment * beam, twist)


def points_of_cloud(
    cloud: PointCloud,
    sweep: Sequence[SE3],
    twist: F64,
    reach: float,
    z_band: tuple[float, float],
    floor: Floor | None = None,
    lowest: float = -0.5 * math.pi,
) -> F64:
    """Return the points of a 3-D scan within `reach` metres of the sensor and inside the height band above the floor, float64
    (N, 3), in the base frame of the stamp. `sweep` is where the sensor was in a level base, free of the body's lean, at equal times from
    the scan's first point to its last. `floor`: heights count from a floor that may slope (None: it is level). `lowest` (rad) is the elevation of the lowest
    beam: of somebody behind a scanner that is tilted forwards only the trunk is seen, so what it meets above the band is in the way as well."""
    poses, n = np.stack([pose.matrix()[:3] for pose in sweep]), len(cloud.points)
    points, times, is_lowest = np.empty((n, 3)), np.empty(n), np.empty(n, np.bool_)
    sine = math.sin(lowest + ABOVE_LOWEST) if lowest > -0.5 * math.pi else -math.inf
    read = (np.ascontiguousarray(cloud.points, np.float32), np.ascontiguousarray(cloud.time, np.float32))
    count = kernels.near_points(*read, poses, reach, sine, points, times, is_lowest)
    points = points[:count]
    heights = points[:, 2].copy()
    if floor is not None:
        floor.find(points)
        heights = floor.heights(points)
    out = np.empty((count, 3))
    return out[: kernels.standing_points(points, times, heights, is_lowest, z_band, STANDING, twist, out)]


def some_of_cloud(cloud: PointCloud, sweep: Sequence[SE3], twist: F64) -> F64:
    """Return every `SOME`-th return of a cloud, whatever it met and however far, float64 (N, 3), as `points_of_cloud` does."""
    some = slice(None, None, SOME)
    few = replace(
        cloud,
        points=cloud.points[some],
        intensity=cloud.intensity[some],
        time=cloud.time[some],
        ring=cloud.ring[some],
    )
    return points_of_cloud(few, sweep, twist, math.inf, (-math.inf, math.inf))


def patch_means(points: F64, origin: tuple[float, float]) -> F64:
    """Return the mean of every patch of the points (N, 3) seen from `origin` (x, y), float64 (M, 3).

    A lone return counts, unless a surface of several returns lies close behind it: then it is that surface's noise.
    """
    out = np.empty((len(points), 3))
    return out[: kernels.patch_means(np.ascontiguousarray(points, np.float64), origin, PATCH, PATCHES_BEHIND, out)]


def bridged(unseen: F64, seen: F64) -> F64:
    """Return points (N, 3) that a scanner has seen before with more between them and their neighbours, also among what it sees now (M, 3), where they
    stand less than `GAP` apart: what is remembered of a low thing was met by a ring here and by another one there, and a corner of a robot would fit between."""
    together = np.concatenate((unseen, seen))
    neighbours = 3 * len(together)  # at most, in a plane
    out = np.empty((neighbours * math.ceil(GAP / GAP_STEP), 3))
    return np.concatenate((unseen, out[: bridge(together, len(unseen), GAP, GAP_STEP, out)]))


def pulled_nearer(points: F64, by: float, normals: F64, offsets: F64) -> F64:
    """Return points (N, 2 or 3) moved `by` metres, level, towards the base at the origin, but none into its footprint (`normals` (E, 2), `offsets`
    (E,) of its edges): what lies deep inside of that is the robot itself."""
    gaps = (points[:, :2] @ normals.T - offsets).max(axis=1, initial=-np.inf)
    ranges = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-9)
    out = points.copy()
    out[:, :2] *= (1.0 - np.clip(gaps, 0.0, by) / ranges)[:, None]
    return out


def carried_to_stamp(points: F64, times: F64, twist: F64) -> F64:
    """Move points (N, 3), each seen from the base of its own time (N,) in seconds after the stamp, to the base of the stamp.

    To second order in the angle, which is small over one scan.
    """
    angle = twist[2] * times
    cos, sin = 1.0 - 0.5 * angle * angle, angle
    out = points.copy()
    out[:, 0] = cos * points[:, 0] - sin * points[:, 1] + (twist[0] - 0.5 * angle * twist[1]) * times
    out[:, 1] = sin * points[:, 0] + cos * points[:, 1] + (twist[1] + 0.5 * angle * twist[0]) * times
    return out
