"""The nodes and edges of a visibility graph, the votes of its edges, and the search over it; `kernels.line_of_sight` says what sees what.

Coordinates are (y, x) in cells. Nodes are float64 (N, 8): y, x, direction back (y, x) and on (y, x) along the contour, floor, and whether it is a corner at
all (a path can end a leg there only where the leg is taut). Edges lie in slots [node, k]: `neighbor` int32, `weight` float32 (metres, and the price in
metres of what is unknown along it), `state` uint8 (votes, tests, open now, kind).
"""

import heapq
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit
from ambler.kernels.line_of_sight import UNIT, is_clear, is_inside, is_open, leg_cost, sum_along, turned

Y, X, BACK_Y, BACK_X, ON_Y, ON_X, FLOOR, IS_CORNER = range(8)
VOTES, TESTS, OPEN, KIND = range(4)
SIGHT, CONTOUR, TRAJECTORY = range(3)
POOL = 8  # tests that an edge remembers


class Graph(NamedTuple):
    """Nodes (N, 8), which of them are in use, the slots of their edges (N, K), and how many slots each node uses (N,)."""

    nodes: NDArray[np.float64]
    is_alive: NDArray[np.bool_]
    neighbor: NDArray[np.int32]
    weight: NDArray[np.float32]
    state: NDArray[np.uint8]
    degree: NDArray[np.int32]


class Ground(NamedTuple):
    """A floor: its clearance and the price of its cells, uint8 [iy, ix], its number, and metres to a cell."""

    field: NDArray[np.uint8]
    price: NDArray[np.uint8]
    floor: int
    resolution: float


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
def slot_of(graph, i, j):
    """Return the slot in which node i holds node j, -1 when it does not."""
    for k in range(graph.degree[i]):
        if graph.neighbor[i, k] == j:
            return k
    return -1


@jit
def _put(graph, i, j, metres, dark, kind):
    k, state = graph.degree[i], graph.state
    graph.neighbor[i, k] = j
    graph.weight[i, k, 0], graph.weight[i, k, 1] = metres, dark
    state[i, k, VOTES], state[i, k, TESTS], state[i, k, OPEN], state[i, k, KIND] = 1, 1, 1, kind
    graph.degree[i] = k + 1


@jit
def _drop(graph, i, j):
    k = slot_of(graph, i, j)
    if k < 0:
        return
    last = graph.degree[i] - 1
    graph.neighbor[i, k] = graph.neighbor[i, last]
    graph.weight[i, k] = graph.weight[i, last]
    graph.state[i, k] = graph.state[i, last]
    graph.degree[i] = last


@jit
def add_edge(graph, ground, i, j, kind):
    """Join two nodes, or change the kind of their edge; returns False when a node has no slot left."""
    nodes, degree, price, resolution = graph.nodes, graph.degree, ground.price, ground.resolution
    slots = graph.neighbor.shape[1]
    k = slot_of(graph, i, j)
    if k >= 0:
        m = slot_of(graph, j, i)
        graph.state[i, k, KIND] = graph.state[j, m, KIND] = kind
        return True
    if degree[i] >= slots or degree[j] >= slots:
        return False
    y0, x0, y1, x1 = nodes[i, Y], nodes[i, X], nodes[j, Y], nodes[j, X]
    metres = np.hypot(y1 - y0, x1 - x0) * resolution
    dark = 0.0
    if nodes[i, FLOOR] == nodes[j, FLOOR] and is_inside(price, y0, x0) and is_inside(price, y1, x1):
        dark = sum_along(price, y0, x0, y1, x1) * resolution / UNIT
    _put(graph, i, j, metres, dark, kind)
    _put(graph, j, i, metres, dark, kind)
    return True


@jit
def drop_node(graph, i):
    """Take all edges of a node away."""
    for k in range(graph.degree[i]):
        _drop(graph, graph.neighbor[i, k], i)
    graph.degree[i] = 0


