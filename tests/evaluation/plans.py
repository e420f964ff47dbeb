"""Small floor plans for the tests of this folder."""

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2


def office(resolution: float = 0.05) -> tuple[GridSpec, NDArray[np.int8]]:
    """Three rooms of 6 x 4 m and a corridor, walls one cell thick, unknown outside: spec and int8 [iy, ix]."""

    def cells(metres: float) -> int:
        return round(metres / resolution)

    spec = GridSpec(resolution, cells(14.0), cells(10.0), -3.0, -2.0)
    grid = np.full(spec.shape, -1, np.int8)
    x0, x1, y0, y1 = cells(1.0), cells(13.0), cells(1.0), cells(8.0)
    grid[y0 : y1 + 1, x0 : x1 + 1] = 0
    grid[[y0, y1], x0 : x1 + 1] = 100
    grid[y0 : y1 + 1, [x0, x1]] = 100
    middle = cells(5.0)
    grid[middle, x0 : x1 + 1] = 100
    for wall in (cells(5.5), cells(9.0)):
        grid[y0:middle, wall] = 100
    for door in (cells(2.5), cells(7.0), cells(11.0)):
        grid[middle, door : door + cells(0.9)] = 0
    grid[cells(2.0) : cells(2.6), cells(3.0) : cells(3.8)] = 100
    return spec, grid


def moved(
    spec: GridSpec, grid: NDArray[np.int8], motion: SE2, margin: float = 2.0
) -> tuple[GridSpec, NDArray[np.int8]]:
    """Draw a map again in a frame that is moved: other_from_map = motion; nearest neighbour, unknown outside."""
    wide = GridSpec(
        spec.resolution,
        spec.width + round(2 * margin / spec.resolution),
        spec.height + round(2 * margin / spec.resolution),
        spec.origin_x - margin,
        spec.origin_y - margin,
    )
    every = np.argwhere(np.ones(wide.shape, np.bool_))
    back = spec.cells_of(motion.inverse().transform(wide.centers_of(every)))
    inside = (back >= 0).all(axis=1) & (back[:, 0] < spec.height) & (back[:, 1] < spec.width)
    out = np.full(len(every), -1, np.int8)
    out[inside] = grid[back[inside, 0], back[inside, 1]]
    return wide, out.reshape(wide.shape)
