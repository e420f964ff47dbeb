"""Probability grids of the room and of the corridor, filled from known poses."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.grids.probability_grid import Inserter, InsertionConfig, ProbabilityGrid
from tests.registration.room import CORRIDOR, WALLS, random_pose, scan_at

F64 = NDArray[np.float64]


# The room lies aslant in its grid: a wall along the lattice would appear in the middle of its cells, up to half a cell off,
# while the walls of a turned one cross their cells anywhere and the errors cancel.
GRID_FROM_ROOM = SE2(0.31, -0.17, 0.37)


def grid_of(
    poses: list[SE2], walls: F64 = WALLS, range_max: float = 30.0, grid_from_room: SE2 = GRID_FROM_ROOM
) -> ProbabilityGrid:
    """Return the grid of ideal scans from poses in the room."""
    inserter, grid = Inserter(InsertionConfig()), ProbabilityGrid(0.05, (0.0, 0.0), 12.0)
    for pose in poses:
        scan, at = scan_at(pose, 0, walls, range_max=range_max), grid_from_room @ pose
        inserter.insert(grid, np.array([at.x, at.y]), at.transform(scan.points).astype(np.float32), scan.free_points)
    return grid


@lru_cache(maxsize=1)
def room_grid() -> ProbabilityGrid:
    """Return the room, seen from 40 places; shared, not to be changed."""
    rng = np.random.default_rng(7)
    return grid_of([random_pose(rng) for _ in range(40)])


@lru_cache(maxsize=1)
def corridor_grid() -> ProbabilityGrid:
    """Return the corridor, seen every 25 cm with a range of 6 m; shared, not to be changed."""
    return grid_of([SE2(x, 0.1, 0.03) for x in np.arange(-4.0, 4.0, 0.25)], CORRIDOR, 6.0, SE2())
