"""Paths down the gradient of a full potential, navfn's method: the peer of the planner in tests and benchmarks, which no robot calls.

The potential solves |grad T| = w with w constant in each cell (fast marching: Sethian, 1996), T = 0 at the goal's centre. The path follows
its gradient, interpolated between the four cells around, by half a cell at a time; beside cells that have no potential it steps from
cell centre to cell centre.
"""

import heapq

import numpy as np

from ambler.kernels.jit import jit

STEP = 0.5
NEAR_GOAL = 0.75


@jit
def potential(weights, goal_y, goal_x, out):
    """Fill `out` float64 [iy, ix] with the cost to the goal cell; inf: no way. `weights` uint16 has a border of blocked cells (0)."""
    out[:] = np.inf
    is_done = np.zeros(weights.shape, np.bool_)
    out[goal_y, goal_x] = 0.0
    queue = [(0.0, goal_y, goal_x)]
    while len(queue) > 0:
        _, y, x = heapq.heappop(queue)
        if is_done[y, x]:
            continue
        is_done[y, x] = True
        for k in range(4):
            ny, nx = y + (1, 0, -1, 0)[k], x + (0, 1, 0, -1)[k]
            if weights[ny, nx] == 0 or is_done[ny, nx]:
                continue
            value = _upwind(out, ny, nx, float(weights[ny, nx]))
            if value < out[ny, nx]:
                out[ny, nx] = value
                heapq.heappush(queue, (value, ny, nx))


@jit
def _upwind(out, y, x, w):
    """Return the solution of the upwind scheme in one cell of weight w."""
    a, b = min(out[y - 1, x], out[y + 1, x]), min(out[y, x - 1], out[y, x + 1])
    low, high = min(a, b), max(a, b)
    if high - low >= w:
        return low + w
    return 0.5 * (low + high + np.sqrt(2.0 * w * w - (high - low) ** 2))


@jit
def _slope(levels, y, x, dy, dx):
    """Return the fall of the potential along one axis, from the neighbours that have one."""
    here, fall = levels[y, x], 0.0
    before, after = levels[y - dy, x - dx], levels[y + dy, x + dx]
    if np.isfinite(before):
        fall += before - here
    if np.isfinite(after):
        fall += here - after
    return fall


@jit
def _direction(levels, y, x):
    """Return the unit vector (dy, dx) down the potential of a cell, (0, 0) where there is none."""
    down_y, down_x = _slope(levels, y, x, 1, 0), _slope(levels, y, x, 0, 1)
    length = np.hypot(down_y, down_x)
    if length == 0.0:
        return 0.0, 0.0
    return down_y / length, down_x / length


@jit
def _lowest_neighbour(levels, y, x):
    """Return the cell of lowest potential among nine, and whether all of them have one."""
    best_y, best_x, is_inside = y, x, True
    for ny in range(y - 1, y + 2):
        for nx in range(x - 1, x + 2):
            is_inside = is_inside and np.isfinite(levels[ny, nx])
            if levels[ny, nx] < levels[best_y, best_x]:
                best_y, best_x = ny, nx
    return best_y, best_x, is_inside


@jit
def descend(levels, start_y, start_x, goal_y, goal_x, out):
    """Write the path from a cell's centre to the goal's as (y, x) in cells, cell i covering [i, i + 1), into `out` float64 (N, 2).

    Returns the number of points; 0 when N are not enough, or the descent ends in a pit of the interpolation.
    """
    y, x, offset_y, offset_x = start_y, start_x, 0.0, 0.0
    for n in range(len(out) - 1):
        out[n, 0], out[n, 1] = y + offset_y + 0.5, x + offset_x + 0.5
        if abs(y + offset_y - goal_y) <= NEAR_GOAL and abs(x + offset_x - goal_x) <= NEAR_GOAL:
            out[n + 1, 0], out[n + 1, 1] = goal_y + 0.5, goal_x + 0.5
            return n + 2
        best_y, best_x, is_inside = _lowest_neighbour(levels, y, x)
        turns_back = n > 2 and out[n, 0] == out[n - 2, 0] and out[n, 1] == out[n - 2, 1]
        if turns_back or not is_inside:
            if best_y == y and best_x == x:
                return 0
            y, x, offset_y, offset_x = best_y, best_x, 0.0, 0.0
            continue
        down_y, down_x = 0.0, 0.0
        for k in range(4):
            share = (offset_y if k & 1 else 1.0 - offset_y) * (offset_x if k & 2 else 1.0 - offset_x)
            corner_y, corner_x = _direction(levels, y + (k & 1), x + (k >> 1))
            down_y += share * corner_y
            down_x += share * corner_x
        length = np.hypot(down_y, down_x)
        if length == 0.0:
            return 0
        offset_y += STEP * down_y / length
        offset_x += STEP * down_x / length
        whole_y, whole_x = int(np.floor(offset_y)), int(np.floor(offset_x))
        y, x, offset_y, offset_x = y + whole_y, x + whole_x, offset_y - whole_y, offset_x - whole_x
    return 0


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    weights = np.zeros((6, 6), np.uint16)
    weights[1:5, 1:5] = 50
    levels = np.empty((6, 6))
    potential(weights, 3, 3, levels)
    descend(levels, 1, 1, 3, 3, np.empty((20, 2)))
