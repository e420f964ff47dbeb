"""What nodes need to judge ultrasonic echoes: the base's poses, the newest returns of every scanner, and the filter itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import StaleInputError
from ambler.core.messages import LaserScan, Odometry, Range
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.perception.echoes import Echo, EchoFilter
from ambler.perception.glass import SpecularDetector
from ambler.perception.planar import PlanarConfig, scan_to_points

NEAR = PlanarConfig(range_min=0.0, range_max=4.5)


@dataclass(frozen=True, slots=True)
class PlacedEcho:
    """A judged echo with the base's pose in the odom frame at its stamp."""

    echo: Echo
    odom_from_base: SE2


class RangeView:
    """Judges measurements as they come. Scans are given as messages, or as points in the odom frame by whoever has them."""

    def __init__(self, robot: RobotModel) -> None:
        self._mounts = {m.frame: m.base_from_sensor for m in robot.sensors}
        self._filter = EchoFilter(robot)
        self._detector = SpecularDetector()
        self._motion = BaseMotion()
        self._twist = np.zeros(3)
        self._points: dict[str, NDArray[np.float64]] = {}

    def add_odometry(self, odometry: Odometry) -> None:
        """Take a pose of the base and its velocity."""
        self._motion.add(odometry)
        self._twist = np.array([odometry.linear[0], odometry.linear[1], odometry.angular[2]])

    @property
    def twist(self) -> NDArray[np.float64]:
        """The newest velocity of the base, (vx, vy, wz)."""
        return self._twist

    def pose_at(self, stamp_ns: int) -> SE2:
        """Return odom_from_base at a time; raises StaleInputError when odometry does not reach there."""
        return self._motion.planar_at(stamp_ns)

    def add_scan(self, scan: LaserScan) -> None:
        """Take a scanner's newest scan in place of its last one. What it sees of panes does not explain their echoes."""
        try:
            odom_from_base = self.pose_at(scan.stamp_ns)
        except StaleInputError:
            return  # without a pose the scan explains nothing, so echoes count
        planar = scan_to_points(self._detector.without_panes(scan), self._mounts[scan.frame], self._twist, NEAR)
        self.add_points(scan.frame, odom_from_base.transform(planar.points))

    def add_points(self, source: str, points_odom: NDArray[np.float64]) -> None:
        """Take a source's newest returns (N, 2) in place of its last ones."""
        self._points[source] = points_odom

    def judge(self, measured: Range) -> PlacedEcho | None:
        """Return what a measurement says, None for nothing; of a moment without odometry nothing can be said."""
        try:
            odom_from_base = self.pose_at(measured.stamp_ns)
        except StaleInputError:
            return None
        base_from_odom = odom_from_base.inverse()
        laser_base = [base_from_odom.transform(points) for points in self._points.values()]
        echo = self._filter.update(measured, odom_from_base, laser_base)
        return None if echo is None else PlacedEcho(echo, odom_from_base)
