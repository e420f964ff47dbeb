"""Kernels on the places where a submap's returns lie: moments of the points in square cells, apart by the side from which they were seen,
and the fit of a scan to the lines that they form.

A cell is a row of a hash table (open addressing): `keys` int64 (C,), -1 empty, C a power of two; `moments` float64 (C, 6) holds n and the sums of
x, y, x x, x y, y y relative to the cell's centre.
"""

import math

import numpy as np

from ambler.kernels.correlation import solve3
from ambler.kernels.jit import jit

OFFSET = 1 << 28  # makes cell numbers positive
EMPTY = -1


@jit
def _side(dx, dy):
    """Return from which of four sides a ray (dx, dy) comes."""
    if abs(dx) >= abs(dy):
        return 0 if dx > 0.0 else 1
    return 2 if dy > 0.0 else 3


@jit
def _find(keys, key):
    """Return the row of a key, or the empty row where it belongs."""
    mask = keys.shape[0] - 1
    row = ((key * 0x9E3779B97F4A7C1) >> 20) & mask
    while keys[row] != key and keys[row] != EMPTY:
        row = (row + 1) & mask
    return row


@jit
def _key(ix, iy, side):
    return ((ix + OFFSET) << 33) | ((iy + OFFSET) << 2) | side


@jit
def add_points(keys, moments, size, starts, points):
    """Add points float32 (N, 2), seen from `starts` float64 (N, 2) or (1, 2); returns how many rows are new. The table must have room."""
    new = 0
    for i in range(points.shape[0]):
        k = i if starts.shape[0] > 1 else 0
        x, y = float(points[i, 0]), float(points[i, 1])
        ix, iy = int(math.floor(x / size)), int(math.floor(y / size))
        key = _key(ix, iy, _side(x - starts[k, 0], y - starts[k, 1]))
        row = _find(keys, key)
        if keys[row] == EMPTY:
            keys[row] = key
            moments[row] = 0.0
            new += 1
        u, v = x - (ix + 0.5) * size, y - (iy + 0.5) * size
        m = moments[row]
        m[0] += 1.0
        m[1] += u
        m[2] += v
        m[3] += u * u
        m[4] += u * v
        m[5] += v * v
    return new


@jit
def rehash(keys, moments, new_keys, new_moments):
    """Copy every row into a larger, empty table."""
    for i in range(keys.shape[0]):
        if keys[i] != EMPTY:
            row = _find(new_keys, keys[i])
            new_keys[row] = keys[i]
            new_moments[row] = moments[i]


@jit
def line_at(keys, moments, size, x, y, side, least, line):
    """Fit a line to the points in the 3 x 3 cells around (x, y); False where there are fewer than `least` or they form none.

    `line` float64 (5,) gets a point on it, its normal, and the variance of the points across it.
    """
    return _line_around(keys, moments, size, int(math.floor(x / size)), int(math.floor(y / size)), side, least, line)


@jit
def _line_around(keys, moments, size, ix, iy, side, least, line):
    """Do what `line_at` does, for a place anywhere in the cell (ix, iy)."""
    n = sx = sy = sxx = sxy = syy = 0.0
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            row = _find(keys, _key(ix + dx, iy + dy, side))
            if keys[row] == EMPTY:
                continue
            m = moments[row]
            a, b = dx * size, dy * size
            n += m[0]
            sx += m[1] + a * m[0]
            sy += m[2] + b * m[0]
            sxx += m[3] + 2.0 * a * m[1] + a * a * m[0]
            sxy += m[4] + a * m[2] + b * m[1] + a * b * m[0]
            syy += m[5] + 2.0 * b * m[2] + b * b * m[0]
    if n < least:
        return False
    mx, my = sx / n, sy / n
    cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
    half, diff = 0.5 * (cxx + cyy), 0.5 * (cxx - cyy)
    root = math.sqrt(diff * diff + cxy * cxy)
    high, low = half + root, max(half - root, 0.0)
    if high < 0.16 * size * size or low > 0.09 * high:
        return False
    turn = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)  # of the line
    line[0], line[1] = (ix + 0.5) * size + mx, (iy + 0.5) * size + my
    line[2], line[3] = -math.sin(turn), math.cos(turn)
    line[4] = low
    return True


