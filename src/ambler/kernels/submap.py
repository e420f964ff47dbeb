"""Kernels on probability grids: scan insertion and the composition of the global map.

A cell is a uint16: 0 unknown, 1 ... 32767 a probability of 0.1 ... 0.9; bit 15 marks "already updated by this scan"
(after Cartographer's probability grid). Hits are applied first, then misses along the rays; a cell changes once per scan.
"""

import math

import numpy as np

from ambler.kernels.jit import jit

MARK = np.uint16(32768)
VALUE = np.uint16(32767)
EVEN, SURE = np.uint16(16384), np.uint16(24576)  # probabilities of 0.5 and 0.7
AT_END = 0.2  # metres before a return in which its ray is as low as what it meets


@jit
def _update(flat, place, table, touched, n):
    value = flat[place]
    if value & MARK:
        return n
    flat[place] = table[value] | MARK
    touched[n] = place
    return n + np.uint64(1)


@jit
def _keep(flat, place, touched, n):
    """Count a cell as updated by this scan without changing it."""
    value = flat[place]
    if value & MARK:
        return n
    flat[place] = value | MARK
    touched[n] = place
    return n + np.uint64(1)


@jit
def _clear_ray(flat, height, width, x0, y0, x1, y1, high_to, once, table, touched, n):
    """Apply a miss to every cell that the segment crosses, the end cell excluded; coordinates in cells. Up to the share `high_to` of its length
    the ray passes over what stands there: cells in which more was seen than `once`, the value of a single return, are left: a beam that an edge tears in two meets nothing where it seems to."""
    ix, iy = int(math.floor(x0)), int(math.floor(y0))
    ex, ey = int(math.floor(x1)), int(math.floor(y1))
    dx, dy = x1 - x0, y1 - y0
    step_x = 1 if dx > 0 else -1
    step_y = 1 if dy > 0 else -1
    delta_x = abs(1.0 / dx) if dx != 0.0 else 1e30
    delta_y = abs(1.0 / dy) if dy != 0.0 else 1e30
    next_x = ((ix + 1 - x0) if dx > 0 else (x0 - ix)) * delta_x
    next_y = ((iy + 1 - y0) if dy > 0 else (y0 - iy)) * delta_y
    place, row = iy * width + ix, step_y * width
    for _ in range(abs(ex - ix) + abs(ey - iy)):
        if 0 <= ix < width and 0 <= iy < height:
            here = np.uint64(place)
            if not (min(next_x, next_y) < high_to and flat[here] & VALUE > once):
                n = _update(flat, here, table, touched, n)
        # Never past the end cell: on a border (x0 an integer, dx = 0) `next_x` is 0, and near an end both carry rounding.
        if ix != ex and (iy == ey or next_x < next_y):
            next_x += delta_x
            ix += step_x
            place += step_x
        else:
            next_y += delta_y
            iy += step_y
            place += row
    return n


@jit
def _share(low, dx, dy, resolution, at_end):
    """Return the share of a ray (dx, dy in cells) that is not yet `low` metres long, without its last `at_end` metres."""
    length = math.hypot(dx, dy) * resolution
    return min(low, length - at_end) / length if length > 0.0 else 0.0


