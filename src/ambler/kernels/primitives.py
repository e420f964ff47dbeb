"""Motion primitives against obstacles: which paths a footprint cannot follow, and which group of them leads best where one wants to go.

A set of paths is a bitmap, uint64 (WORDS,). A sweep table uint64 (H, W, WORDS) says of every cell of the paths' frame which paths'
footprints cover it, so that one point costs one look-up and a few OR operations for each direction in which the paths may begin.
"""

import math

import numpy as np

from ambler.kernels.footprint import edge_clearance
from ambler.kernels.jit import jit

WORD = 64
WORDS = 6  # of 64 paths each: 343 paths fit
LEVELS = 3  # of points: what blocks, what is rough, what is very rough


@jit
def sweep_paths(points, headings, normals, offsets, spacing, origin, cell, table):
    """Set the bit of every path in all cells of `table` (H, W, WORDS) whose centres its footprint covers.

    `points` float64 (P, M, 2) and `headings` (P, M) are the poses of the base along the paths; poses are skipped while no point of the footprint
    has moved by `spacing` metres. `origin` (2,) is the corner of the table, `cell` the side of its square cells.
    """
    height, width = table.shape[0], table.shape[1]
    edges = normals.shape[0]
    reach = 0.0
    for e in range(edges):
        reach = max(reach, offsets[e])
    corner = np.empty((edges, 2))
    for e in range(edges):
        f = (e + 1) % edges
        det = normals[e, 0] * normals[f, 1] - normals[e, 1] * normals[f, 0]
        corner[e, 0] = (offsets[e] * normals[f, 1] - offsets[f] * normals[e, 1]) / det
        corner[e, 1] = (normals[e, 0] * offsets[f] - normals[f, 0] * offsets[e]) / det
        reach = max(reach, math.sqrt(corner[e, 0] ** 2 + corner[e, 1] ** 2))
    last = points.shape[1] - 1
    for p in range(points.shape[0]):
        word, bit = p // WORD, np.uint64(1) << np.uint64(p % WORD)
        px, py, pa = 1e9, 1e9, 0.0
        for k in range(last + 1):
            gx, gy, a = points[p, k, 0], points[p, k, 1], headings[p, k]
            moved = math.sqrt((gx - px) ** 2 + (gy - py) ** 2) + abs(a - pa) * reach
            if moved < spacing and k < last:
                continue
            px, py, pa = gx, gy, a
            c, s = math.cos(a), math.sin(a)
            low_y, high_y = 1e30, -1e30
            for e in range(edges):
                y = gy + s * corner[e, 0] + c * corner[e, 1]
                low_y, high_y = min(low_y, y), max(high_y, y)
            first = max(0, int(math.ceil((low_y - origin[1]) / cell - 0.5)))
            final = min(height - 1, int(math.floor((high_y - origin[1]) / cell - 0.5)))
            for iy in range(first, final + 1):
                dy = origin[1] + (iy + 0.5) * cell - gy
                low, high = -1e30, 1e30
                for e in range(edges):
                    nx = c * normals[e, 0] - s * normals[e, 1]
                    rest = offsets[e] - (s * normals[e, 0] + c * normals[e, 1]) * dy
                    if abs(nx) < 1e-12:
                        if rest < 0.0:
                            high = -1e30
                    elif nx > 0.0:
                        high = min(high, rest / nx)
                    else:
                        low = max(low, rest / nx)
                if low > high:
                    continue
                begin = max(0, int(math.ceil((gx + low - origin[0]) / cell - 0.5)))
                end = min(width - 1, int(math.floor((gx + high - origin[0]) / cell - 0.5)))
                for ix in range(begin, end + 1):
                    table[iy, ix, word] |= bit


@jit
def points_around(costs, start, resolution, ranges, rough, normals, offsets, points, levels):
    """Write what a window of costs uint8 (H, W) holds around the base at `start` (x, y, yaw), measured from its corner: points (N, 2) in the base
    frame and their levels (N,), 0 for lethal cells, 1 and 2 for costs from `rough` (2,) on. Returns N, at most the length of `points`.

    `ranges` is (how far points count, clearance from the footprint below which they do not): what the robot touches already says nothing about where it may go.
    """
    reach, skin = ranges[0], ranges[1]
    c, s = math.cos(start[2]), math.sin(start[2])
    height, width = costs.shape
    y0 = max(0, int((start[1] - reach) / resolution))
    y1 = min(height, int((start[1] + reach) / resolution) + 1)
    x0 = max(0, int((start[0] - reach) / resolution))
    x1 = min(width, int((start[0] + reach) / resolution) + 1)
    count = 0
    for iy in range(y0, y1):
        dy = (iy + 0.5) * resolution - start[1]
        for ix in range(x0, x1):
            value = costs[iy, ix]
            if value < rough[0] or value in (253, 255):
                continue
            level = 0 if value == 254 else (2 if value >= rough[1] else 1)
            dx = (ix + 0.5) * resolution - start[0]
            if dx * dx + dy * dy > reach * reach:
                continue
            bx, by = c * dx + s * dy, c * dy - s * dx
            if level == 0 and edge_clearance(bx, by, normals, offsets) < skin:
                continue
            if count == points.shape[0]:
                return count
            points[count, 0], points[count, 1], levels[count] = bx, by, level
            count += 1
    return count


