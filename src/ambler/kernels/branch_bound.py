"""Kernels of branch-and-bound scan matching (Olson's and Cartographer's fast correlative matcher).

A stack of grids holds at level h the maximum over a window of 2^h x 2^h cells that starts at the cell, so the score at level h
bounds the scores of all 4^h translations below it from above.
"""

import math

import numpy as np

from ambler.kernels.jit import jit

BLOCK = 32  # points after which a sum asks whether it can still become large enough


@jit
def build_stack(cells, stack):
    """Fill `stack` uint8 (D, H + pad, W + pad), pad = 2^(D-1) - 1, from `cells` uint16 (H, W); cell [0, 0] lies at [pad, pad]."""
    depth = stack.shape[0]
    pad = (1 << (depth - 1)) - 1
    rows, columns = stack.shape[1], stack.shape[2]
    stack[0, :pad] = 0
    for iy in range(pad, rows):
        given, row = cells[iy - pad], stack[0, iy]
        row[:pad] = 0
        for ix in range(columns - pad):
            row[pad + ix] = (np.uint32(given[ix]) * np.uint32(255) + np.uint32(16383)) // np.uint32(32767)
    both = np.empty(columns, np.uint8)
    for level in range(1, depth):
        s = 1 << (level - 1)
        ahead = both[s:]
        for iy in range(rows):
            # One direction after the other, whole rows at a time without a question inside: sixteen cells or more in one instruction.
            lower, upper, out = stack[level - 1, iy], stack[level - 1, min(iy + s, rows - 1)], stack[level, iy]
            for ix in range(columns):
                both[ix] = max(lower[ix], upper[ix])
            for ix in range(columns - s):
                out[ix] = max(both[ix], ahead[ix])
            for ix in range(columns - s, columns):
                out[ix] = max(both[ix], both[columns - 1])


@jit
def sum_at(grid, pad, cells_x, cells_y, dx, dy):
    """Sum a padded grid over the cells of a scan that is moved by (dx, dy) cells; outside it is nothing."""
    rows, columns = np.uint64(grid.shape[0]), np.uint64(grid.shape[1])
    right, up = dx + pad, dy + pad
    total = 0
    for i in range(np.uint64(cells_x.shape[0])):
        # What is negative becomes larger than any grid.
        ix, iy = np.uint64(cells_x[i] + right), np.uint64(cells_y[i] + up)
        if ix < columns and iy < rows:
            total += np.int64(grid[iy, ix])
    return total


@jit
def sum_within(cells, places, offset, enough):
    """Sum the flat grid `cells` over the `places` uint64 (N,) of a scan, all of them moved by `offset` and within the grid. As soon as it is known that the sum is
    at most `enough`, what was summed so far is returned, which is less.
    Of a signed index the compiler asks each time whether it is negative, which takes two thirds of the time.
    """
    n, total = places.shape[0], 0
    moved = np.uint64(offset)  # an offset to the left too: what is beyond the largest number begins again at 0
    for start in range(0, n, BLOCK):
        end = min(start + BLOCK, n)
        for i in range(np.uint64(start), np.uint64(end)):
            total += np.int64(cells[places[i] + moved])
        if total + (n - end) * 255 <= enough:
            break
    return total


