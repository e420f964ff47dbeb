"""What a frontier is worth: the unknown area visible from its goal. And the coarse costs that distances between goals need."""

import math

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit

I64 = NDArray[np.int64]
SAMPLES, SPREAD = 7, 20  # cells that stand for a frontier, so far at most from its middle
BEYOND = 1 << 30  # cells: no limit
EVERY, BEHIND = 3, 8  # cells between viewpoints that are tried, and behind a frontier, of which half must be unknown


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
    surfaces: NDArray[np.uint8],
    free_below: int,
    resolution: float,
    max_range: float,
    rays: int,
    cells: I64,
    sides: NDArray[np.uint8],
    area: NDArray[np.float64],
    heading: NDArray[np.float64],
) -> None:
    """Integrate the unknown area (square metres) that is visible from each cell, and the heading of its centre of mass.

    Slivers one or two cells thick, as noise leaves them along walls, do not count. Rays end at cells that are known and not free, and at `surfaces` [iy, ix] that have a bit of their cell's `sides` (those
    from which it looks); unknown cells are transparent. Each step of one cell along a ray
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
                if surfaces[iy, ix] & sides[k]:
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
def _in_sight(occupancy, drivable, free_below, y, x, samples, reach):
    """How many cells of a frontier, and unknown ones behind them, are in sight from (y, x)."""
    count = 0
    for cell in samples:
        count += _unknown_behind(occupancy, drivable, free_below, y, x, cell, reach) >= BEHIND // 2
    return count


@jit
def _unknown_behind(occupancy, drivable, free_below, y, x, cell, reach):
    """How many cells of unknown a ray from (y, x) shows in the `BEHIND` cells behind a frontier cell (flat index) within `reach` (cells, from and to), 0 when anything but free cells
    lies before it."""
    height, width = occupancy.shape
    ty, tx = cell // width - y, cell % width - x
    length = math.hypot(ty, tx)
    if not reach[0] <= length <= reach[1]:
        return 0
    before, count = int(length), 0
    for k in range(1, before + BEHIND + 1):
        iy, ix = int(math.floor(y + 0.5 + ty * k / length)), int(math.floor(x + 0.5 + tx * k / length))
        if iy < 0 or ix < 0 or iy >= height or ix >= width:
            break
        value = occupancy[iy, ix]
        if value >= free_below:
            return 0 if k <= before else count
        if drivable[iy, ix] < 0 and k < before - 1:
            return 0
        count += value < 0
    return count


@jit
def viewpoints(
    occupancy: NDArray[np.int8],
    drivable: NDArray[np.int8],
    free_below: int,
    distance: NDArray[np.float32],
    diy: int,
    dix: int,
    cells: I64,
    starts: I64,
    worth_it: NDArray[np.bool_],
    recedes: NDArray[np.bool_],
    base: tuple[int, int],
    reach: tuple[int, int],
    goals: I64,
    heading: NDArray[np.float64],
) -> None:
    """Move the goal of each group that is worth it and has one to the nearest place, in metres of `distance` (indexed [iy + diy, ix + dix]), from where `reach` (cells, from and to) away half of its
    cells and unknown ones behind them are in sight, with the heading to it; groups without such a place keep their goal,
    and those that `recede` and are in sight of the robot's cell `base` (iy, ix) from there or farther away: it drives towards them.

    `drivable` is `occupancy` with what is only assumed to be free: a look passes there. Group g is cells[starts[g]:starts[g + 1]]; `SAMPLES` of its cells around its middle stand for all, and places are tried every `EVERY` cells.
    """
    height, width = occupancy.shape
    near, far = reach
    samples = np.empty(SAMPLES, np.int64)
    for g in range(len(starts) - 1):
        if goals[g] < 0 or not worth_it[g]:
            continue
        count = _samples_around_middle(cells, starts[g], starts[g + 1], width, samples)
        if recedes[g]:
            now = _in_sight(occupancy, drivable, free_below, base[0], base[1], samples[:count], (near, BEYOND))
            if 2 * now >= count:
                continue
        my, mx = samples[0] // width, samples[0] % width
        best = np.float32(np.inf)
        for iy in range(max(0, my - far), min(height, my + far + 1), EVERY):
            for ix in range(max(0, mx - far), min(width, mx + far + 1), EVERY):
                cy, cx = iy + diy, ix + dix
                if not near <= math.hypot(iy - my, ix - mx) <= far or drivable[iy, ix] < 0:
                    continue
                if cy < 0 or cx < 0 or cy >= distance.shape[0] or cx >= distance.shape[1] or distance[cy, cx] >= best:
                    continue
                if 2 * _in_sight(occupancy, drivable, free_below, iy, ix, samples[:count], reach) >= count:
                    best = distance[cy, cx]
                    goals[g] = iy * width + ix
                    heading[g] = math.atan2(my - iy, mx - ix)


@jit
def in_sight_from(occupancy, drivable, free_below, cells, base, near, out):
    """Say of each cell of a frontier (flat indices), in `out` bool (N,), whether it and unknown ones behind it are in sight from the cell `base` (iy, ix), `near` cells away or farther."""
    for i in range(len(cells)):
        behind = _unknown_behind(occupancy, drivable, free_below, base[0], base[1], cells[i], (near, BEYOND))
        out[i] = behind >= BEHIND // 2


@jit
def _samples_around_middle(cells, first, end, width, samples):
    """Write the cell of a group (cells[first:end], flat indices) that lies next to its mean, and others within `SPREAD` cells of it, into `samples`; returns how many."""
    my, mx = 0.0, 0.0
    for k in range(first, end):
        my += cells[k] // width / (end - first)
        mx += cells[k] % width / (end - first)
    least = np.inf
    for k in range(first, end):
        away = math.hypot(cells[k] // width - my, cells[k] % width - mx)
        if away < least:
            least = away
            samples[0] = cells[k]
    near = 0
    for k in range(first, end):
        near += _apart(cells[k], samples[0], width) <= SPREAD
    stride, seen, count = max(1, near // (len(samples) - 1)), 0, 1
    for k in range(first, end):
        if _apart(cells[k], samples[0], width) > SPREAD:
            continue
        if seen % stride == stride // 2 and count < len(samples):
            samples[count] = cells[k]
            count += 1
        seen += 1
    return count


@jit
def _apart(cell, other, width):
    """Distance of two cells (flat indices), in cells."""
    return math.hypot(cell // width - other // width, cell % width - other % width)


@jit
def shrink_costs(costs: NDArray[np.uint8], factor: int, out: NDArray[np.uint8]) -> None:
    """Shrink a cost grid: each coarse cell takes the least cost of its `factor` x `factor` cells."""
    height, width = costs.shape
    line = np.empty(width, np.uint8)
    for iy in range(out.shape[0]):
        line[:] = 255
        for y in range(iy * factor, min((iy + 1) * factor, height)):
            row = costs[y]
            for k in range(np.uint64(width)):
                line[k] = min(line[k], row[k])
        for ix in range(out.shape[1]):
            least = line[ix * factor]
            for x in range(ix * factor + 1, min((ix + 1) * factor, width)):
                least = min(least, line[x])
            out[iy, ix] = least


@jit
def spread_distances(
    coarse: NDArray[np.float32], factor: int, costs: NDArray[np.uint8], limit: int, out: NDArray[np.float32]
) -> None:
    """Give each fine cell the distance of the coarse cell that holds it, inf where its cost is `limit` or more."""
    height, width = costs.shape
    line = np.empty(
        width, np.float32
    )  # of coarse distances, on fine cells: each is divided for once, and many cells are told at once
    for iy in range(height):
        if iy % factor == 0:
            for ix in range(width):
                line[ix] = coarse[iy // factor, ix // factor]
        row, over = out[iy], costs[iy]
        for k in range(np.uint64(width)):
            row[k] = line[k] if over[k] < limit else np.float32(np.inf)


@jit
def drop_outside(inside: NDArray[np.uint8], distance: NDArray[np.float32]) -> None:
    """Set distances [iy, ix] to inf where `inside` is 0."""
    for iy in range(distance.shape[0]):
        for ix in range(distance.shape[1]):
            if not inside[iy, ix]:
                distance[iy, ix] = np.inf


def warm_up() -> None:
    """Compile every kernel with its real dtypes; grids that come from messages are read-only."""
    occupancy = np.full((4, 4), -1, np.int8)
    occupancy.flags.writeable = False
    costs = np.zeros((4, 4), np.uint8)
    costs.flags.writeable = False
    one = (np.zeros(1, np.int64), np.zeros(1, np.uint8))
    for seen in (occupancy, occupancy.copy()):  # inside of a boundary it is a copy
        visible_unknown(seen, np.zeros((4, 4), np.uint8), 50, 0.1, 0.4, 8, *one, np.empty(1), np.empty(1))
    starts, sight, is_so = np.array([0, 1], np.int64), (1, 2), np.ones(1, np.bool_)
    distance, of_one = np.zeros((4, 4), np.float32), (np.zeros(1, np.int64), np.empty(1))
    cells = (np.zeros(1, np.int64), starts, is_so, is_so)
    viewpoints(occupancy.copy(), occupancy, 50, distance, 0, 0, *cells, (3, 3), sight, *of_one)
    in_sight_from(occupancy.copy(), occupancy, 50, np.zeros(1, np.int64), (3, 3), 1, is_so)
    for told in (costs, costs.copy()):
        shrink_costs(told, 2, np.empty((2, 2), np.uint8))
    spread_distances(np.zeros((2, 2), np.float32), 2, costs, 253, np.empty((4, 4), np.float32))
    drop_outside(np.zeros((4, 4), np.uint8)[1:-1, 1:-1], np.zeros((2, 2), np.float32))
