"""Marking and clearing of an obstacle layer: rays through cells, points, polygons, and the mapping of occupancy to cost."""

import math

import numpy as np

from ambler.kernels.jit import jit

FREE, LETHAL, UNKNOWN = 0, 254, 255
GRAZE = (
    0.05  # metres that a ray must pass below the top of a thing to prove it gone: noise of ranges and of a body's lean
)


@jit
def _clear_ray(layer, tops, x0, y0, x1, y1, ends_free, z, sink):
    """Free the cells that the segment passes, in cell units; the cell of its end only when `ends_free`.

    The ray begins at height `z` and sinks by `sink` along the segment; what it passes over stays (`tops` without cells: nothing does;
    a top of 0: may be floor, does not stay).
    """
    height, width = layer.shape
    ix, iy = int(math.floor(x0)), int(math.floor(y0))
    end_x, end_y = int(math.floor(x1)), int(math.floor(y1))
    dx, dy = x1 - x0, y1 - y0
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    far = 1e30
    per_x = abs(1.0 / dx) if dx != 0.0 else far
    per_y = abs(1.0 / dy) if dy != 0.0 else far
    next_x = ((ix + 1 - x0) if dx > 0 else (x0 - ix)) * per_x if dx != 0.0 else far
    next_y = ((iy + 1 - y0) if dy > 0 else (y0 - iy)) * per_y if dy != 0.0 else far
    is_over = tops.shape[0] > 0
    for _ in range(abs(end_x - ix) + abs(end_y - iy)):
        if 0 <= iy < height and 0 <= ix < width:
            lowest = z - sink * min(next_x, next_y, 1.0) if is_over else 0.0
            if not (is_over and layer[iy, ix] == LETHAL and 0.0 < tops[iy, ix] < lowest + GRAZE):
                layer[iy, ix] = FREE
        if next_x < next_y:
            ix += step_x
            next_x += per_x
        else:
            iy += step_y
            next_y += per_y
    if not (ends_free and 0 <= end_y < height and 0 <= end_x < width):
        return
    if not (is_over and layer[end_y, end_x] == LETHAL and 0.0 < tops[end_y, end_x] < z - sink + GRAZE):
        layer[end_y, end_x] = FREE


@jit
def clear_rays(layer, tops, origin_x, origin_y, resolution, starts, ends, max_range, ends_free, z, sinks):
    """Free the cells of `layer` uint8 (H, W) along every ray to `ends` float64 (N, 2), metres, from `starts` float64 (N, 2), or (1, 2) for one
    start of all.

    A ray longer than `max_range` is followed that far only, and frees its last cell too; otherwise the cell of its end is freed
    only when `ends_free` (nothing was seen there). Cells outside of the layer are passed over. `tops` float32 (H, W) are the heights of what
    stands in lethal cells, (0, 0) when all is as high as the rays; they begin at the height `z` and sink by `sinks` float64 (N,) per metre.
    """
    height, width = layer.shape
    reach = max_range / resolution
    for k in range(len(ends)):
        s = k if len(starts) > 1 else 0
        x0, y0 = (starts[s, 0] - origin_x) / resolution, (starts[s, 1] - origin_y) / resolution
        x1, y1 = (ends[k, 0] - origin_x) / resolution, (ends[k, 1] - origin_y) / resolution
        dx, dy = x1 - x0, y1 - y0
        length = math.hypot(dx, dy)
        if not length < 1e9:
            continue
        is_open = ends_free
        scale = 1.0
        if length > reach:
            scale = reach / length
            is_open = True
        # Clip to the layer with a margin of one cell, so that far rays cost nothing outside of it.
        low, high = 0.0, scale
        for axis in range(2):
            p, d, size = (x0, dx, width) if axis == 0 else (y0, dy, height)
            if d == 0.0:
                if p < 0.0 or p >= size:
                    low = 2.0
                continue
            a, b = (-1.0 - p) / d, (size + 1.0 - p) / d
            low, high = max(low, min(a, b)), min(high, max(a, b))
        if low > high:
            continue
        if high < scale:
            is_open = True
        fall = sinks[k] * length * resolution if len(sinks) > 0 else 0.0
        _clear_ray(
            *(layer, tops, x0 + low * dx, y0 + low * dy, x0 + high * dx, y0 + high * dy, is_open),
            *(z - low * fall, (high - low) * fall),
        )


@jit
def mark_points(layer, tops, origin_x, origin_y, resolution, starts, points, max_range, heights):
    """Make the cells of points float64 (N, 2) lethal that lie within `max_range` of where their rays start, `starts` as in `clear_rays`.

    `heights` float64 (N,) are those of the things there, none of them told: of any height; `tops` keeps the highest of each cell.
    """
    height, width = layer.shape
    limit = max_range * max_range
    for k in range(len(points)):
        x, y = points[k, 0], points[k, 1]
        s = k if len(starts) > 1 else 0
        if not (x - starts[s, 0]) ** 2 + (y - starts[s, 1]) ** 2 <= limit:
            continue
        ix, iy = int(math.floor((x - origin_x) / resolution)), int(math.floor((y - origin_y) / resolution))
        if 0 <= iy < height and 0 <= ix < width:
            if tops.shape[0] > 0:
                top = heights[k] if len(heights) > 0 else math.inf
                tops[iy, ix] = max(tops[iy, ix], top) if layer[iy, ix] == LETHAL else top
            layer[iy, ix] = LETHAL


