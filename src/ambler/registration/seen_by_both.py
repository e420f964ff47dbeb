"""Which returns of a scan lie where a grid was looked at from the same side: only of these does it say whether they fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels.submap import EVEN
from ambler.registration.cell_grid import CellGrid

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
B = NDArray[np.bool_]

AHEAD = 0.4  # metres in front of a return that a grid must know too: a wall that was seen from behind only is another surface
HERE = np.zeros((1, 2), np.int64)
AROUND = np.array(
    [(x, y) for x in (-2, 0, 2) for y in (-2, 0, 2)]
)  # cells of which one must be known: beams leave gaps


def seen_by_both(grid: CellGrid, points: F32, origin: tuple[float, float], grid_from_base: SE2) -> B:
    """Return (N,) which points (N, 2) of the base frame, seen from `origin`, lie in cells that the grid knows, and before which it knows the way too."""
    rays = points - np.array(origin)
    away = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), AHEAD)
    before = points - rays * (AHEAD / away)[:, None]
    return _is_known(grid, grid_from_base.transform(points), HERE) & _is_known(
        grid, grid_from_base.transform(before), AROUND
    )


def contradiction(grid: CellGrid, points: F32, origin: tuple[float, float], grid_from_base: SE2) -> float:
    """Return the share of a scan's points that lie where the grid looked from the same side and saw nothing stand; of a new view it knows nothing."""
    is_seen = seen_by_both(grid, points, origin, grid_from_base)
    resolution, x, y = grid.frame.tolist()
    ix, iy = np.floor((grid_from_base.transform(points[is_seen]) - (x, y)) / resolution).astype(np.int64).T
    return float(np.count_nonzero(grid.cells[iy, ix] <= EVEN)) / max(len(points), 1)


def _is_known(grid: CellGrid, points: F64, around: NDArray[np.int64]) -> B:
    resolution, x, y = grid.frame.tolist()
    height, width = grid.cells.shape
    cells = np.floor((points - (x, y)) / resolution).astype(np.int64)[:, None, :] + around
    ix, iy = cells[..., 0], cells[..., 1]
    inside = (ix >= 0) & (iy >= 0) & (ix < width) & (iy < height)
    known = grid.cells[np.where(inside, iy, 0), np.where(inside, ix, 0)] != 0
    return np.asarray((known & inside).any(axis=1))
