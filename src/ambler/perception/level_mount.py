"""A sensor on a body that leans: where it was all through a sweep, seen from a base that stays level.

A walking body turns by a degree or two within one turn of its scanner. One lean for the whole turn would put floor that is 10 m away
0.3 m too high, where it looks like a wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import LEVEL, BaseMotion, lean_of
from ambler.core.errors import StaleInputError
from ambler.core.se3 import SE3

F64 = NDArray[np.float64]

LEAN_STEP = 0.01  # seconds between two leans of a sweep: a walking body turns by a tenth of a degree meanwhile


@dataclass(frozen=True, slots=True, eq=False)
class LevelMount:
    """Where a sensor of a leaning body was during a sweep, in a base that stays level: float64 (K, 3, 4), `step` seconds apart."""

    matrices: F64
    step: float

    @property
    def origin(self) -> tuple[float, float]:
        """Where it was at the stamp."""
        return float(self.matrices[0, 0, 3]), float(self.matrices[0, 1, 3])


Mount = SE3 | LevelMount


def level_mount(base_from_sensor: SE3, motion: BaseMotion, stamp_ns: int, seconds: float) -> Mount:
    """Return where a sensor was during a sweep that began at `stamp_ns`, as the body leaned; the mount itself while the body is level, or while
    nothing is known of it."""
    if motion.is_level(stamp_ns, stamp_ns + round(max(seconds, LEAN_STEP) * 1e9)):
        return base_from_sensor
    steps = max(1, math.ceil(seconds / LEAN_STEP))
    step = max(seconds, LEAN_STEP) / steps
    try:
        leans = [lean_of(motion.pose_at(stamp_ns + round(k * step * 1e9))) for k in range(steps + 1)]
    except StaleInputError:
        return base_from_sensor
    if all(lean == LEVEL for lean in leans):
        return base_from_sensor
    return LevelMount(np.stack([matrix_of(SE3((0.0, 0.0, 0.0), lean) @ base_from_sensor) for lean in leans]), step)


def matrix_of(base_from_sensor: SE3) -> F64:
    """Return the upper part of the homogeneous transform, float64 (3, 4)."""
    return np.ascontiguousarray(base_from_sensor.matrix()[:3])