@jit
def fill_convex(layer, origin_x, origin_y, resolution, polygon, value):
    """Set the cells whose centres lie in a convex, counter-clockwise polygon float64 (N, 2), metres."""
    height, width = layer.shape
    y_low, y_high = polygon[:, 1].min(), polygon[:, 1].max()
    x_low, x_high = polygon[:, 0].min(), polygon[:, 0].max()
    iy0, iy1 = max(0, int((y_low - origin_y) / resolution)), min(height, int((y_high - origin_y) / resolution) + 1)
    ix0, ix1 = max(0, int((x_low - origin_x) / resolution)), min(width, int((x_high - origin_x) / resolution) + 1)
    n = len(polygon)
    for iy in range(iy0, iy1):
        y = origin_y + (iy + 0.5) * resolution
        for ix in range(ix0, ix1):
            x = origin_x + (ix + 0.5) * resolution
            is_inside = True
            for k in range(n):
                ax, ay = polygon[k, 0], polygon[k, 1]
                bx, by = polygon[(k + 1) % n, 0], polygon[(k + 1) % n, 1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) < 0.0:
                    is_inside = False
                    break
            if is_inside:
                layer[iy, ix] = value


@jit
def fill_squares(layer, origin_x, origin_y, resolution, points, values, across):
    """Set squares of `across` cells around points (N, 2) to their values uint8 (N,); where squares overlap, cells that are nearer to a
    square's far corner win, then later points."""
    height, width = layer.shape
    half = 0.5 * across
    for dy in range(across):
        for dx in range(across):
            for i in range(points.shape[0]):
                ix = int(np.rint((points[i, 0] - origin_x) / resolution - half)) + dx
                iy = int(np.rint((points[i, 1] - origin_y) / resolution - half)) + dy
                if 0 <= ix < width and 0 <= iy < height:
                    layer[iy, ix] = values[i]


@jit
def to_static(occupancy, table, out):
    """Write table[occupancy + 128] uint8 for every cell of `occupancy` int8 (H, W)."""
    height, width = occupancy.shape
    for iy in range(height):
        for ix in range(width):
            out[iy, ix] = table[np.int64(occupancy[iy, ix]) + 128]


@jit
def combine(master, obstacles, y0, y1, x0, x1):
    """Lay an obstacle layer over `master` in a box: the larger cost, but what an obstacle layer knows replaces unknown.

    One added in eight bits makes unknown (255) the smallest of all. That, and unsigned indices, let the compiler take many cells at once.
    """
    one = np.uint8(1)
    for iy in range(np.uint64(y0), np.uint64(y1)):
        for ix in range(np.uint64(x0), np.uint64(x1)):
            a, b = np.uint8(master[iy, ix] + one), np.uint8(obstacles[iy, ix] + one)
            master[iy, ix] = np.uint8((a if a > b else b) - one)


@jit
def free_unknown(master):
    """Make what is unknown free."""
    height, width = master.shape
    for iy in range(height):
        for ix in range(width):
            master[iy, ix] = FREE if master[iy, ix] == UNKNOWN else master[iy, ix]


@jit
def lay_lethal(master, cells, y0, y1, x0, x1):
    """Make those cells of `master` lethal that `cells` has lethal, in a box."""
    for iy in range(np.uint64(y0), np.uint64(y1)):
        for ix in range(np.uint64(x0), np.uint64(x1)):
            master[iy, ix] = np.uint8(LETHAL) if cells[iy, ix] == LETHAL else master[iy, ix]


@jit
def changed_box(old, new, top, bottom, left, right):
    """Return (y0, y1, x0, x1), half open, of the cells between rows `top`, `bottom` and columns `left`, `right` (half open) that differ;
    y0 = y1 when none does."""
    y0, y1, x0, x1 = bottom, 0, right, 0
    for iy in range(top, bottom):
        differing = 0
        for ix in range(np.uint64(left), np.uint64(right)):  # without a way out, so that many cells go at once
            differing += old[iy, ix] != new[iy, ix]
        if differing == 0:
            continue
        first, last = left, right - 1
        while old[iy, first] == new[iy, first]:
            first += 1
        while old[iy, last] == new[iy, last]:
            last -= 1
        y0, y1 = min(y0, iy), iy + 1
        x0, x1 = min(x0, first), max(x1, last + 1)
    if y1 == 0:
        return 0, 0, 0, 0
    return y0, y1, x0, x1


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    layer = np.full((4, 4), UNKNOWN, np.uint8)
    points = np.array([[0.1, 0.1], [0.15, 0.12]])
    tops, none = np.zeros((0, 0), np.float32), np.zeros(0)
    clear_rays(layer, tops, 0.0, 0.0, 0.05, np.zeros((1, 2)), points, 3.0, True, 0.0, none)
    mark_points(layer, tops, 0.0, 0.0, 0.05, np.zeros((1, 2)), points, 3.0, none)
    fill_convex(layer, 0.0, 0.0, 0.05, np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]), FREE)
    fill_squares(layer, 0.0, 0.0, 0.05, points, np.zeros(2, np.uint8), 2)
    occupancy = np.zeros((4, 4), np.int8)
    to_static(occupancy, np.zeros(256, np.uint8), layer)
    occupancy.flags.writeable = False  # messages hold read-only arrays, which are another type to the compiler
    to_static(occupancy, np.zeros(256, np.uint8), layer)
    combine(layer, layer.copy(), 0, 4, 0, 4)
    free_unknown(layer.copy())
    lay_lethal(layer, layer.copy(), 0, 4, 0, 4)
    changed_box(layer, layer.copy(), 0, 4, 0, 4)
