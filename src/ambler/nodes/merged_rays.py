"""Joins the merged cloud with the rays that met nothing, for those who draw free space: each ray from its own scanner, where it was then."""

from __future__ import annotations

import numpy as np

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError
from ambler.core.messages import PointCloud
from ambler.core.robot import RobotModel
from ambler.perception.planar import PlanarConfig, merged_to_points
from ambler.registration.planar_scan import PlanarScan


class MergedRays:
    """`add_free` comes before `to_planar` of the same stamp; a cloud without its free rays proves nothing free beyond its returns."""

    def __init__(self, robot: RobotModel, config: PlanarConfig) -> None:
        self._offsets = np.array([mount.base_from_sensor.translation[:2] for mount in robot.scanners])
        self._config = config
        self._free: PointCloud | None = None

    def add_free(self, free: PointCloud) -> None:
        """Take the rays that met nothing."""
        self._free = free

    def to_planar(self, cloud: PointCloud, motion: BaseMotion) -> PlanarScan:
        """Return all rays of one merged scan; without odometry of its time, all start where the scanners are at the stamp."""
        free = self._free if self._free is not None and self._free.stamp_ns == cloud.stamp_ns else None
        first_ns = cloud.stamp_ns + round(float(cloud.time.min(initial=0.0)) * 1e9)
        try:
            twist = motion.twist_over(first_ns, cloud.stamp_ns) if first_ns < cloud.stamp_ns else np.zeros(3)
        except StaleInputError:
            twist = np.zeros(3)
        return merged_to_points(cloud, free, self._offsets, twist, self._config)
