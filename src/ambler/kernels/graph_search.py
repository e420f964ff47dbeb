"""Shortest paths on 8-connected grids: A* and full sweeps with a bucket queue and exact integer costs.

The graph: an edge between two neighbouring traversable cells a, b costs L * (w_a + w_b), with integer weights w and L = 29 for a
straight and 41 for a diagonal step (41 / 29 = sqrt 2 - 0.03 %); a diagonal also needs both cells that it touches at the corner.

Three things make it fast and keep it exact. (1) Buckets about as wide as the cheapest edge: within a bucket the order does not
matter, because a cell whose cost improves is expanded again (Denardo and Fox, 1979). (2) A cell reached by the move d is never
left by d +- 3 or back: the cell before it reaches those at a smaller cost, whatever the weights. (3) Where the 3 x 3 cells around it have
one weight, only the canonical successors are followed, diagonal moves first (Harabor and Grastien, 2011; Sturtevant and
Rabin, 2016): the same costs reach all other neighbours another way. Costs are integers, so ties are ties.

Cells travel packed, iy << 16 | ix, in a grid with a border of one blocked cell. `state` is the move that led to a cell
(START: none), with CLOSED added once it was expanded.
"""

import numpy as np

from ambler.kernels.jit import jit

STRAIGHT, DIAGONAL = 29, 41
FINE_STRAIGHT, FINE_DIAGONAL = 70, 99  # of the distance field: sqrt 2 + 0.005 %
START, CLOSED = 8, 16
BUCKET_EDGES = 1  # width of a bucket in edges of the least weight, at most
RUN_BUCKETS = 32  # how many buckets ahead a straight run may go before it queues up
REACHED, UNREACHED, OVERFLOW = 0, 1, 2
at = np.uintp  # an unsigned index spares the check for a negative one: a quarter of the time
_MOVE_Y = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int64)
_MOVE_X = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int64)


@jit
def weigh(costs, table, weights):
    """Fill `weights` uint16 (H + 2, W + 2) with table[cost] of every cell and a border of zeros (blocked)."""
    height, width = costs.shape
    weights[0, :] = 0
    weights[height + 1, :] = 0
    for iy in range(height):
        weights[iy + 1, 0] = 0
        weights[iy + 1, width + 1] = 0
        for ix in range(width):
            weights[iy + 1, ix + 1] = table[costs[iy, ix]]


@jit
def _is_uniform(weights, i, stride, w):
    up, down = i + stride, i - stride
    return (
        weights[at(i - 1)] == w
        and weights[at(i + 1)] == w
        and weights[at(up)] == w
        and weights[at(down)] == w
        and weights[at(up - 1)] == w
        and weights[at(up + 1)] == w
        and weights[at(down - 1)] == w
        and weights[at(down + 1)] == w
    )


@jit
def _octile(packed, goal_y, goal_x, straight, extra):
    dy, dx = abs((packed >> 16) - goal_y), abs((packed & 0xFFFF) - goal_x)
    return straight * max(dy, dx) + extra * min(dy, dx)


@jit
def _moves_of(move, is_uniform):
    """Return (first, count): the consecutive moves, modulo 8, by which a cell that was reached by `move` may be left."""
    if move == START:
        return 0, 8
    if not is_uniform:
        return move + 6, 5
    if move & 1:
        return move + 7, 3
    return move, 1


@jit
def _grown(stack, size):
    larger = np.empty((stack.shape[0], 2 * stack.shape[1]), np.int32)
    for r in range(len(size)):
        larger[r, : size[r]] = stack[r, : size[r]]
    return larger


