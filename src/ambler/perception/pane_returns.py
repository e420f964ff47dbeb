"""Which returns are those of panes of glass: they walk along the pane beside a robot that drives, as somebody would who keeps step with it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan
from ambler.core.se2 import SE2
from ambler.perception.glass import SpecularConfig, SpecularDetector

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]
# Metres from the line of a pane, and beyond where it can shine: the scans of several scanners are not of one instant.
BESIDE, BEYOND = 0.08, 0.1
AGE_NS = 300_000_000


class PaneReturns:
    """Remembers what the newest scan of each scanner shows of panes."""

    def __init__(self, config: SpecularConfig | None = None) -> None:
        self._detector = SpecularDetector(config)
        self._seen: dict[str, tuple[int, F64]] = {}

    def may_shine(self, intensity: NDArray[np.floating]) -> bool:
        """Say whether any return, (N,), is bright enough to be one of a pane."""
        return bool(np.any(intensity >= self._detector.config.intensity_min))

    def look(self, scan: LaserScan, odom_from_sensor_at: Callable[[int], SE2]) -> None:
        """Take a raw scan, and where its scanner was at a stamp (ns). Raises what that raises."""
        pieces = []
        for peak in self._detector.detect(scan, is_seen_through=False):
            pose = odom_from_sensor_at(scan.stamp_ns + round(peak.beam * scan.time_increment * 1e9))
            reach = peak.distance * math.tan(self._detector.config.pane_angle) + BEYOND
            pieces.append(pose.transform(peak.foot + np.array([[-reach], [reach]]) * peak.along))
        self._seen[scan.frame] = (scan.stamp_ns, np.array(pieces).reshape(-1, 2, 2))

    def include(self, points: F64, stamp_ns: int) -> Bools:
        """Say which points (N, 2) of the odom frame, measured about `stamp_ns`, lie on what shone. bool (N,)."""
        found = np.zeros(len(points), np.bool_)
        for seen_ns, pieces in self._seen.values():
            if abs(stamp_ns - seen_ns) <= AGE_NS:
                for a, b in pieces:
                    along = (b - a) / np.hypot(*(b - a))
                    off = points - a
                    s, beside = off @ along, off @ (-along[1], along[0])
                    found |= (s >= 0.0) & (s <= np.hypot(*(b - a))) & (np.abs(beside) <= BESIDE)
        return found
