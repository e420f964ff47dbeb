"""Lines of sight over a field of clearance: whether they are clear, what is unknown along them, what they cost; and the floor that is connected.

`field` is the clearance of `kernels.level_contour`, uint8 in sixteenths of a cell; coordinates are (y, x) in cells. A line is clear while the bilinear
clearance stays above `least`; sphere tracing jumps by what the clearance allows.
"""

import numpy as np

from ambler.kernels.jit import jit

UNIT = 16.0
HALF_CELL = 0.75  # cells; half the diagonal of a cell, and what a sixteenth rounds away
STEP = 0.25  # cells; the least step of a sight line: the clearance dips by no more than half of it in between
SURE = 1.4  # cells of clearance from which no cell corner can be touched
FINE = 0.1  # cells; the step where the cells themselves are looked at
BOX = 0.56  # cells; half a cell and what a fine step can miss


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
def _course(y0, x0, y1, x1):
    """Return the length of a line in cells and its direction (y, x), which is zero where it has none."""
    length = np.hypot(y1 - y0, x1 - x0)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return length, (y1 - y0) / length, (x1 - x0) / length


@jit
def is_clear(field, y0, x0, y1, x1, least):
    """Say whether the line keeps `least` cells of clearance all along."""
    if not (is_inside(field, y0, x0) and is_inside(field, y1, x1)):
        return False
    length, along_y, along_x = _course(y0, x0, y1, x1)
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
    length, along_y, along_x = _course(y0, x0, y1, x1)
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
    field, known = np.full((8, 8), 255, np.uint8), np.ones((8, 8), np.uint8)
    clearance(field, 1.0, 1.0)
    is_inside(field, 1.0, 1.0)
    is_clear(field, 1.0, 1.0, 2.0, 2.0, 1.0)
    sum_along(known, 1.0, 1.0, 2.0, 2.0)
    leg_cost(field, known, 1.0, 1.0, 2.0, 2.0, 0.05)
    turned(0.0, 1.0, 1.0)
    extend(field, np.array([[1.0, 1.0], [3.0, 3.0], [5.0, 1.0]]), 1.0, 6.0, 1, 1.0)
    flood(field, known, 1, 1, np.zeros((8, 8), np.uint8))
