"""Grids that follow the map's geometry as it grows."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec

T = TypeVar("T", bound=np.generic)


def carried(grid: NDArray[T], old: GridSpec | None, new: GridSpec) -> NDArray[T]:
    """Return a grid [iy, ix] of a map's geometry in another one of the same lattice; what lies outside is lost, what is new is 0. Without an
    `old` geometry, or one of another resolution, all is 0."""
    moved: NDArray[Any] = np.zeros(new.shape, grid.dtype)
    if old is None or old.resolution != new.resolution:
        return moved
    dy, dx = old.offset_in(new)
    y0, y1 = max(0, dy), min(old.height + dy, new.height)
    x0, x1 = max(0, dx), min(old.width + dx, new.width)
    if y1 > y0 and x1 > x0:
        moved[y0:y1, x0:x1] = grid[y0 - dy : y1 - dy, x0 - dx : x1 - dx]
    return moved
