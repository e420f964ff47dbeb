"""Sight between the nodes of a visibility graph, its edges with their votes, and the search over it.

`field` is the clearance of `kernels.level_contour`; coordinates are (y, x) in cells. A line is clear while the bilinear clearance stays
above `least`; sphere tracing jumps by what the clearance allows. Nodes are float64 (N, 8): y, x, direction back (y, x) and on (y, x)
along the contour, floor, and whether it is a corner at all (a path can end a leg there only where the leg is taut). Edges lie in slots
[node, k]: `neighbor` int32, `weight` float32 (metres, and the price in metres of what is unknown along it), `state` uint8 (votes, tests, open now, kind).
"""

import heapq

import numpy as np

from ambler.kernels.jit import jit

Y, X, BACK_Y, BACK_X, ON_Y, ON_X, FLOOR, IS_CORNER = range(8)
VOTES, TESTS, OPEN, KIND = range(4)
SIGHT, CONTOUR, TRAJECTORY = range(3)
POOL = 8  # tests that an edge remembers
UNIT = 16.0
HALF_CELL = 0.75  # cells; half the diagonal of a cell, and what a sixteenth rounds away
STEP = 0.25  # cells; the least step of a sight line: the clearance dips by no more than half of it in between
SURE = 1.4  # cells of clearance from which no cell corner can be touched
FINE = 0.1  # cells; the step where the cells themselves are looked at
BOX = 0.56  # cells; half a cell and what a fine step can miss
FOUND, NOT_FOUND = 1, 0


@jit
def clearance(field, y, x):
    """Return the bilinear clearance in cells at a point inside the grid of centres."""
    iy, ix = int(y), int(x)
    jy, jx = min(iy + 1, field.shape[0] - 1), min(ix + 1, field.shape[1] - 1)
    v, u = y - iy, x - ix
    low = field[iy, ix] * (1.0 - u) + field[iy, jx] * u
    high = field[jy, ix] * (1.0 - u) + field[jy, jx] * u
    return (low * (1.0 - v) + high * v) / UNIT


@jit
def is_inside(field, y, x):
    """Say whether a point lies between the centres of the outermost cells."""
    return 0.0 <= y <= field.shape[0] - 1 and 0.0 <= x <= field.shape[1] - 1


@jit
def _touches(field, y, x):
    """Say whether a point lies on a forbidden cell, or so near to it that the next fine step could."""
    iy, ix = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
    for ny in range(iy - 1, iy + 2):
        for nx in range(ix - 1, ix + 2):
            if not (0 <= ny < field.shape[0] and 0 <= nx < field.shape[1]):
                if abs(y - ny) < 0.5 and abs(x - nx) < 0.5:
                    return True
            elif field[ny, nx] == 0 and abs(y - ny) < BOX and abs(x - nx) < BOX:
                return True
    return False


@jit
def is_clear(field, y0, x0, y1, x1, least):
    """Say whether the line keeps `least` cells of clearance all along."""
    if not (is_inside(field, y0, x0) and is_inside(field, y1, x1)):
        return False
    length = np.hypot(y1 - y0, x1 - x0)
    along_y = (y1 - y0) / length if length > 0.0 else 0.0
    along_x = (x1 - x0) / length if length > 0.0 else 0.0
    at = 0.0
    while True:
        y, x = y0 + along_y * at, x0 + along_x * at
        jump = field[int(y + 0.5), int(x + 0.5)] / UNIT - HALF_CELL - least
        if jump > 1.0:  # one look at the nearest cell is enough
            if at + jump >= length:
                return True
            at += jump
            continue
        free = clearance(field, y, x)
        if free < least:
            return False
        if at >= length:
            return True
        at = min(length, at + max(STEP, free - least - 0.15))


