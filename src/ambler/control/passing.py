"""How movers look to local planners: discs on their ways, set off to their own right, so that robots pass them on the right.

Two who meet each keep to the right and have the other at their left. So the side of a walker that a robot shall leave alone is his right.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.movers import Movers

F64 = NDArray[np.float64]

RADIUS = 0.33  # metres: a person and what his place is uncertain by; GROWTH in m/s
GROWTH = 0.1
ASIDE = 0.2  # metres by which the disc of somebody who walks is set off to his right
WALKING = 0.3  # m/s


def passing_discs(movers: Movers, seconds: float) -> F64:
    """Return float64 (K, 6) of (x, y, vx, vy, radius, growth) in the odom frame, for movers `seconds` after their instant."""
    states = movers.states
    rows = np.empty((len(states), 6))
    if len(states) == 0:
        return rows
    velocity = states[:, 2:4]
    speed = np.hypot(*velocity.T)[:, None]
    right = np.stack((velocity[:, 1], -velocity[:, 0]), axis=1) / np.maximum(speed, 1e-9)
    rows[:, :2] = states[:, :2] + seconds * velocity + ASIDE * right * (speed >= WALKING)
    rows[:, 2:4] = velocity
    rows[:, 4], rows[:, 5] = RADIUS, GROWTH
    return rows