@jit
def insert_scan(
    cells,
    starts,
    free_starts,
    points,
    free_points,
    surfaces,
    sure,
    lows,
    free_lows,
    frame,
    hit_table,
    miss_table,
    touched,
):
    """Insert one scan into a grid; returns how many cells changed.

    `cells` uint16 (H, W); `starts` and `free_starts` float64, where the rays start, (N, 2) or (1, 2) for one start of all; `points` and
    `free_points` float32 (N, 2), all in the grid's frame; `surfaces` float32 (K, 2) keep the cells that they lie in from being made free: rays along a wall pass through the nearer half of its cells. The first `sure` of them are hits in cells that are not known yet; the others keep only what was seen often, and make the rest no freer than even; `lows`, `free_lows`
    float64 (N,), (M,) are the metres up to which a ray passes over things (none: nowhere), but for what it meets at its end; `frame` float64 (3,) resolution, x, y of the grid's outer corner; `touched` int64 (>= H * W,) scratch.
    """
    height, width = cells.shape
    # With places that are never negative: else the compiler asks of each whether it is.
    flat = cells.reshape(height * width)
    inverse = 1.0 / frame[0]
    n = np.uint64(0)
    for i in range(points.shape[0]):
        ix = int(math.floor((points[i, 0] - frame[1]) * inverse))
        iy = int(math.floor((points[i, 1] - frame[2]) * inverse))
        if 0 <= ix < width and 0 <= iy < height:
            n = _update(flat, np.uint64(iy * width + ix), hit_table, touched, n)
    for i in range(surfaces.shape[0]):
        ix = int(math.floor((surfaces[i, 0] - frame[1]) * inverse))
        iy = int(math.floor((surfaces[i, 1] - frame[2]) * inverse))
        if 0 <= ix < width and 0 <= iy < height:
            place = np.uint64(iy * width + ix)
            value = flat[place]
            if i < sure and value == 0:
                n = _update(flat, place, hit_table, touched, n)
            elif i < sure or value >= SURE or 0 < value <= EVEN:
                n = _keep(flat, place, touched, n)
    for i in range(points.shape[0]):
        k = i if starts.shape[0] > 1 else 0
        x0, y0 = (starts[k, 0] - frame[1]) * inverse, (starts[k, 1] - frame[2]) * inverse
        x1, y1 = (points[i, 0] - frame[1]) * inverse, (points[i, 1] - frame[2]) * inverse
        high_to = _share(lows[i], x1 - x0, y1 - y0, frame[0], AT_END) if lows.shape[0] > 0 else 0.0
        n = _clear_ray(flat, height, width, x0, y0, x1, y1, high_to, hit_table[0], miss_table, touched, n)
    for i in range(free_points.shape[0]):
        k = i if free_starts.shape[0] > 1 else 0
        x0, y0 = (free_starts[k, 0] - frame[1]) * inverse, (free_starts[k, 1] - frame[2]) * inverse
        x1, y1 = (free_points[i, 0] - frame[1]) * inverse, (free_points[i, 1] - frame[2]) * inverse
        high_to = _share(free_lows[i], x1 - x0, y1 - y0, frame[0], 0.0) if free_lows.shape[0] > 0 else 0.0
        n = _clear_ray(flat, height, width, x0, y0, x1, y1, high_to, hit_table[0], miss_table, touched, n)
    for k in range(n):
        place = np.uint64(touched[k])
        flat[place] = flat[place] & VALUE
    return np.int64(n)


@jit
def known_box(cells, box):
    """Write (row_min, row_max, column_min, column_max) of the known cells into `box` int64 (4,); an empty grid gives row_min > row_max."""
    height, width = cells.shape
    y0, y1, x0, x1 = height, -1, width, -1
    for iy in range(height):
        first = 0
        while first < width and cells[iy, first] == 0:
            first += 1
        if first == width:
            continue
        last = width - 1
        while last > x1 and cells[iy, last] == 0:
            last -= 1
        y0, y1 = min(y0, iy), iy
        x0, x1 = min(x0, first), max(x1, last)
    box[0], box[1], box[2], box[3] = y0, y1, x0, x1


@jit
def _is_beside_occupied(cells, iy, ix, occupied):
    """Whether one of the four cells beside a cell has at least the value `occupied`."""
    height, width = np.uint64(cells.shape[0]), np.uint64(cells.shape[1])
    # What is left of or below 0 is larger than any grid.
    return (
        (iy - np.uint64(1) < height and cells[iy - np.uint64(1), ix] >= occupied)
        or (iy + np.uint64(1) < height and cells[iy + np.uint64(1), ix] >= occupied)
        or (ix - np.uint64(1) < width and cells[iy, ix - np.uint64(1)] >= occupied)
        or (ix + np.uint64(1) < width and cells[iy, ix + np.uint64(1)] >= occupied)
    )


@jit
def _least_occupied(log_odds):
    """Return the least value of a cell that speaks for something; `log_odds` rise from value 1 on."""
    low, high = 1, log_odds.shape[0]
    while low < high:
        middle = (low + high) // 2
        if log_odds[middle] > 0.0:
            high = middle
        else:
            low = middle + 1
    return low