@jit
def is_open(field, y0, x0, y1, x1):
    """Say whether the line touches no forbidden cell, however close it passes; its first cell may be touched."""
    length = np.hypot(y1 - y0, x1 - x0)
    along_y = (y1 - y0) / length if length > 0.0 else 0.0
    along_x = (x1 - x0) / length if length > 0.0 else 0.0
    at = 0.0
    while True:
        y, x = y0 + along_y * at, x0 + along_x * at
        free = clearance(field, y, x) if is_inside(field, y, x) else 0.0
        if free < SURE and _touches(field, y, x):
            return False
        if at >= length:
            return True
        at = min(length, at + max(FINE, free - SURE))


@jit
def sum_along(values, y0, x0, y1, x1):
    """Return the integral of uint8 values [iy, ix] along a line inside the grid, in values times cells."""
    length = np.hypot(y1 - y0, x1 - x0)
    n = max(1, int(np.ceil(length)))
    total = 0
    for k in range(n):
        share = (k + 0.5) / n
        total += values[int(y0 + (y1 - y0) * share + 0.5), int(x0 + (x1 - x0) * share + 0.5)]
    return total * length / n


@jit
def is_taut(node, dy, dx, slack):
    """Say whether a line along (dy, dx) (any length) supports the obstacle at a node: both its sides lie on one side of the line."""
    if node[IS_CORNER] == 0.0:
        return True
    back = dx * node[BACK_Y] - dy * node[BACK_X]
    on = dx * node[ON_Y] - dy * node[ON_X]
    least = slack * slack * (dy * dy + dx * dx)
    is_small = back * back <= least
    is_low = on * on <= least
    return ((back >= 0.0 or is_small) and (on >= 0.0 or is_low)) or (
        (back <= 0.0 or is_small) and (on <= 0.0 or is_low)
    )


@jit
def sees(field, a, b, least):
    """Say whether two nodes see each other: with `least` cells of clearance between corners; a line that ends in the middle of a gap need only be
    open."""
    if a[IS_CORNER] == 0.0 or b[IS_CORNER] == 0.0:
        return is_open(field, a[Y], a[X], b[Y], b[X])
    return is_clear(field, a[Y], a[X], b[Y], b[X], least)


@jit
def slot_of(neighbor, degree, i, j):
    """Return the slot in which node i holds node j, -1 when it does not."""
    for k in range(degree[i]):
        if neighbor[i, k] == j:
            return k
    return -1


@jit
def _put(neighbor, weight, state, degree, i, j, metres, dark, kind):
    k = degree[i]
    neighbor[i, k] = j
    weight[i, k, 0], weight[i, k, 1] = metres, dark
    state[i, k, VOTES], state[i, k, TESTS], state[i, k, OPEN], state[i, k, KIND] = 1, 1, 1, kind
    degree[i] = k + 1


@jit
def _drop(neighbor, weight, state, degree, i, j):
    k = slot_of(neighbor, degree, i, j)
    if k < 0:
        return
    last = degree[i] - 1
    neighbor[i, k] = neighbor[i, last]
    weight[i, k] = weight[i, last]
    state[i, k] = state[i, last]
    degree[i] = last


@jit
def add_edge(nodes, neighbor, weight, state, degree, price, i, j, kind, resolution):
    """Join two nodes, or change the kind of their edge; returns False when a node has no slot left."""
    k = slot_of(neighbor, degree, i, j)
    if k >= 0:
        m = slot_of(neighbor, degree, j, i)
        state[i, k, KIND] = state[j, m, KIND] = kind
        return True
    if degree[i] >= neighbor.shape[1] or degree[j] >= neighbor.shape[1]:
        return False
    y0, x0, y1, x1 = nodes[i, Y], nodes[i, X], nodes[j, Y], nodes[j, X]
    metres = np.hypot(y1 - y0, x1 - x0) * resolution
    dark = 0.0
    if nodes[i, FLOOR] == nodes[j, FLOOR] and is_inside(price, y0, x0) and is_inside(price, y1, x1):
        dark = sum_along(price, y0, x0, y1, x1) * resolution / UNIT
    _put(neighbor, weight, state, degree, i, j, metres, dark, kind)
    _put(neighbor, weight, state, degree, j, i, metres, dark, kind)
    return True