@jit
def connect(graph, ground, ids, is_new, reach, least, slack):
    """Join the nodes `ids` with all nodes of their floor within `reach` cells that they see along a line that is taut at both ends. Pairs of two
    new nodes are looked at once. Returns False when a node has no slot left; what was joined stays."""
    nodes, is_alive = graph.nodes, graph.is_alive
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
            if not sees(ground.field, nodes[i], nodes[j], least):
                continue
            if slot_of(graph, i, j) >= 0:
                continue
            if not add_edge(graph, ground, i, j, SIGHT):
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
def retest(graph, ground, dirty, tile, least):
    """Test the edges of a floor that pass a dirty tile again: each result is a vote. Edges of sight that were closed in all tests of the pool are
    dropped. Returns how many were tested."""
    nodes, is_alive, neighbor, weight, state, degree = graph
    field, price, floor, resolution = ground
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
            a, b = k - 1, slot_of(graph, j, i)
            result = sees(field, nodes[i], nodes[j], least)
            _seen(state[i, a, VOTES], state[i, a, TESTS], int(result), pool)
            kind = state[i, a, KIND]
            if pool[0] == 0 and pool[1] >= POOL and kind != TRAJECTORY:
                _drop(graph, j, i)
                _drop(graph, i, j)
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
def reconnect(graph, ground, freed, tile, first, last, reach, least, slack):
    """Join what `connect` would join among nodes first ... last - 1 and all after them, where the line passes a freed tile. Returns False when a
    node has no slot left."""
    nodes, is_alive, floor = graph.nodes, graph.is_alive, ground.floor
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
            if slot_of(graph, i, j) >= 0 or not sees(ground.field, nodes[i], nodes[j], least):
                continue
            if not add_edge(graph, ground, i, j, SIGHT):
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
def sight_costs(graph, ground, y, x, heading, turning, slack, out):
    """Write the cost of the straight way from a point to every node (inf: not seen, or not taut there); a radian of turning away from the
    heading first costs `turning` metres."""
    nodes, is_alive = graph.nodes, graph.is_alive
    field, price, floor, resolution = ground
    for i in range(len(nodes)):
        out[i] = np.inf
        if not is_alive[i] or nodes[i, FLOOR] != floor:
            continue
        dy, dx = nodes[i, Y] - y, nodes[i, X] - x
        if is_taut(nodes[i], dy, dx, slack):
            out[i] = leg_cost(field, price, y, x, nodes[i, Y], nodes[i, X], resolution)
            out[i] += turning * turned(heading, dy, dx)


@jit
def search(graph, ground, start_costs, gy, gx, needs_votes, slack, parent):
    """Search the least cost from a start, whose ways to the nodes are `start_costs`, to the goal (gy, gx) on a floor: A* with the straight
    distance. Sight of the goal is looked for from the nodes that are expanded. Returns (last node, cost); the node is -1 when there is
    none. `parent` gets the node before each, -1 after the start."""
    nodes, _, neighbor, weight, state, degree = graph
    field, price, floor, resolution = ground
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


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    n, slots = 3, 4
    nodes, is_alive = np.zeros((n, 8)), np.ones(n, np.bool_)
    nodes[:, :2] = [[1.0, 1.0], [1.0, 6.0], [6.0, 6.0]]
    neighbor, degree = np.zeros((n, slots), np.int32), np.zeros(n, np.int32)
    weight, state = np.zeros((n, slots, 2), np.float32), np.zeros((n, slots, 4), np.uint8)
    ground = Ground(np.full((8, 8), 255, np.uint8), np.ones((8, 8), np.uint8), 0, 0.05)
    ids, is_new, dirty = np.arange(2), np.zeros(n, np.bool_), np.ones((1, 1), np.uint8)
    graph = Graph(nodes, is_alive, neighbor, weight, state, degree)
    connect(graph, ground, ids, is_new, 100.0, 1.0, 0.1)
    add_edge(graph, ground, 0, 2, TRAJECTORY)
    retest(graph, ground, dirty, 16, 1.0)
    reconnect(graph, ground, dirty, 16, 0, n, 100.0, 1.0, 0.1)
    match_corners(nodes[:2], nodes, np.arange(n), 2.0, np.empty(2, np.int64))
    costs, parent = np.zeros(n), np.zeros(n, np.int32)
    sight_costs(graph, ground, 2.0, 2.0, 0.0, 0.3, 0.1, costs)
    search(graph, ground, costs, 5.0, 5.0, True, 0.1, parent)
    slot_of(graph, 0, 1)
    drop_node(graph, 1)
