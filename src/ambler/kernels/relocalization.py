"""Kernel of global relocalization: branch and bound over every free pose of a map that keeps the best pose of every neighbourhood.

The stack of maxima is that of `kernels.branch_bound`. Where loop closure wants the one best pose, relocalization must know all that
look nearly as good, or it could not say that two places look alike.
"""

import math

import numpy as np

from ambler.kernels.branch_bound import sum_at
from ambler.kernels.jit import jit


@jit
def score_cells(distance, sigma, factor, cells):
    """Write `cells` uint16 (h, w): 32640 exp(-d² / 2 sigma²), largest over factor x factor cells of `distance` float32 (H, W)."""
    for iy in range(cells.shape[0]):
        for ix in range(cells.shape[1]):
            least = 1e9
            for jy in range(iy * factor, min((iy + 1) * factor, distance.shape[0])):
                for jx in range(ix * factor, min((ix + 1) * factor, distance.shape[1])):
                    least = min(least, distance[jy, jx])
            cells[iy, ix] = int(32640.0 * math.exp(-0.5 * least * least / (sigma * sigma)))


@jit
def free_cells(occupancy, factor, free):
    """Write `free` bool (h, w): some of factor x factor cells of `occupancy` int8 (H, W) is known and free."""
    for iy in range(free.shape[0]):
        for ix in range(free.shape[1]):
            free[iy, ix] = False
            for jy in range(iy * factor, min((iy + 1) * factor, occupancy.shape[0])):
                for jx in range(ix * factor, min((ix + 1) * factor, occupancy.shape[1])):
                    if 0 <= occupancy[jy, jx] < 50:
                        free[iy, ix] = True


@jit
def search(stack, free, resolution, points, angles, sectors, ratio, min_sum, best):
    """Find the best free pose in each block of 2^(D-1) cells and each of `sectors` of heading.

    `stack` uint8 (D, h + pad, w + pad) over cells of `resolution` metres; `free` bool (h, w); `points` float32 (N, 2) in the base
    frame; `angles` float64 (A,). Poses below `ratio` of the best of all or below `min_sum` are not pursued. `best` int64
    (blocks_y * blocks_x * sectors, 4): sum (-1: none), iy, ix, index of the angle; the base stands in the middle of cell (iy, ix).
    Returns how many candidates were scored.
    """
    depth = stack.shape[0]
    top = depth - 1
    stride = 1 << top
    pad = stride - 1
    n, turns = points.shape[0], angles.shape[0]
    height, width = free.shape
    blocks_y, blocks_x = (height + stride - 1) // stride, (width + stride - 1) // stride
    cells_x = np.empty((turns, n), np.int32)
    cells_y = np.empty((turns, n), np.int32)
    inverse = 1.0 / resolution
    for a in range(turns):
        c, s = math.cos(angles[a]), math.sin(angles[a])
        for i in range(n):
            cells_x[a, i] = int(math.floor((c * points[i, 0] - s * points[i, 1]) * inverse + 0.5))
            cells_y[a, i] = int(math.floor((s * points[i, 0] + c * points[i, 1]) * inverse + 0.5))
    # Blocks with a free cell, their roots scored for every angle.
    has_free = np.zeros((blocks_y, blocks_x), np.bool_)
    for iy in range(height):
        for ix in range(width):
            if free[iy, ix]:
                has_free[iy // stride, ix // stride] = True
    roots = blocks_y * blocks_x * turns
    kept = np.empty(roots, np.int64)
    sums = np.empty(roots, np.int64)
    n_kept = 0
    scored = 0
    for by in range(blocks_y):
        for bx in range(blocks_x):
            if not has_free[by, bx]:
                continue
            for a in range(turns):
                total = sum_at(stack[top], pad, cells_x[a], cells_y[a], bx * stride, by * stride)
                scored += 1
                if total > min_sum:
                    kept[n_kept] = (by * blocks_x + bx) * turns + a
                    sums[n_kept] = total
                    n_kept += 1
    order = np.argsort(-sums[:n_kept], kind="mergesort")
    best[:, 0] = -1
    global_best = 0
    todo = np.empty((4 * depth + 4, 4), np.int64)
    child = np.empty((4, 3), np.int64)
    for o in range(n_kept):
        k = kept[order[o]]
        bound = sums[order[o]]
        if bound < ratio * global_best:
            break
        a = k % turns
        block = k // turns
        slot = block * sectors + a * sectors // turns
        if bound <= best[slot, 0]:
            continue
        todo[0, 0], todo[0, 1], todo[0, 2], todo[0, 3] = (
            top,
            block // blocks_x * stride,
            block % blocks_x * stride,
            bound,
        )
        waiting = 1
        while waiting > 0:
            waiting -= 1
            level, y, x, total = todo[waiting, 0], todo[waiting, 1], todo[waiting, 2], todo[waiting, 3]
            if total <= best[slot, 0] or total < ratio * global_best or total <= min_sum:
                continue
            if level == 0:
                if free[y, x]:
                    best[slot, 0], best[slot, 1], best[slot, 2], best[slot, 3] = total, y, x, a
                    global_best = max(global_best, total)
                continue
            s = 1 << (level - 1)
            count = 0
            for j in range(4):
                cy, cx = y + (s if j & 2 else 0), x + (s if j & 1 else 0)
                if cy >= height or cx >= width:
                    continue
                value = sum_at(stack[level - 1], pad, cells_x[a], cells_y[a], cx, cy)
                scored += 1
                m = count
                while m > 0 and child[m - 1, 0] > value:
                    child[m, 0], child[m, 1], child[m, 2] = child[m - 1, 0], child[m - 1, 1], child[m - 1, 2]
                    m -= 1
                child[m, 0], child[m, 1], child[m, 2] = value, cy, cx
                count += 1
            for j in range(count):
                if child[j, 0] > best[slot, 0] and child[j, 0] >= ratio * global_best:
                    todo[waiting, 0], todo[waiting, 1], todo[waiting, 2], todo[waiting, 3] = (
                        level - 1,
                        child[j, 1],
                        child[j, 2],
                        child[j, 0],
                    )
                    waiting += 1
    return scored


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    cells = np.zeros((2, 2), np.uint16)
    score_cells(np.zeros((4, 4), np.float32), 0.1, 2, cells)
    free = np.zeros((2, 2), np.bool_)
    free_cells(np.zeros((4, 4), np.int8), 2, free)
    stack = np.zeros((2, 3, 3), np.uint8)
    search(stack, free, 0.1, np.ones((2, 2), np.float32), np.zeros(4), 4, 0.9, 1, np.zeros((4, 4), np.int64))