@jit
def drop_node(neighbor, weight, state, degree, i):
    """Take all edges of a node away."""
    for k in range(degree[i]):
        _drop(neighbor, weight, state, degree, neighbor[i, k], i)
    degree[i] = 0


@jit
def connect(
    nodes, is_alive, neighbor, weight, state, degree, field, price, ids, is_new, reach, least, slack, resolution
):
    """Join the nodes `ids` with all nodes of their floor within `reach` cells that they see along a line that is taut at both ends. Pairs of two
    new nodes are looked at once. Returns False when a node has no slot left; what was joined stays."""
    n = len(nodes)
    for q in range(len(ids)):
        i = ids[q]
        y0, x0 = nodes[i, Y], nodes[i, X]
        for j in range(n):
            if not is_alive[j] or j == i or (is_new[j] and j < i) or nodes[j, FLOOR] != nodes[i, FLOOR]:
                continue
            dy, dx = nodes[j, Y] - y0, nodes[j, X] - x0
            if dy * dy + dx * dx > reach * reach:
                continue
            if not is_taut(nodes[i], dy, dx, slack) or not is_taut(nodes[j], dy, dx, slack):
                continue
            if not sees(field, nodes[i], nodes[j], least):
                continue
            if slot_of(neighbor, degree, i, j) >= 0:
                continue
            if not add_edge(nodes, neighbor, weight, state, degree, price, i, j, SIGHT, resolution):
                return False
    return True


@jit
def _bounds(dirty, tile):
    """Return the box of cells (y0, y1, x0, x1) around all dirty tiles."""
    ty0, ty1, tx0, tx1 = dirty.shape[0], 0, dirty.shape[1], 0
    for iy in range(dirty.shape[0]):
        for ix in range(dirty.shape[1]):
            if dirty[iy, ix]:
                ty0, ty1, tx0, tx1 = min(ty0, iy), max(ty1, iy + 1), min(tx0, ix), max(tx1, ix + 1)
    return float(ty0 * tile), float(ty1 * tile), float(tx0 * tile), float(tx1 * tile)


@jit
def _is_dirty(dirty, bounds, tile, y0, x0, y1, x1):
    """Say whether a line passes a dirty tile; tiles beside dirty ones are dirty, too, so that steps of a tile suffice."""
    ty0, ty1, tx0, tx1 = bounds
    if max(y0, y1) < ty0 or min(y0, y1) >= ty1 or max(x0, x1) < tx0 or min(x0, x1) >= tx1:
        return False
    n = int(max(abs(y1 - y0), abs(x1 - x0)) / tile) + 1
    for k in range(n + 1):
        share = k / n
        iy, ix = int((y0 + (y1 - y0) * share) / tile), int((x0 + (x1 - x0) * share) / tile)
        if 0 <= iy < dirty.shape[0] and 0 <= ix < dirty.shape[1] and dirty[iy, ix]:
            return True
    return False


@jit
def _seen(votes, tests, result, out):
    """Push one result into a pool of tests."""
    out[0] = ((votes << 1) | result) & 255
    out[1] = min(POOL, tests + 1)