@jit
def search(stack, frame, points, center, window, min_sum, best):
    """Find the best translation and rotation in a window; exact over the discretized candidates.

    `stack` from `build_stack`; `frame` (resolution, x, y of cell [0, 0]'s outer corner); `points` float32 (N, 2) in the base
    frame; `center` float64 (3,); `window` float64 (4,): half width in cells, half number of angles, angle step, top level.
    Only candidates whose sum of uint8 values exceeds `min_sum` count. `best` float64 (4,): x, y, yaw, sum (-1: none).
    Returns how many candidates were scored.
    """
    n = points.shape[0]
    half, half_angles, step, top = int(window[0]), int(window[1]), window[2], int(window[3])
    pad = (1 << (stack.shape[0] - 1)) - 1
    rows, columns = stack.shape[1], stack.shape[2]
    flat = stack.reshape(stack.shape[0], rows * columns)
    angles = 2 * half_angles + 1
    cells_x = np.empty((angles, n), np.int32)
    cells_y = np.empty((angles, n), np.int32)
    places = np.empty((angles, n), np.uint64)
    room = np.empty((angles, 4), np.int64)  # which (dx, dy) keep the whole scan within the grid: from, to
    inverse = 1.0 / frame[0]
    for a in range(angles):
        yaw = center[2] + (a - half_angles) * step
        c, s = math.cos(yaw), math.sin(yaw)
        for i in range(n):
            cells_x[a, i] = int(math.floor((c * points[i, 0] - s * points[i, 1] + center[0] - frame[1]) * inverse))
            cells_y[a, i] = int(math.floor((s * points[i, 0] + c * points[i, 1] + center[1] - frame[2]) * inverse))
            places[a, i] = (cells_y[a, i] + pad) * columns + cells_x[a, i] + pad
        room[a, 0], room[a, 1] = -pad - cells_x[a].min(), columns - 1 - pad - cells_x[a].max()
        room[a, 2], room[a, 3] = -pad - cells_y[a].min(), rows - 1 - pad - cells_y[a].max()
    stride = 1 << top
    per_side = (2 * half) // stride + 1
    roots = angles * per_side * per_side
    root_sum = np.empty(roots, np.int64)
    kept = np.empty(roots, np.int64)
    n_kept = 0
    scored = roots
    for k in range(roots):
        a = k // (per_side * per_side)
        dy = (k // per_side) % per_side * stride - half
        dx = k % per_side * stride - half
        if room[a, 0] <= dx <= room[a, 1] and room[a, 2] <= dy <= room[a, 3]:
            total = sum_within(flat[top], places[a], dy * columns + dx, min_sum)
        else:
            total = sum_at(stack[top], pad, cells_x[a], cells_y[a], dx, dy)
        root_sum[k] = total
        if total > min_sum:
            kept[n_kept] = k
            n_kept += 1
    order = np.argsort(-root_sum[kept[:n_kept]], kind="mergesort")
    best_sum = min_sum
    best[3] = -1.0
    todo_level = np.empty(4 * (top + 1), np.int64)
    todo_x = np.empty(4 * (top + 1), np.int64)
    todo_y = np.empty(4 * (top + 1), np.int64)
    todo_sum = np.empty(4 * (top + 1), np.int64)
    child_x = np.empty(4, np.int64)
    child_y = np.empty(4, np.int64)
    child_sum = np.empty(4, np.int64)
    for o in range(n_kept):
        k = kept[order[o]]
        if root_sum[k] <= best_sum:
            break
        a = k // (per_side * per_side)
        todo_level[0] = top
        todo_y[0] = (k // per_side) % per_side * stride - half
        todo_x[0] = k % per_side * stride - half
        todo_sum[0] = root_sum[k]
        waiting = 1
        while waiting > 0:
            waiting -= 1
            level, x, y, total = todo_level[waiting], todo_x[waiting], todo_y[waiting], todo_sum[waiting]
            if total <= best_sum:
                continue
            if level == 0:
                best_sum = total
                best[0] = center[0] + x * frame[0]
                best[1] = center[1] + y * frame[0]
                best[2] = center[2] + (a - half_angles) * step
                best[3] = total
                continue
            s = 1 << (level - 1)
            count = 0
            for j in range(4):
                cx, cy = x + (s if j & 1 else 0), y + (s if j & 2 else 0)
                if cx > half or cy > half:
                    continue
                if room[a, 0] <= cx <= room[a, 1] and room[a, 2] <= cy <= room[a, 3]:
                    value = sum_within(flat[level - 1], places[a], cy * columns + cx, best_sum)
                else:
                    value = sum_at(stack[level - 1], pad, cells_x[a], cells_y[a], cx, cy)
                scored += 1
                m = count
                while m > 0 and child_sum[m - 1] > value:
                    child_sum[m], child_x[m], child_y[m] = child_sum[m - 1], child_x[m - 1], child_y[m - 1]
                    m -= 1
                child_sum[m], child_x[m], child_y[m] = value, cx, cy
                count += 1
            for j in range(count):
                if child_sum[j] > best_sum:
                    todo_level[waiting] = level - 1
                    todo_x[waiting], todo_y[waiting], todo_sum[waiting] = child_x[j], child_y[j], child_sum[j]
                    waiting += 1
    return scored


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    stack = np.zeros((2, 9, 9), np.uint8)
    build_stack(np.full((8, 8), 20000, np.uint16), stack)
    points = np.ones((2, 2), np.float32)
    window = np.array([2.0, 1.0, 0.1, 1.0])
    search(stack, np.array([1.0, 0.0, 0.0]), points, np.ones(3), window, 0, np.zeros(4))
