"""What a frontier is worth: the unknown area visible from its goal. And the coarse costs that distances between goals need."""

import math

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit

I64 = NDArray[np.int64]


@jit
def _is_thick_unknown(occupancy: NDArray[np.int8], iy: int, ix: int) -> bool:
    """Tell whether a cell and its 4-neighbours are unknown: slivers one or two cells thick are not."""
    return bool(
        occupancy[iy, ix] < 0
        and (iy == 0 or occupancy[iy - 1, ix] < 0)
        and (ix == 0 or occupancy[iy, ix - 1] < 0)
        and (iy == occupancy.shape[0] - 1 or occupancy[iy + 1, ix] < 0)
        and (ix == occupancy.shape[1] - 1 or occupancy[iy, ix + 1] < 0)
    )


@jit
def visible_unknown(
    occupancy: NDArray[np.int8],
    free_below: int,
    resolution: float,
    max_range: float,
    rays: int,
    cells: I64,
    area: NDArray[np.float64],
    heading: NDArray[np.float64],
) -> None:
    """Integrate the unknown area (square metres) that is visible from each cell, and the heading of its centre of mass.

    Slivers one or two cells thick, as noise leaves them along walls, do not count. Rays end at cells that are known and not free; unknown cells are transparent. Each step of one cell along a ray
    stands for an area of r * dr * dtheta, so no cell needs to be marked. Cells of -1 give 0.
    """
    height, width = occupancy.shape
    steps = int(max_range / resolution)
    dtheta = 2.0 * math.pi / rays
    for k in range(len(cells)):
        area[k] = 0.0
        heading[k] = 0.0
        if cells[k] < 0:
            continue
        y0 = cells[k] // width + 0.5
        x0 = cells[k] % width + 0.5
        mx, my, total = 0.0, 0.0, 0.0
        for i in range(rays):
            c, s = math.cos(i * dtheta), math.sin(i * dtheta)
            along = 0.0
            for r in range(1, steps + 1):
                iy = int(math.floor(y0 + r * s))
                ix = int(math.floor(x0 + r * c))
                if iy < 0 or ix < 0 or iy >= height or ix >= width:
                    break
                if _is_thick_unknown(occupancy, iy, ix):
                    along += r
                elif occupancy[iy, ix] >= free_below:
                    break
            total += along
            mx += along * c
            my += along * s
        area[k] = total * dtheta * resolution * resolution
        heading[k] = math.atan2(my, mx)


@jit
def shrink_costs(costs: NDArray[np.uint8], factor: int, out: NDArray[np.uint8]) -> None:
    """Shrink a cost grid: each coarse cell takes the least cost of its `factor` x `factor` cells."""
    height, width = costs.shape
    for iy in range(out.shape[0]):
        for ix in range(out.shape[1]):
            least = 255
            for y in range(iy * factor, min((iy + 1) * factor, height)):
                for x in range(ix * factor, min((ix + 1) * factor, width)):
                    least = min(least, costs[y, x])
            out[iy, ix] = least


@jit
def spread_distances(
    coarse: NDArray[np.float32], factor: int, costs: NDArray[np.uint8], limit: int, out: NDArray[np.float32]
) -> None:
    """Give each fine cell the distance of the coarse cell that holds it, inf where its cost is `limit` or more."""
    height, width = costs.shape
    for iy in range(height):
        cy = iy // factor
        for ix in range(width):
            out[iy, ix] = coarse[cy, ix // factor] if costs[iy, ix] < limit else np.inf


def warm_up() -> None:
    """Compile every kernel with its real dtypes; grids that come from messages are read-only."""
    occupancy = np.full((4, 4), -1, np.int8)
    occupancy.flags.writeable = False
    costs = np.zeros((4, 4), np.uint8)
    costs.flags.writeable = False
    visible_unknown(occupancy, 50, 0.1, 0.4, 8, np.zeros(1, np.int64), np.empty(1), np.empty(1))
    shrink_costs(costs, 2, np.empty((2, 2), np.uint8))
    spread_distances(np.zeros((2, 2), np.float32), 2, costs, 253, np.empty((4, 4), np.float32))