@jit
def retest(nodes, is_alive, neighbor, weight, state, degree, field, price, floor, dirty, tile, least, resolution):
    """Test the edges of a floor that pass a dirty tile again: each result is a vote. Edges of sight that were closed in all tests of the pool are
    dropped. Returns how many were tested."""
    tested = 0
    pool = np.empty(2, np.int64)
    bounds = _bounds(dirty, tile)
    for i in range(len(nodes)):
        if not is_alive[i] or nodes[i, FLOOR] != floor:
            continue
        k = 0
        while k < degree[i]:
            j = neighbor[i, k]
            k += 1
            if j < i or nodes[j, FLOOR] != floor:
                continue
            y0, x0, y1, x1 = nodes[i, Y], nodes[i, X], nodes[j, Y], nodes[j, X]
            if not _is_dirty(dirty, bounds, tile, y0, x0, y1, x1):
                continue
            tested += 1
            a, b = k - 1, slot_of(neighbor, degree, j, i)
            result = sees(field, nodes[i], nodes[j], least)
            _seen(state[i, a, VOTES], state[i, a, TESTS], int(result), pool)
            kind = state[i, a, KIND]
            if pool[0] == 0 and pool[1] >= POOL and kind != TRAJECTORY:
                _drop(neighbor, weight, state, degree, j, i)
                _drop(neighbor, weight, state, degree, i, j)
                k -= 1
                continue
            state[i, a, VOTES] = state[j, b, VOTES] = pool[0]
            state[i, a, TESTS] = state[j, b, TESTS] = pool[1]
            state[i, a, OPEN] = state[j, b, OPEN] = int(result)
            if result:
                dark = sum_along(price, y0, x0, y1, x1) * resolution / UNIT
                weight[i, a, 1] = weight[j, b, 1] = dark
    return tested


@jit
def reconnect(
    nodes,
    is_alive,
    neighbor,
    weight,
    state,
    degree,
    field,
    price,
    floor,
    freed,
    tile,
    first,
    last,
    reach,
    least,
    slack,
    resolution,
):
    """Join what `connect` would join among nodes first ... last - 1 and all after them, where the line passes a freed tile. Returns False when a
    node has no slot left."""
    n = len(nodes)
    bounds = _bounds(freed, tile)
    for i in range(first, min(last, n)):
        if not is_alive[i] or nodes[i, FLOOR] != floor:
            continue
        y0, x0 = nodes[i, Y], nodes[i, X]
        for j in range(i + 1, n):
            if not is_alive[j] or nodes[j, FLOOR] != floor:
                continue
            dy, dx = nodes[j, Y] - y0, nodes[j, X] - x0
            if dy * dy + dx * dx > reach * reach:
                continue
            if not is_taut(nodes[i], dy, dx, slack) or not is_taut(nodes[j], dy, dx, slack):
                continue
            if not _is_dirty(freed, bounds, tile, y0, x0, nodes[j, Y], nodes[j, X]):
                continue
            if slot_of(neighbor, degree, i, j) >= 0 or not sees(field, nodes[i], nodes[j], least):
                continue
            if not add_edge(nodes, neighbor, weight, state, degree, price, i, j, SIGHT, resolution):
                return False
    return True


@jit
def match_corners(found, nodes, candidates, reach, out):
    """Give each found corner (M, 8, as nodes) the nearest node of the same kind among `candidates` within `reach` cells whose directions do not
    oppose; a node is given once, to the corner that is nearest among those not yet served. `out` int64 (M,): the node or -1."""
    is_taken = np.zeros(len(candidates), np.bool_)
    for m in range(len(found)):
        best, at = reach * reach, -1
        for k in range(len(candidates)):
            if is_taken[k]:
                continue
            i = candidates[k]
            dy, dx = found[m, Y] - nodes[i, Y], found[m, X] - nodes[i, X]
            d2 = dy * dy + dx * dx
            if d2 >= best or found[m, IS_CORNER] != nodes[i, IS_CORNER]:
                continue
            alike = found[m, BACK_Y] * nodes[i, BACK_Y] + found[m, BACK_X] * nodes[i, BACK_X]
            alike += found[m, ON_Y] * nodes[i, ON_Y] + found[m, ON_X] * nodes[i, ON_X]
            if alike < 0.0:
                continue
            best, at = d2, k
        out[m] = -1
        if at >= 0:
            is_taken[at] = True
            out[m] = candidates[at]


@jit
def _is_voted(state):
    """Say whether most tests of the pool found an edge open; a third is enough for contours and ways that were driven."""
    votes, tests = state[VOTES], state[TESTS]
    count = 0
    while votes:
        count += votes & 1
        votes >>= 1
    share = 2 if state[KIND] == SIGHT else 3
    return share * count > tests


