"""Frontier search on plain arrays: cells, 8-connected groups, goals.

A frontier cell is a free cell with an unknown 4-neighbour (Yamauchi 1997); what lies outside the grid is unknown. Cells
travel as flat indices `iy * width + ix` in ascending order, so that grouping needs no image: the upper neighbours of a
cell are found by a pointer that walks one row behind.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit

I64 = NDArray[np.int64]


@jit
def frontier_cells(
    occupancy: NDArray[np.int8], free_below: int, iy0: int, ix0: int, iy1: int, ix1: int, out: I64
) -> int:
    """Write the flat indices of frontier cells inside the box [iy0, iy1) x [ix0, ix1) into `out`; return their number.

    Each row becomes a mask without branches first, and words of eight empty cells are skipped.
    """
    height, width = occupancy.shape
    words = np.zeros(width // 8 + 1, np.uint64)
    mask = words.view(np.uint8)
    inner0, inner1 = max(ix0, 1), min(ix1, width - 1)
    limit = np.int8(free_below)
    n = 0
    for iy in range(iy0, iy1):
        row = occupancy[iy]
        if iy == 0 or iy == height - 1:
            for k in range(inner1 - inner0):
                mask[inner0 + k] = (row[inner0 + k] >= 0) & (row[inner0 + k] < limit)
        elif inner1 > inner0:
            here, left, right = row[inner0:inner1], row[inner0 - 1 : inner1 - 1], row[inner0 + 1 : inner1 + 1]
            up, down = occupancy[iy - 1, inner0:inner1], occupancy[iy + 1, inner0:inner1]
            inner = mask[inner0:inner1]
            for k in range(len(inner)):
                is_beside = (left[k] < 0) | (right[k] < 0) | (up[k] < 0) | (down[k] < 0)
                inner[k] = is_beside & (here[k] >= 0) & (here[k] < limit)
        if ix0 == 0:
            mask[0] = (row[0] >= 0) & (row[0] < limit)
        if ix1 == width:
            mask[width - 1] = (row[width - 1] >= 0) & (row[width - 1] < limit)
        for word in range(ix0 // 8, (ix1 + 7) // 8):
            if words[word] != 0:
                for ix in range(word * 8, word * 8 + 8):
                    if mask[ix] != 0:
                        out[n] = iy * width + ix
                        n += 1
    return n


@jit
def replace_in_box(
    flat: I64, width: int, iy0: int, ix0: int, iy1: int, ix1: int, fresh: I64, n_fresh: int, out: I64
) -> int:
    """Merge ascending `flat` without its cells in the box with ascending `fresh[:n_fresh]` into `out`; return the number."""
    before = int(np.searchsorted(flat, iy0 * width))
    after = int(np.searchsorted(flat, iy1 * width))
    out[:before] = flat[:before]
    n = before
    j = 0
    row_end = iy0 * width
    column0 = 0
    for k in range(before, after):
        f = flat[k]
        while f >= row_end:
            column0 = row_end
            row_end += width
        ix = f - column0
        if ix0 <= ix < ix1:
            continue
        while j < n_fresh and fresh[j] < f:
            out[n] = fresh[j]
            n += 1
            j += 1
        out[n] = f
        n += 1
    while j < n_fresh:
        out[n] = fresh[j]
        n += 1
        j += 1
    rest = len(flat) - after
    out[n : n + rest] = flat[after:]
    return n + rest


@jit
def _root(parent: I64, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@jit
def _union(parent: I64, a: int, b: int) -> None:
    ra, rb = _root(parent, a), _root(parent, b)
    if ra < rb:
        parent[rb] = ra
    elif rb < ra:
        parent[ra] = rb


@jit
def group_cells(flat: I64, width: int, parent: I64, cells: I64, starts: I64) -> int:
    """Sort ascending flat cells by their 8-connected group, groups by their first cell; return the number of groups.

    Group g becomes cells[starts[g]:starts[g + 1]]. `parent` is scratch of the length of `flat`, `starts` one longer.
    """
    n = len(flat)
    above = 0
    row_end = 0
    for k in range(n):
        parent[k] = k
        f = flat[k]
        if f >= row_end:
            row_end = (f // width + 1) * width
        at_left, at_right = f == row_end - width, f == row_end - 1
        if k > 0 and not at_left and flat[k - 1] == f - 1:
            parent[k] = parent[k - 1]
        first = f - width if at_left else f - width - 1
        last = f - width if at_right else f - width + 1
        while flat[above] < first:
            above += 1
        j = above
        while flat[j] <= last:
            if parent[j] != parent[k]:
                _union(parent, k, j)
            j += 1
    groups = 0
    for k in range(n):
        p = parent[k]
        if p == k:
            parent[k] = -groups - 1
            starts[groups] = 1
            groups += 1
        else:
            label = parent[p]
            parent[k] = label
            starts[-label - 1] += 1
    total = 0
    for g in range(groups):
        size = starts[g]
        starts[g] = total
        total += size
    for k in range(n):
        g = -parent[k] - 1
        cells[starts[g]] = flat[k]
        starts[g] += 1
    for g in range(groups, 0, -1):
        starts[g] = starts[g - 1]
    starts[0] = 0
    return groups


@jit
def _search_goal(
    occupancy: NDArray[np.int8],
    free_below: int,
    distance: NDArray[np.float32],
    costs: NDArray[np.uint8],
    most: int,
    diy: int,
    dix: int,
    max_steps: int,
    visited: NDArray[np.int32],
    stamp: int,
    queue: I64,
    n_queue: int,
) -> int:
    """Breadth-first over free cells from the seeds in `queue[:n_queue]`; return the flat index of the first reachable cell or -1."""
    height, width = occupancy.shape
    head = 0
    level_end = n_queue
    steps = 0
    while head < n_queue:
        if head == level_end:
            steps += 1
            level_end = n_queue
            if steps > max_steps:
                return -1
        f: int = queue[head]
        head += 1
        iy = f // width
        ix = f - iy * width
        cy, cx = iy + diy, ix + dix
        is_inside = 0 <= cy < distance.shape[0] and 0 <= cx < distance.shape[1]
        if is_inside and math.isfinite(distance[cy, cx]) and costs[cy, cx] <= most:
            return f
        for ny in range(max(0, iy - 1), min(height, iy + 2)):
            for nx in range(max(0, ix - 1), min(width, ix + 2)):
                g = ny * width + nx
                v = occupancy[ny, nx]
                if v < 0 or v >= free_below or visited[g] == stamp or n_queue == len(queue):
                    continue
                visited[g] = stamp
                queue[n_queue] = g
                n_queue += 1
    return -1


@jit
def frontier_goals(
    occupancy: NDArray[np.int8],
    free_below: int,
    distance: NDArray[np.float32],
    costs: NDArray[np.uint8],
    most: int,
    diy: int,
    dix: int,
    cells: I64,
    starts: I64,
    is_wanted: NDArray[np.bool_],
    max_steps: int,
    visited: NDArray[np.int32],
    first_stamp: int,
    queue: I64,
    goals: I64,
) -> None:
    """Give each group that `is_wanted` (G,) its goal: the reachable free cell nearest (8-neighbour steps) to its cell nearest to the centroid.

    `cells` are flat indices sorted by group, group g is cells[starts[g]:starts[g+1]]. `distance` (metres, inf where the
    robot cannot be) and `costs` are indexed [iy + diy, ix + dix]; a goal costs `most` at most. When the middle of a group is far from every reachable cell, all of
    its cells are tried at once. `goals[g]` becomes -1 without a reachable cell within `max_steps`. `visited` (as many as cells
    of the grid) holds numbers below `first_stamp`; two stamps per group are used.
    """
    width = occupancy.shape[1]
    for g in range(len(starts) - 1):
        if not is_wanted[g]:
            continue
        a, b = starts[g], starts[g + 1]
        sy, sx = 0.0, 0.0
        for k in range(a, b):
            sy += cells[k] // width
            sx += cells[k] % width
        sy /= b - a
        sx /= b - a
        best = np.inf
        middle = cells[a]
        for k in range(a, b):
            d = (cells[k] // width - sy) ** 2 + (cells[k] % width - sx) ** 2
            if d < best:
                best = d
                middle = cells[k]
        stamp = first_stamp + 2 * g
        queue[0] = middle
        visited[middle] = stamp
        goal = _search_goal(occupancy, free_below, distance, costs, most, diy, dix, max_steps, visited, stamp, queue, 1)
        if goal < 0:
            stamp += 1
            n = 0
            for k in range(a, min(b, a + len(queue))):
                visited[cells[k]] = stamp
                queue[n] = cells[k]
                n += 1
            goal = _search_goal(
                occupancy, free_below, distance, costs, most, diy, dix, max_steps, visited, stamp, queue, n
            )
        goals[g] = goal


@jit
def _is_free(occupancy: NDArray[np.int8], free_below: int, y: float, x: float) -> bool:
    iy, ix = int(math.floor(y)), int(math.floor(x))
    if iy < 0 or ix < 0 or iy >= occupancy.shape[0] or ix >= occupancy.shape[1]:
        return False
    return bool(0 <= occupancy[iy, ix] < free_below)


@jit
def look_around(
    occupancy: NDArray[np.int8],
    free_below: int,
    y: float,
    x: float,
    sector: tuple[float, float],
    reach: tuple[float, float],
    ends: I64,
    passed: NDArray[np.uint8],
) -> None:
    """Look from (y, x) along as many rays as `ends` is long: each gets the flat index of the first cell that is not free, or -1, and
    marks the free cells that it passes from the nearest reach on in `passed` uint8 [iy, ix] with 1.

    Place and `reach` (nearest, farthest) in cells, cell (iy, ix) covering [ix, ix + 1) x [iy, iy + 1); `sector` is the middle and the
    half width (rad, in the grid's frame) of the rays, which are sampled every half cell. -1 means that the ray meets nothing within
    reach, or an unknown cell that it only grazes: two cells farther on, free cells are one cell beside it. Such is the edge of a shadow.
    """
    height, width = occupancy.shape
    for i in range(len(ends)):
        ends[i] = -1
        angle = sector[0] + sector[1] * (2.0 * i / len(ends) - 1.0)
        dx, dy = math.cos(angle), math.sin(angle)
        for k in range(int(2.0 * reach[1]) + 1):
            along = 0.5 * k
            iy, ix = int(math.floor(y + along * dy)), int(math.floor(x + along * dx))
            if _is_free(occupancy, free_below, y + along * dy, x + along * dx):
                if along >= reach[0]:
                    passed[iy, ix] = 1
                continue
            if iy < 0 or ix < 0 or iy >= height or ix >= width or along < reach[0]:
                break
            by, bx = y + (along + 2.0) * dy, x + (along + 2.0) * dx
            is_frontal = not (
                _is_free(occupancy, free_below, by + dx, bx - dy) or _is_free(occupancy, free_below, by - dx, bx + dy)
            )
            if occupancy[iy, ix] >= 0 or is_frontal:
                ends[i] = iy * width + ix
            break


@jit
def towards_free(occupancy: NDArray[np.int8], cells: I64, reach: int, free_below: int, down: I64, right: I64) -> None:
    """Write for each flat cell the sums of the offsets (`down`, `right`) to the free cells within `reach` cells of it, less those to the unknown ones;
    the grid's edge stands for what lies beyond it."""
    height, width = occupancy.shape
    for k in range(len(cells)):
        iy, ix = cells[k] // width, cells[k] % width
        down[k] = right[k] = 0
        for dy in range(-reach, reach + 1):
            y = min(max(iy + dy, 0), height - 1)
            for dx in range(-reach, reach + 1):
                value = occupancy[y, min(max(ix + dx, 0), width - 1)]
                weight = -1 if value < 0 else 1 if value < free_below else 0
                down[k] += dy * weight
                right[k] += dx * weight


@jit
def has_any_around(
    marks: NDArray[np.uint8], cells: I64, reach: int, bits: NDArray[np.uint8], out: NDArray[np.bool_]
) -> None:
    """Tell of each flat cell whether any cell of `marks` [iy, ix] within `reach` cells of it holds one of its `bits`."""
    height, width = marks.shape
    for k in range(len(cells)):
        iy, ix = cells[k] // width, cells[k] % width
        out[k] = False
        for y in range(max(iy - reach, 0), min(iy + reach, height - 1) + 1):
            for x in range(max(ix - reach, 0), min(ix + reach, width - 1) + 1):
                if marks[y, x] & bits[k]:
                    out[k] = True


@jit
def spread_steps(edge: I64, reached: NDArray[np.uint8], passable: NDArray[np.uint8], steps: int) -> None:
    """Set to 1 in `reached` [iy, ix] what lies within so many steps, not diagonal, over `passable` cells from the flat cells of an `edge`."""
    height, width = reached.shape
    for _ in range(steps):
        after = np.empty(4 * len(edge), np.int64)
        found = 0
        for k in range(len(edge)):
            iy, ix = edge[k] // width, edge[k] % width
            for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                y, x = iy + dy, ix + dx
                if 0 <= y < height and 0 <= x < width and passable[y, x] and not reached[y, x]:
                    reached[y, x] = 1
                    after[found] = y * width + x
                    found += 1
        edge = after[:found].copy()


def warm_up() -> None:
    """Compile every kernel with its real dtypes; grids that come from messages are read-only."""
    occupancy = np.zeros((4, 4), np.int8)
    occupancy[0] = -1
    occupancy.flags.writeable = False
    flat = np.empty(16, np.int64)
    n = frontier_cells(occupancy, 50, 0, 0, 4, 4, flat)
    merged = np.empty(16, np.int64)
    n = replace_in_box(flat[:n].copy(), 4, 0, 0, 4, 4, flat, n, merged)
    cells = merged[:n].copy()
    group_cells(cells, 4, np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n + 1, np.int64))
    goals = np.empty(1, np.int64)
    starts = np.array([0, n], np.int64)
    visited = np.zeros(16, np.int32)
    distance = np.zeros((4, 4), np.float32)
    costs, wanted = np.zeros((4, 4), np.uint8), np.ones(1, np.bool_)
    costs.flags.writeable = False
    grids = (occupancy, 50, distance)
    for prices in (costs, costs.copy()):
        frontier_goals(*grids, prices, 9, 0, 0, cells, starts, wanted, 2, visited, 1, np.empty(16, np.int64), goals)
    ends, passed = np.empty(8, np.int64), np.zeros((4, 4), np.uint8)
    look_around(occupancy.copy(), 50, 2.5, 2.5, (0.0, math.pi), (0.0, 9.0), ends, passed)
    one = np.zeros(1, np.int64)
    for told in (occupancy, occupancy.copy()):
        towards_free(told, one, 1, 50, np.empty(1, np.int64), np.empty(1, np.int64))
    has_any_around(passed, one, 1, np.ones(1, np.uint8), np.empty(1, np.bool_))
    spread_steps(one, np.zeros((4, 4), np.uint8), passed, 1)
