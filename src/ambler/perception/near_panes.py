"""Panes of glass close to the robot, as far as it could touch them, from scan after scan without any map.

Light shows 24° of a pane, where it is met squarely: 6 cm to either side from 0.3 m. A corner of the robot comes to where no beam returns from, so a pane is taken on to both sides:
up to a post, to what was seen to be open while the robot passed, or as far as the robot reaches.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.glass import SpecularConfig, SpecularDetector, SpecularPeak, upright
from ambler.perception.glass_map import GlassMap, GlassMapConfig, twist_of_sensor

F64 = NDArray[np.float64]
FLATTEST = 1.4  # radians off the normal up to which the line of a pane is followed
STEP = 0.04  # metres between the points of a pane
EDGE = 0.03  # metres; what shines no wider is the edge of a pane: it goes on to no side
FADE_TRAVEL = 1.0  # metres of travel in which half of what was seen is forgotten: odometry drifts
PASSED = GlassMapConfig(
    bin=0.05, disproof=1.0, believed=1.0, contradiction_range=2.0
)  # what is open beside panes, to 5 cm


class NearPanes:
    """Tells the panes within `near` metres of a scanner, each up to `reach` metres to either side of where it is met squarely. What scanners of one robot see of openings they share."""

    def __init__(self, near: float, reach: float, config: SpecularConfig | None = None) -> None:
        self._detector = SpecularDetector(config)
        self._near, self._reach = near, reach
        self._passed = GlassMap(PASSED)
        self._last: SE2 | None = None
        self._travel = 0.0

    def look(self, scan: LaserScan, odom_from_base: SE2, base_from_sensor: SE3, twist: F64) -> list[tuple[float, F64]]:
        """Return for each pane the time of its beam, seconds after the scan's stamp, and points (N, 2) along it in the scanner's frame at that time; `odom_from_base`: where the base was at the
        scan's stamp, `twist` (vx, vy, wz): its velocity."""
        self._advance(odom_from_base)
        mount, standing = base_from_sensor.to_se2(), upright(scan, base_from_sensor)
        sensor_twist = twist_of_sensor(mount, twist)
        begun = (standing.stamp_ns - scan.stamp_ns) * 1e-9
        odom_from_sensor = odom_from_base @ mount @ SE2.exp(sensor_twist * begun)
        self._passed.add_scan(standing, odom_from_sensor, sensor_twist)
        found = []
        for peak in self._detector.detect(standing):
            if peak.distance < self._near and peak.right + peak.left > EDGE:
                later = peak.beam * standing.time_increment
                there = odom_from_sensor @ SE2.exp(sensor_twist * later)
                self._passed.add_peak(peak, there)
                flat = self._up_to_openings(
                    peak, spread(standing, peak, self._reach, self._detector.config.tolerance), there
                )
                found.append((begun + later, flat if standing is scan else flat * (1.0, -1.0)))
        return found

    def _advance(self, odom_from_base: SE2) -> None:
        if self._last is not None:
            self._travel += self._last.distance_to(odom_from_base)
        self._last = odom_from_base
        while self._travel >= FADE_TRAVEL:
            self._travel -= FADE_TRAVEL
            self._passed.fade()

    def _up_to_openings(self, peak: SpecularPeak, flat: F64, odom_from_sensor: SE2) -> F64:
        """What shines now stays, whatever was seen before."""
        is_open = self._passed.is_open(peak, odom_from_sensor, odom_from_sensor.transform(flat))
        along = (flat - peak.foot) @ peak.along
        last = np.min(along[is_open & (along > peak.left)], initial=math.inf)
        first = np.max(along[is_open & (along < -peak.right)], initial=-math.inf)
        return np.asarray(flat[(along > first) & (along < last)])


def spread(scan: LaserScan, peak: SpecularPeak, reach: float, tolerance: float) -> F64:
    """Return points (N, 2) in the sensor frame, `STEP` apart, along a pane, up to `reach` metres to either side of the beam that meets it squarely, or
    up to the first return beside the pane's own that lies on its line: a post, where it may end."""
    ranges = np.asarray(scan.ranges, np.float64)
    off = (scan.angle_min + np.arange(len(ranges)) * scan.angle_increment - peak.angle + math.pi) % (
        2.0 * math.pi
    ) - math.pi
    line = peak.distance / np.cos(np.clip(off, -FLATTEST, FLATTEST))
    along = peak.distance * np.tan(np.clip(off, -FLATTEST, FLATTEST))
    is_on_line = (np.abs(off) < FLATTEST) & (np.abs(ranges - line) <= tolerance)
    left = np.min(along[is_on_line & (along > peak.left + STEP)], initial=reach)
    right = np.min(-along[is_on_line & (-along > peak.right + STEP)], initial=reach)
    t = np.arange(-right, left + 0.5 * STEP, STEP)
    return np.asarray(peak.foot + t[:, None] * peak.along)