@jit
def fit(keys, moments, size, points, origin, pose, prior, options, h, info):
    """Move `pose` float64 (3,) in place to where the points lie on the lines, near where it is.

    `points` float32 (N, 2) and `origin` float64 (2,) in the base frame; `prior` float64 (3,) the information of the start about x, y, yaw;
    `options` (least points of a line, standard deviation of a return, as how many independent points a scan counts, iterations). `h`
    float64 (3, 3) gets the points' information, `info` float64 (2,) the share of points on lines and their rms distance in standard deviations.
    """
    least, sigma2 = options[0], options[1] * options[1]
    start = pose.copy()
    n = points.shape[0]
    # From one iteration to the next hardly a point leaves its cell, and then its line is the one of before.
    lines, is_line, places = np.empty((n, 5)), np.zeros(n, np.bool_), np.full(n, -1)
    g, step = np.empty(3), np.empty(3)
    for _ in range(int(options[3])):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        ox, oy = c * origin[0] - s * origin[1], s * origin[0] + c * origin[1]
        h[:, :] = 0.0
        g[:] = 0.0
        used, total = 0, 0.0
        for i in range(n):
            rx = c * points[i, 0] - s * points[i, 1]
            ry = s * points[i, 0] + c * points[i, 1]
            x, y = rx + pose[0], ry + pose[1]
            ix, iy, side = int(math.floor(x / size)), int(math.floor(y / size)), _side(rx - ox, ry - oy)
            place, line = _key(ix, iy, side), lines[i]
            if place != places[i]:
                places[i] = place
                is_line[i] = _line_around(keys, moments, size, ix, iy, side, least, line)
            if not is_line[i]:
                continue
            e = line[2] * (x - line[0]) + line[3] * (y - line[1])
            variance = line[4] + sigma2
            z = abs(e) / math.sqrt(variance)
            if z > 6.0:
                continue
            w = (1.0 if z < 1.5 else 1.5 / z) / variance
            j2 = -line[2] * ry + line[3] * rx
            used += 1
            total += z * z
            h[0, 0] += w * line[2] * line[2]
            h[0, 1] += w * line[2] * line[3]
            h[1, 1] += w * line[3] * line[3]
            h[0, 2] += w * line[2] * j2
            h[1, 2] += w * line[3] * j2
            h[2, 2] += w * j2 * j2
            g[0] += w * line[2] * e
            g[1] += w * line[3] * e
            g[2] += w * j2 * e
        info[0] = used / max(n, 1)
        if used == 0:
            return
        info[1] = math.sqrt(total / used)
        scale = min(1.0, options[2] / used)
        h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
        a = np.empty((3, 3))
        for k in range(3):
            g[k] = scale * g[k] + prior[k] * (pose[k] - start[k])
            for j in range(3):
                h[k, j] *= scale
                a[k, j] = h[k, j]
            a[k, k] += prior[k]
        # By hand: the last bits of LAPACK's solution depend on the machine, and poses must not.
        if not solve3(a, g, 0.0, step):
            return
        for k in range(3):
            pose[k] += step[k]
        if abs(step[0]) + abs(step[1]) < 1e-4 and abs(step[2]) < 1e-5:
            return


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    keys, moments = np.full(16, EMPTY), np.zeros((16, 6))
    points = np.ones((2, 2), np.float32)
    add_points(keys, moments, 0.1, np.zeros((1, 2)), points)
    add_points(keys, moments, 0.1, np.zeros((2, 2)), points)
    rehash(keys, moments, np.full(32, EMPTY), np.zeros((32, 6)))
    line_at(keys, moments, 0.1, 1.0, 1.0, 0, 1.0, np.empty(5))
    fit(keys, moments, 0.1, points, np.zeros(2), np.zeros(3), np.ones(3), np.ones(4), np.empty((3, 3)), np.empty(2))