@jit
def sight_costs(nodes, is_alive, field, price, floor, y, x, heading, turning, slack, resolution, out):
    """Write the cost of the straight way from a point to every node (inf: not seen, or not taut there); a radian of turning away from the
    heading first costs `turning` metres."""
    for i in range(len(nodes)):
        out[i] = np.inf
        if not is_alive[i] or nodes[i, FLOOR] != floor:
            continue
        dy, dx = nodes[i, Y] - y, nodes[i, X] - x
        if is_taut(nodes[i], dy, dx, slack):
            out[i] = leg_cost(field, price, y, x, nodes[i, Y], nodes[i, X], resolution)
            out[i] += turning * turned(heading, dy, dx)


@jit
def turned(heading, dy, dx):
    """Return the angle (0 ... pi) between a heading and a direction."""
    if dy == 0.0 and dx == 0.0:
        return 0.0
    off = np.arctan2(dy, dx) - heading
    return abs(np.arctan2(np.sin(off), np.cos(off)))


@jit
def leg_cost(field, price, y0, x0, y1, x1, resolution):
    """Return the cost (m) of a straight leg that touches no forbidden cell, inf when it does: its length and what is unknown along it."""
    if not is_open(field, y0, x0, y1, x1):
        return np.inf
    return np.hypot(y1 - y0, x1 - x0) * resolution + sum_along(price, y0, x0, y1, x1) * resolution / UNIT


@jit
def search(
    nodes,
    is_alive,
    neighbor,
    weight,
    state,
    degree,
    start_costs,
    field,
    price,
    floor,
    gy,
    gx,
    needs_votes,
    slack,
    resolution,
    parent,
):
    """Search the least cost from a start, whose ways to the nodes are `start_costs`, to the goal (gy, gx) on a floor: A* with the straight
    distance. Sight of the goal is looked for from the nodes that are expanded. Returns (last node, cost); the node is -1 when there is
    none. `parent` gets the node before each, -1 after the start."""
    n = len(nodes)
    best = np.full(n, np.inf)
    is_done = np.zeros(n, np.bool_)
    parent[:] = -1
    heap = [(0.0, -1)]
    heap.pop()
    for i in range(n):
        if start_costs[i] < np.inf:
            best[i] = start_costs[i]
            left = np.hypot(nodes[i, Y] - gy, nodes[i, X] - gx) * resolution if nodes[i, FLOOR] == floor else 0.0
            heapq.heappush(heap, (best[i] + left, i))
    last, total = -1, np.inf
    while heap:
        bound, i = heapq.heappop(heap)
        if bound >= total:
            break
        if is_done[i]:
            continue
        is_done[i] = True
        dy, dx = gy - nodes[i, Y], gx - nodes[i, X]
        is_near = nodes[i, FLOOR] == floor and best[i] + np.hypot(dy, dx) * resolution < total
        if is_near and is_taut(nodes[i], dy, dx, slack):
            end = best[i] + leg_cost(field, price, gy, gx, nodes[i, Y], nodes[i, X], resolution)
            if end < total:
                total, last = end, i
        for k in range(degree[i]):
            j = int(neighbor[i, k]) + 0  # 64 bits wide, as the other numbers of nodes in the heap
            if is_done[j] or not state[i, k, OPEN] or (needs_votes and not _is_voted(state[i, k])):
                continue
            there = best[i] + float(weight[i, k, 0]) + float(weight[i, k, 1])
            if there < best[j]:
                best[j] = there
                parent[j] = i
                left = np.hypot(nodes[j, Y] - gy, nodes[j, X] - gx) * resolution if nodes[j, FLOOR] == floor else 0.0
                heapq.heappush(heap, (there + left, j))
    return last, total


