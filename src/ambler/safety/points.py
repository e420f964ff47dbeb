"""Points around the robot for the protective field, straight from a sensor: no map, no filter, nothing shared with mapping."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan, PointCloud
from ambler.core.se3 import SE3

F64 = NDArray[np.float64]


def points_of_scan(scan: LaserScan, base_from_sensor: SE3) -> F64:
    """Return the returns of a planar scan in the base frame, float64 (N, 2)."""
    ranges = scan.ranges.astype(np.float64)
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    is_return = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    ranges, angles = ranges[is_return], angles[is_return]
    points = np.stack((ranges * np.cos(angles), ranges * np.sin(angles), np.zeros(len(ranges))), axis=1)
    return np.ascontiguousarray(base_from_sensor.transform(points)[:, :2])


def points_of_cloud(cloud: PointCloud, base_from_sensor: SE3, reach: float, z_band: tuple[float, float]) -> F64:
    """Return the points of a 3-D scan within `reach` metres and inside the height band above the floor, float64 (N, 2)."""
    x, y = cloud.points[:, 0], cloud.points[:, 1]
    near = cloud.points[x * x + y * y <= np.float32(reach * reach)]
    points = base_from_sensor.transform(near)
    is_in_band = (points[:, 2] >= z_band[0]) & (points[:, 2] <= z_band[1])
    return np.ascontiguousarray(points[is_in_band, :2])