@jit
def composed_box(size, frame, pose, target_frame, target_size):
    """Return which cells iy0, iy1, ix0, ix1 of a global grid of `target_size` (H, W) a submap of `size` (h, w) may cover."""
    h, w = size
    height, width = target_size
    res = frame[0]
    target = target_frame[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x_low, y_low = 1e30, 1e30
    x_high, y_high = -1e30, -1e30
    for k in range(4):
        px = frame[1] + (w * res if k & 1 else 0.0)
        py = frame[2] + (h * res if k & 2 else 0.0)
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        x_low, x_high = min(x_low, x), max(x_high, x)
        y_low, y_high = min(y_low, y), max(y_high, y)
    ix0 = max(0, int(math.floor((x_low - target_frame[1]) / target)))
    ix1 = min(width, int(math.ceil((x_high - target_frame[1]) / target)) + 1)
    iy0 = max(0, int(math.floor((y_low - target_frame[2]) / target)))
    iy1 = min(height, int(math.ceil((y_high - target_frame[2]) / target)) + 1)
    return iy0, iy1, ix0, ix1


@jit
def compose(cells, frame, pose, log_odds, beside_occupied, target_frame, evidence, known):
    """Add a submap's log odds to the global grid, each global cell reading the submap cell under its centre.

    A free cell beside an occupied one counts `beside_occupied` times its log odds: submaps that place a wall one cell apart must not
    wipe it out for each other.

    `cells` uint16 (h, w) with `frame` (resolution, x, y) in the submap frame; `pose` float64 (3,) map_from_submap;
    `log_odds` float32 (32768,), rising from value 1 on; `target_frame` (resolution, x, y); `evidence` float32 (H, W), `known` uint8 (H, W), of which only the box that
    `composed_box` tells is touched.
    """
    h, w = cells.shape
    iy0, iy1, ix0, ix1 = composed_box(cells.shape, frame, pose, target_frame, evidence.shape)
    res = frame[0]
    target = target_frame[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    inverse = 1.0 / res
    step_x, step_y = c * target * inverse, -s * target * inverse
    occupied = np.uint16(min(_least_occupied(log_odds), 65535))
    for iy in range(iy0, iy1):
        gy = target_frame[2] + (iy + 0.5) * target - pose[1]
        gx = target_frame[1] + (ix0 + 0.5) * target - pose[0]
        sx = (c * gx + s * gy - frame[1]) * inverse
        sy = (-s * gx + c * gy - frame[2]) * inverse
        for ix in range(ix0, ix1):
            k = ix - ix0
            fx = sx + k * step_x
            fy = sy + k * step_y
            if fx >= 0.0 and fy >= 0.0:
                jx, jy = np.uint64(fx), np.uint64(fy)
                if jx < np.uint64(w) and jy < np.uint64(h):
                    value = cells[jy, jx]
                    if value != 0:
                        added = log_odds[value]
                        if added < 0.0 and _is_beside_occupied(cells, jy, jx, occupied):
                            added *= beside_occupied
                        evidence[iy, ix] += added
                        known[iy, ix] = 1


@jit
def to_occupancy(evidence, known, free_below, occupied_above, part, corner, occupancy):
    """Threshold summed log odds into int8 occupancy: -1 unknown or undecided, 0 free, 100 occupied. Of the sums only the `part`
    (iy0, iy1, ix0, ix1) is told, in `occupancy`, which begins at their cell `corner` (iy, ix)."""
    width = np.uint64(part[3] - part[2])
    for iy in range(part[0], part[1]):
        # Rows from their first cell on, and no branches: many cells at once.
        sums, seen = evidence[iy, part[2] :], known[iy, part[2] :]
        row = occupancy[iy - corner[0], part[2] - corner[1] :]
        for k in range(width):
            value = np.int8(100) if sums[k] > occupied_above else np.int8(0) if sums[k] < free_below else np.int8(-1)
            row[k] = value if seen[k] != 0 else np.int8(-1)


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    cells = np.zeros((4, 4), np.uint16)
    table = np.ones(32768, np.uint16)
    points = np.ones((1, 2), np.float32)
    frame = np.array([1.0, 0.0, 0.0])
    starts = np.zeros((1, 2))
    lows = np.zeros(0)
    insert_scan(
        cells, starts, starts, points, points, points, 0, lows, lows, frame, table, table, np.zeros(16, np.int64)
    )
    known_box(cells, np.zeros(4, np.int64))
    evidence = np.zeros((4, 4), np.float32)
    known = np.zeros((4, 4), np.uint8)
    compose(cells, frame, np.zeros(3), np.zeros(32768, np.float32), 0.5, frame, evidence, known)
    composed_box((4, 4), frame, np.zeros(3), frame, (4, 4))
    to_occupancy(evidence, known, 0.0, 0.0, (1, 3, 1, 3), (1, 1), np.zeros((2, 2), np.int8))
