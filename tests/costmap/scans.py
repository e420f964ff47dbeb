"""Scans for costmaps that nobody has to look at."""

import math

import numpy as np

from ambler.core.messages import LaserScan


def empty_scan(frame: str, stamp_ns: int = 0) -> LaserScan:
    """A scan of 36 beams that saw nothing."""
    ranges, nothing = np.full(36, np.inf, np.float32), np.zeros(0, np.float32)
    return LaserScan(stamp_ns, frame, -math.pi, math.radians(10.0), 0.0, 0.1, 0.05, 10.0, ranges, nothing)