@jit
def search(weights, start_y, start_x, goal_y, goal_x, least, most, cost, state):
    """Find the least cost from start to goal; with goal_y < 0 to every cell. Returns REACHED, UNREACHED or OVERFLOW.

    `weights` uint16 (H + 2, W + 2) from `weigh`, cells count with its border; `least` and `most` bound its positive values.
    `cost` int32 or int64 has its shape; every value must be `limit` = cost[0, 0] before, unseen cells keep it. `state` uint8 is
    valid where cost < limit: the move that led to the cell, START for none, + CLOSED. OVERFLOW: a cost would reach the limit.
    """
    stride = np.int64(weights.shape[1])
    w, g, s = weights.ravel(), cost.ravel(), state.ravel()
    limit = np.int64(g[0])
    has_goal = goal_y >= 0
    straight = 2 * least * STRAIGHT if has_goal else 0
    extra = 2 * least * (DIAGONAL - STRAIGHT) if has_goal else 0
    shift = 0
    while (1 << (shift + 1)) <= BUCKET_EDGES * 2 * least * STRAIGHT:
        shift += 1
    buckets = 2
    while buckets < (((2 * most + 2 * least) * DIAGONAL) >> shift) + 2 + RUN_BUCKETS:
        buckets *= 2
    jump = np.empty(8, np.int64)
    hop = np.empty(8, np.int64)
    for move in range(8):
        jump[move] = _MOVE_Y[move] * stride + _MOVE_X[move]
        hop[move] = _MOVE_Y[move] * 65536 + _MOVE_X[move]
    stack = np.empty((buckets, 4096), np.int32)
    size = np.zeros(buckets, np.int64)
    goal = goal_y * stride + goal_x
    best = limit
    packed = np.int64((start_y << 16) | start_x)
    source = start_y * stride + start_x
    g[source] = 0
    s[source] = START
    bucket = _octile(packed, goal_y, goal_x, straight, extra) >> shift
    b = at(bucket & (buckets - 1))
    stack[b, 0] = packed
    size[b] = 1
    waiting = 1
    is_cut = False
    while waiting > 0:
        b = at(bucket & (buckets - 1))
        if size[b] == 0:
            if best < limit and (best >> shift) <= bucket:
                break
            bucket += 1
            continue
        size[b] -= 1
        waiting -= 1
        packed = np.int64(stack[b, at(size[b])])
        i = (packed >> 16) * stride + (packed & 0xFFFF)
        move = np.int64(s[at(i)])
        if move & CLOSED:
            continue
        s[at(i)] = move | CLOSED
        here = np.int64(g[at(i)])
        if here >= best:
            continue
        wi = np.int64(w[at(i)])
        first, count = _moves_of(move, _is_uniform(w, i, stride, wi))
        if count == 1:  # run straight on, without the queue, while everything around is alike
            ahead, side, on, step = jump[move], jump[(move + 2) & 7], hop[move], 2 * STRAIGHT * wi
            while True:
                i += ahead
                packed += on
                here += step
                if here >= g[at(i)]:
                    break
                f = here + _octile(packed, goal_y, goal_x, straight, extra)
                if f >= best:
                    is_cut = is_cut or best == limit
                    break
                g[at(i)] = here
                s[at(i)] = move
                if i == goal:
                    best = here
                    break
                k = i + ahead
                if (
                    (f >> shift) < bucket + RUN_BUCKETS
                    and w[at(k)] == wi
                    and w[at(k + side)] == wi
                    and w[at(k - side)] == wi
                ):
                    s[at(i)] = move | CLOSED
                    continue
                b = at((f >> shift) & (buckets - 1))
                if size[b] == stack.shape[1]:
                    stack = _grown(stack, size)
                stack[b, at(size[b])] = packed
                size[b] += 1
                waiting += 1
                break
            continue
        for k in range(first, first + count):
            move = k & 7
            m = at(move)
            j = i + jump[m]
            wj = np.int64(w[at(j)])
            if wj == 0:
                continue
            if move & 1:
                if w[at(i + _MOVE_X[m])] == 0 or w[at(j - _MOVE_X[m])] == 0:
                    continue
                there = here + DIAGONAL * (wi + wj)
            else:
                there = here + STRAIGHT * (wi + wj)
            if there >= g[at(j)]:
                continue
            p = packed + hop[m]
            f = there + _octile(p, goal_y, goal_x, straight, extra)
            if f >= best:
                is_cut = is_cut or best == limit
                continue
            g[at(j)] = there
            s[at(j)] = move
            if j == goal:
                best = there
                continue
            b = at((f >> shift) & (buckets - 1))
            if size[b] == stack.shape[1]:
                stack = _grown(stack, size)
            stack[b, at(size[b])] = p
            size[b] += 1
            waiting += 1
    if has_goal and (best < limit or source == goal):
        return REACHED
    if is_cut:
        return OVERFLOW
    return UNREACHED if has_goal else REACHED


@jit
def path_points(state, goal_y, goal_x):
    """Return the centres of the path's cells from the start to the goal, float64 (N, 2) of (y, x) in cells; cell i covers [i, i + 1)."""
    iy, ix, n = goal_y, goal_x, 1
    while np.int64(state[iy, ix]) & 15 != START:
        move = np.int64(state[iy, ix]) & 15
        iy -= _MOVE_Y[move]
        ix -= _MOVE_X[move]
        n += 1
    out = np.empty((n, 2))
    iy, ix = goal_y, goal_x
    for k in range(n - 1, -1, -1):
        out[k, 0], out[k, 1] = iy + 0.5, ix + 0.5
        move = np.int64(state[iy, ix]) & 15
        if move != START:
            iy -= _MOVE_Y[move]
            ix -= _MOVE_X[move]
    return out


@jit
def nearest_reached(cost, goal_y, goal_x):
    """Return (iy, ix) of the seen cell nearest to the goal cell; among equals the cheapest, then the first. (-1, -1): none."""
    height, width = cost.shape
    limit = cost[0, 0]
    best_d, best_g, best_y, best_x = np.int64(1) << 62, np.int64(0), -1, -1
    for ring in range(height):
        if ring * ring > best_d:
            break
        for side in range(2):
            iy = goal_y - ring if side == 0 else goal_y + ring
            if iy < 0 or iy >= height or (ring == 0 and side == 1):
                continue
            for ix in range(width):
                if cost[iy, ix] == limit:
                    continue
                d = ring * ring + (ix - goal_x) * (ix - goal_x)
                if d < best_d or (d == best_d and cost[iy, ix] < best_g):
                    best_d, best_g, best_y, best_x = d, np.int64(cost[iy, ix]), iy, ix
    return best_y, best_x


