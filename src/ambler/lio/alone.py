"""Where a LiDAR without an IMU may be when its prediction fails: between two scans nothing tells how it turned."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ambler.lio.state import FilterState, exp

TURNS = tuple(math.radians(a) for a in (0.0, 10.0, -10.0, 20.0, -20.0, 30.0, -30.0, 45.0, -45.0))


def turned_states(last: FilterState, prior: FilterState) -> Iterator[FilterState]:
    """Yield states at the last place and at the predicted one, turned about each of the LiDAR's axes."""
    axes = prior.imu_from_lidar[:, :3].T
    for state in (last, prior):
        yield replace(prior.copy(), position=state.position.copy(), rotation=state.rotation.copy())
        for axis, angle in itertools.product(axes[::-1], TURNS[1:]):
            turn = exp(angle * axis)
            yield replace(prior.copy(), position=state.position.copy(), rotation=state.rotation @ turn)