@jit
def extend(field, points, least, wanted, sweeps, step):
    """Move the inner points of a path (N, 2) away from what is near, up to `wanted` cells of clearance, while both legs of a point keep
    `least` cells (or what they had). In place."""
    n = len(points)
    for _ in range(sweeps):
        for k in range(1, n - 1):
            y, x = points[k, 0], points[k, 1]
            here = clearance(field, y, x) if is_inside(field, y, x) else 0.0
            if here >= wanted or here <= 0.0:
                continue
            best, best_y, best_x = here + 0.02, y, x
            for m in range(16):
                ny, nx = y + step * np.sin(m * np.pi / 8.0), x + step * np.cos(m * np.pi / 8.0)
                if not is_inside(field, ny, nx):
                    continue
                there = clearance(field, ny, nx)
                if there <= best:
                    continue
                if not is_clear(field, points[k - 1, 0], points[k - 1, 1], ny, nx, least):
                    continue
                if not is_clear(field, ny, nx, points[k + 1, 0], points[k + 1, 1], least):
                    continue
                best, best_y, best_x = there, ny, nx
            points[k, 0], points[k, 1] = best_y, best_x


@jit
def flood(field, known, sy, sx, reached):
    """Mark in `reached` uint8 [iy, ix] what is connected with a cell over cells that are not forbidden: 1 known, 2 unknown; 8 neighbours, no
    cut corners. Returns how many unknown ones were reached."""
    height, width = field.shape
    reached[:] = 0
    queue = np.empty(height * width, np.int64)
    queue[0] = sy * width + sx
    reached[sy, sx] = 1 if known[sy, sx] else 2
    head, tail, dark = 0, 1, 0
    while head < tail:
        y, x = queue[head] // width, queue[head] % width
        head += 1
        if reached[y, x] == 2:
            dark += 1
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                ny, nx = y + dy, x + dx
                if not (0 <= ny < height and 0 <= nx < width) or reached[ny, nx] or field[ny, nx] == 0:
                    continue
                if dy != 0 and dx != 0 and (field[ny, x] == 0 or field[y, nx] == 0):
                    continue
                reached[ny, nx] = 1 if known[ny, nx] else 2
                queue[tail] = ny * width + nx
                tail += 1
    return dark


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    n, slots = 3, 4
    nodes, is_alive = np.zeros((n, 8)), np.ones(n, np.bool_)
    nodes[:, :2] = [[1.0, 1.0], [1.0, 6.0], [6.0, 6.0]]
    neighbor, degree = np.zeros((n, slots), np.int32), np.zeros(n, np.int32)
    weight, state = np.zeros((n, slots, 2), np.float32), np.zeros((n, slots, 4), np.uint8)
    field, price = np.full((8, 8), 255, np.uint8), np.ones((8, 8), np.uint8)
    known = price
    ids, is_new = np.arange(2), np.zeros(n, np.bool_)
    graph = (nodes, is_alive, neighbor, weight, state, degree)
    connect(*graph, field, price, ids, is_new, 100.0, 1.0, 0.1, 0.05)
    add_edge(nodes, neighbor, weight, state, degree, price, 0, 2, TRAJECTORY, 0.05)
    retest(*graph, field, price, 0.0, np.ones((1, 1), np.uint8), 16, 1.0, 0.05)
    reconnect(*graph, field, price, 0.0, np.ones((1, 1), np.uint8), 16, 0, n, 100.0, 1.0, 0.1, 0.05)
    match_corners(nodes[:2], nodes, np.arange(n), 2.0, np.empty(2, np.int64))
    costs, parent = np.zeros(n), np.zeros(n, np.int32)
    sight_costs(nodes, is_alive, field, price, 0.0, 2.0, 2.0, 0.0, 0.3, 0.1, 0.05, costs)
    search(*graph, costs, field, price, 0.0, 5.0, 5.0, True, 0.1, 0.05, parent)
    drop_node(neighbor, weight, state, degree, 1)
    points = np.array([[1.0, 1.0], [3.0, 3.0], [5.0, 1.0]])
    extend(field, points, 1.0, 6.0, 1, 1.0)
    flood(field, known, 1, 1, np.zeros((8, 8), np.uint8))
