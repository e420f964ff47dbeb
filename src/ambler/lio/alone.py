"""Where a LiDAR without an IMU may be when its prediction fails: between two scans nothing tells how it turned."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ambler.core.messages import PointCloud
from ambler.lio.state import FilterState, exp

# Angles about an axis between two scans that are tried, besides none.
TURNS = tuple(math.radians(a) for a in (10.0, -10.0, 20.0, -20.0, 30.0, -30.0, 45.0, -45.0))
MOVES = 0.4  # metres between two places that are tried
SPEED_MOST = 45.0  # m/s that anybody goes: a car on a fast road
RATE_MOST = 2.0 * math.pi  # rad/s that anybody turns


def turned_states(last: FilterState, prior: FilterState, seconds: float) -> Iterator[FilterState]:
    """Yield states at the last place and at the predicted one, turned about each of the LiDAR's axes as far as one turns in so many seconds."""
    turns = [angle for angle in TURNS if abs(angle) <= RATE_MOST * seconds]
    axes = prior.imu_from_lidar[:, :3].T
    for state in (last, prior):
        yield replace(prior.copy(), position=state.position.copy(), rotation=state.rotation.copy())
        for axis, angle in itertools.product(axes[::-1], turns):
            yield replace(prior.copy(), position=state.position.copy(), rotation=state.rotation @ exp(angle * axis))


def moved_states(prior: FilterState, seconds: float) -> Iterator[FilterState]:
    """Yield states moved from the prior along the LiDAR's first two axes, both ways, as far as one goes in so many seconds."""
    count = int(SPEED_MOST * seconds / MOVES)
    for axis, k in itertools.product(prior.imu_from_lidar[:, :2].T, range(-count, count + 1)):
        if k:
            yield replace(prior.copy(), position=prior.position + k * MOVES * (prior.rotation @ axis))


def at_one_instant(cloud: PointCloud) -> PointCloud:
    """Return a cloud all of whose points were taken at its stamp."""
    return replace(cloud, time=np.zeros_like(cloud.time))