@jit
def block_paths(points, levels, reach, cos, sin, may, tables, origin, cell, blocked):
    """Collect the paths that points (N, 2) of the base frame meet, for every direction: `blocked` uint64 (LEVELS, D, WORDS).

    `cos`, `sin` (D,) are those of the directions, `may` (D,) which of them count. `tables` is (1, H, W, WORDS) for all directions alike,
    or (D, H, W, WORDS). Points farther than `reach` do not count.
    """
    height, width = tables.shape[1], tables.shape[2]
    per_metre = 1.0 / cell
    is_one = tables.shape[0] == 1
    for level in range(LEVELS):
        for d in range(cos.shape[0]):
            for w in range(WORDS):
                blocked[level, d, w] = np.uint64(0)
    for n in range(points.shape[0]):
        x, y, level = points[n, 0], points[n, 1], levels[n]
        if x * x + y * y > reach * reach:
            continue
        for d in range(cos.shape[0]):
            if not may[d]:
                continue
            u = (cos[d] * x + sin[d] * y - origin[0]) * per_metre
            v = (cos[d] * y - sin[d] * x - origin[1]) * per_metre
            if u < 0.0 or v < 0.0:
                continue
            ix, iy = int(u), int(v)
            if ix >= width or iy >= height:
                continue
            t = 0 if is_one else d
            for w in range(WORDS):
                blocked[level, d, w] |= tables[t, iy, ix, w]


@jit
def score_groups(blocked, may, bearing, directions, weights, ends, groups, plan, scores, free):
    """Write for every direction and group the sum of the scores of its free paths, float64 (D, G), and how many are free, int64 (D, G).

    `bearing` is that of the goal; `directions` (D,) and their `weights` (D,); `ends` (P,) where paths end up going. `plan` is (angle at which a path is
    worth nothing, factors of rough and of very rough paths).
    """
    for d in range(directions.shape[0]):
        for g in range(scores.shape[1]):
            scores[d, g], free[d, g] = 0.0, 0
        if not may[d]:
            continue
        for p in range(ends.shape[0]):
            word, bit = p // WORD, np.uint64(1) << np.uint64(p % WORD)
            if blocked[0, d, word] & bit:
                continue
            free[d, groups[p]] += 1
            off = bearing - ends[p] - directions[d]
            off = abs(off - 2.0 * math.pi * math.floor(off / (2.0 * math.pi) + 0.5))
            if off >= plan[0]:
                continue
            score = (1.0 - math.sqrt(math.sqrt(off / plan[0]))) * weights[d, groups[p]]
            if blocked[2, d, word] & bit:
                score *= plan[2]
            elif blocked[1, d, word] & bit:
                score *= plan[1]
            scores[d, groups[p]] += score


@jit
def rough_share(blocked, d, group, groups, out):
    """Write the shares of the free paths of one direction and group that are at least rough, and very rough."""
    total, some, much = 0, 0, 0
    for p in range(groups.shape[0]):
        word, bit = p // WORD, np.uint64(1) << np.uint64(p % WORD)
        if groups[p] != group or blocked[0, d, word] & bit:
            continue
        total += 1
        is_very = (blocked[2, d, word] & bit) != 0
        much += is_very
        some += is_very or (blocked[1, d, word] & bit) != 0
    out[0], out[1] = some / max(1, total), much / max(1, total)


def warm_up() -> None:
    """Compile every kernel of this module."""
    normals = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    offsets, origin = np.full(4, 0.1), np.array([-0.2, -0.2])
    table = np.zeros((8, 8, WORDS), np.uint64)
    sweep_paths(np.zeros((2, 3, 2)), np.zeros((2, 3)), normals, offsets, 0.02, origin, 0.05, table)
    points, levels = np.zeros((4, 2)), np.zeros(4, np.uint8)
    costs, rough = np.full((3, 3), 254, np.uint8), np.array([30, 60], np.uint8)
    points_around(costs, np.array([2.0, 2.0, 0.0]), 1.0, np.array([3.0, 0.0]), rough, normals, offsets, points, levels)
    may, blocked = np.ones(2, np.bool_), np.zeros((LEVELS, 2, WORDS), np.uint64)
    tables = table[None].copy()
    tables.flags.writeable = False  # as finished tables and the library's arrays are
    block_paths(points, levels, 1.0, np.ones(2), np.zeros(2), may, tables, origin, 0.05, blocked)
    groups, scores, free = np.zeros(2, np.int64), np.empty((2, 7)), np.empty((2, 7), np.int64)
    weights, plan, ends = np.ones((2, 7)), np.array([0.9, 0.5, 0.2]), np.zeros(2)
    for array in (ends, groups):
        array.flags.writeable = False
    score_groups(blocked, may, 0.0, np.zeros(2), weights, ends, groups, plan, scores, free)
    rough_share(blocked, 0, 0, groups, np.empty(2))