@jit
def distance_field(costs, start_iy, start_ix, lethal_from, resolution, out):
    """Fill `out` float32 (H, W) with the length of the shortest 8-connected path from the start to every cell, metres; inf: none.

    `costs` uint8 (H, W); cells >= `lethal_from` (253: inscribed, lethal and unknown ones) are blocked, diagonals between blocked
    cells too. A start on a blocked cell may leave it through cells of cost 253. Lengths are exact to 0.005 %.
    """
    height, width = costs.shape
    stride = np.int64(width + 2)
    limit = np.int32(2**31 - 1)
    free = np.zeros((height + 2) * stride, np.uint8)
    g = np.full((height + 2) * stride, limit, np.int32)
    s = np.zeros((height + 2) * stride, np.uint8)
    for iy in range(height):
        for ix in range(width):
            free[(iy + 1) * stride + ix + 1] = costs[iy, ix] < lethal_from
    jump = np.empty(8, np.int64)
    hop = np.empty(8, np.int64)
    for move in range(8):
        jump[move] = _MOVE_Y[move] * stride + _MOVE_X[move]
        hop[move] = _MOVE_Y[move] * 65536 + _MOVE_X[move]
    shift, buckets = 6, 32
    stack = np.empty((buckets, 4096), np.int32)
    size = np.zeros(buckets, np.int64)
    packed = np.int64(((start_iy + 1) << 16) | (start_ix + 1))
    i = (packed >> 16) * stride + (packed & 0xFFFF)
    g[at(i)] = 0
    s[at(i)] = START
    stack[0, 0] = packed
    size[0] = 1
    waiting, bucket = 1, 0
    while waiting > 0:
        b = at(bucket & (buckets - 1))
        if size[b] == 0:
            bucket += 1
            continue
        size[b] -= 1
        waiting -= 1
        packed = np.int64(stack[b, at(size[b])])
        i = (packed >> 16) * stride + (packed & 0xFFFF)
        move = np.int64(s[at(i)])
        if move & CLOSED:
            continue
        s[at(i)] = move | CLOSED
        here = np.int64(g[at(i)])
        is_free = free[at(i)] != 0
        first, count = _moves_of(move, is_free and _is_uniform(free, i, stride, 1))
        if count == 1:
            ahead, side, on = jump[move], jump[(move + 2) & 7], hop[move]
            while True:
                i += ahead
                packed += on
                here += FINE_STRAIGHT
                if here >= g[at(i)]:
                    break
                g[at(i)] = here
                k = i + ahead
                if (here >> shift) < bucket + RUN_BUCKETS and free[at(k)] and free[at(k + side)] and free[at(k - side)]:
                    s[at(i)] = move | CLOSED
                    continue
                s[at(i)] = move
                b = at((here >> shift) & (buckets - 1))
                if size[b] == stack.shape[1]:
                    stack = _grown(stack, size)
                stack[b, at(size[b])] = packed
                size[b] += 1
                waiting += 1
                break
            continue
        for k in range(first, first + count):
            move = k & 7
            m = at(move)
            j = i + jump[m]
            p = packed + hop[m]
            if free[at(j)] == 0:
                jy, jx = (p >> 16) - 1, (p & 0xFFFF) - 1
                if is_free or jy < 0 or jx < 0 or jy >= height or jx >= width or costs[jy, jx] != 253:
                    continue
            there = here + FINE_STRAIGHT
            if move & 1:
                if is_free and (free[at(i + _MOVE_X[m])] == 0 or free[at(j - _MOVE_X[m])] == 0):
                    continue
                there = here + FINE_DIAGONAL
            if there >= g[at(j)]:
                continue
            g[at(j)] = there
            s[at(j)] = move
            b = at((there >> shift) & (buckets - 1))
            if size[b] == stack.shape[1]:
                stack = _grown(stack, size)
            stack[b, at(size[b])] = p
            size[b] += 1
            waiting += 1
    scale = resolution / FINE_STRAIGHT
    for iy in range(height):
        for ix in range(width):
            d = g[(iy + 1) * stride + ix + 1]
            out[iy, ix] = d * scale if d != limit else np.inf


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    costs = np.zeros((3, 3), np.uint8)
    weights = np.zeros((5, 5), np.uint16)
    frozen = costs.copy()
    frozen.flags.writeable = False  # messages hold read-only arrays, which are another type to the compiler
    for grid in (costs, frozen):
        weigh(grid, np.full(256, 50, np.uint16), weights)
        distance_field(grid, 1, 1, 253, 0.05, np.zeros((3, 3), np.float32))
    state = np.zeros((5, 5), np.uint8)
    for kind in (np.int32, np.int64):
        cost = np.full((5, 5), 1 << 30, kind)
        search(weights, 1, 1, 3, 3, 50, 252, cost, state)
        nearest_reached(cost, 3, 3)
    path_points(state, 3, 3)
