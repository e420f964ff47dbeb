"""Which returns of a scan lie where a grid was looked at from the same side: only of these does it say whether they fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.registration.cell_grid import CellGrid

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
B = NDArray[np.bool_]

AHEAD = 0.25  # metres in front of a return that a grid must know too: a wall that was seen from behind only is another surface


def seen_by_both(grid: CellGrid, points: F32, origin: tuple[float, float], grid_from_base: SE2) -> B:
    """Return (N,) which points (N, 2) of the base frame, seen from `origin`, lie in cells that the grid knows, and before which it knows the way too."""
    rays = points - np.array(origin)
    away = np.maximum(np.hypot(rays[:, 0], rays[:, 1]), AHEAD)
    before = points - rays * (AHEAD / away)[:, None]
    return _is_known(grid, grid_from_base.transform(points)) & _is_known(grid, grid_from_base.transform(before))


def _is_known(grid: CellGrid, points: F64) -> B:
    resolution, x, y = grid.frame.tolist()
    height, width = grid.cells.shape
    ix, iy = ((points - (x, y)) / resolution).astype(np.int64).T
    inside = (points[:, 0] >= x) & (points[:, 1] >= y) & (ix < width) & (iy < height)
    out = np.zeros(len(points), np.bool_)
    out[inside] = grid.cells[iy[inside], ix[inside]] != 0
    return out
