"""A scanner that repeats itself: the same bits again and again while the robot moves cannot be a measurement."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle


class StuckScan:
    """Watches one scanner. Standing still proves nothing, and neither does an empty scan: a perfect one may repeat both."""

    def __init__(self, travel: float = 0.02, turn: float = 0.02) -> None:
        self._travel = travel
        self._turn = turn
        self._values: NDArray[np.floating[Any]] | None = None
        self._odom_from_base = SE2()

    def update(self, values: NDArray[np.floating[Any]], odom_from_base: SE2) -> bool:
        """Take a scan's ranges or points and the pose of its moment; return whether the scanner is stuck."""
        last = self._values
        if last is None or values.tobytes() != last.tobytes() or not np.isfinite(values).any():
            self._values, self._odom_from_base = values, odom_from_base
            return False
        has_moved = self._odom_from_base.distance_to(odom_from_base) > self._travel
        return has_moved or abs(wrap_angle(odom_from_base.yaw - self._odom_from_base.yaw)) > self._turn
