"""Kernels that draw the moved beams of a scan into the bins of one virtual scanner.

Neighbouring returns that lie on one straight surface are joined, and the joint is intersected with the centre ray of each bin
it crosses, so that bins hold true ranges whatever the parallax between scanner and virtual origin; the nearest surface wins.
The passes over all beams are straight loops over float32 columns; only the last pass looks at one beam after the other, at
those that cross a bin centre or end a surface, in float64.
"""

import math

import numpy as np

from ambler.kernels.bearing import turn_of_single
from ambler.kernels.jit import jit, jit_fused
from ambler.kernels.scan_motion import EMPTY, RETURN

HALF, FOUR, NINE = np.float32(0.5), np.float32(4.0), np.float32(9.0)


@jit_fused
def _to_virtual(x, y, a, origin, bins):
    """Turn columns x, y of the base frame into the frame of the virtual scanner, and write the bin position to `a`."""
    ox, oy, c, s = np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2]), np.float32(origin[3])
    width = np.float32(bins)
    for i in range(x.shape[0]):
        dx, dy = x[i] - ox, y[i] - oy
        vx, vy = c * dx + s * dy, c * dy - s * dx
        x[i] = vx
        y[i] = vy
        a[i] = (turn_of_single(vy, vx) + HALF) * width


@jit_fused
def _find_joints(columns, kinds, joining, joints, events):
    """Write to `joints` uint8 (N,) whether beam i and i + 1 saw one surface: a neighbour lies on their straight line.

    The gap must continue the neighbouring gap: no jump in spacing (factor 3), no kink beyond the tolerance, not too long;
    `joining` is (tolerance, longest gap) in metres. `events` uint8 (N,)
    marks the beams that the drawing must look at: ends of surfaces, and joints that cross a bin centre.
    """
    x, y, position = columns[0], columns[1], columns[2]
    n = kinds.shape[0]
    t2, longest2 = np.float32(joining[0] * joining[0]), np.float32(joining[1] * joining[1])
    slack = FOUR * t2
    for i in range(n - 2):
        ex, ey = x[i + 1] - x[i], y[i + 1] - y[i]
        fx, fy = x[i + 2] - x[i + 1], y[i + 2] - y[i + 1]
        e2, f2 = ex * ex + ey * ey, fx * fx + fy * fy
        cross = ex * fy - ey * fx
        is_line = cross * cross <= t2 * max(e2, f2)
        events[i] = np.uint8(is_line & (e2 <= min(NINE * f2 + slack, longest2))) + np.uint8(2) * np.uint8(
            is_line & (f2 <= min(NINE * e2 + slack, longest2))
        )
    for i in range(max(n - 2, 0), n):
        events[i] = 0
    for i in range(n - 1):
        is_empty = (kinds[i] == EMPTY) & (kinds[i + 1] == EMPTY)
        is_pair = (kinds[i] == RETURN) & (kinds[i + 1] == RETURN)
        ahead = i + 2 < n and (events[i] & 1) != 0 and kinds[i + 2] == RETURN
        behind = i > 0 and (events[i - 1] & 2) != 0 and kinds[i - 1] == RETURN
        joints[i] = np.uint8(is_empty | (is_pair & (ahead | behind)))
    joints[n - 1] = 0
    for i in range(n - 1):
        events[i] = np.uint8((joints[i] == 0) | (np.int32(position[i]) != np.int32(position[i + 1])))
    events[n - 1] = 1


@jit
def _find_speck(columns, first, last):
    """Return the nearest of beams first..last: a surface too narrow to cross a bin centre."""
    best = first
    best2 = math.inf
    for i in range(first, last + 1):
        r2 = columns[0, i] ** 2 + columns[1, i] ** 2
        if r2 < best2:
            best, best2 = i, r2
    return best


@jit_fused
def draw_scan(columns, kinds, origin, bin_directions, limits, joining, source, scratch, ranges, free, sources, indices):
    """Draw the moved beams of one scan into the bins of the virtual scanner at `origin` (x, y, cos, sin) in the base frame.

    `bin_directions` float64 (B, 2): bin b looks at angle -pi + 2 pi b / B. `limits` (range_min, range_max) of the virtual scan.
    `joining` as in `_find_joints`. `columns` float32 (3, N) are moved into the virtual frame, `scratch` uint8 (2, N). Lowers `ranges` float64 (B,) to the nearest
    surface, marks `free` uint8 (B,) where an empty beam passed, and remembers the source and its beam in `sources` int16 (B,)
    and `indices` int32 (B,).
    """
    bins = ranges.shape[0]
    if kinds.shape[0] == 0:
        return
    joints, events = scratch[0], scratch[1]
    _to_virtual(columns[0], columns[1], columns[2], origin, bins)
    _find_joints(columns, kinds, joining, joints, events)
    xs, ys, positions = columns[0], columns[1], columns[2]
    near, far = limits[0], limits[1]
    start = 0
    drawn = 0
    for i in range(kinds.shape[0]):
        if events[i] == 0:
            continue
        a = np.float64(positions[i])
        if joints[i] == 0:
            if kinds[i] == EMPTY:
                free[int(a + 0.5) % bins] = 1
            elif kinds[i] == RETURN and drawn == 0:
                best = _find_speck(columns, start, i)
                k = int(positions[best] + 0.5) % bins
                r = math.hypot(np.float64(xs[best]), np.float64(ys[best]))
                if r > far:
                    free[k] = 1
                elif near <= r < ranges[k]:
                    ranges[k], sources[k], indices[k] = r, source, best
            start, drawn = i + 1, 0
            continue
        span = np.float64(positions[i + 1]) - a
        span -= bins if span > 0.5 * bins else (-bins if span < -0.5 * bins else 0)
        first = int(math.ceil(min(a, a + span)))
        last = int(math.floor(max(a, a + span)))
        drawn += last - first + 1
        x0, y0 = np.float64(xs[i]), np.float64(ys[i])
        x1, y1 = np.float64(xs[i + 1]), np.float64(ys[i + 1])
        ex, ey = x1 - x0, y1 - y0
        across = x0 * ey - y0 * ex
        low2 = min(x0 * x0 + y0 * y0, x1 * x1 + y1 * y1)
        high2 = max(x0 * x0 + y0 * y0, x1 * x1 + y1 * y1)
        for b in range(first, last + 1):
            k = b - bins if b >= bins else (b + bins if b < 0 else b)
            if kinds[i] == EMPTY:
                free[k] = 1
                continue
            r = across / (bin_directions[k, 0] * ey - bin_directions[k, 1] * ex)
            if not 0.0 < r * abs(r) <= high2:
                r = math.sqrt(low2)
            if r > far:
                free[k] = 1
            elif near <= r < ranges[k]:
                ranges[k], sources[k] = r, source
                indices[k] = i if 2.0 * abs(b - a) <= abs(span) else i + 1


@jit
def finish_scan(ranges, free, out):
    """Write float32 ranges: the nearest surface, else +inf where a beam passed to its end, else NaN where nobody looked."""
    for b in range(ranges.shape[0]):
        if ranges[b] < math.inf:
            out[b] = ranges[b]
        else:
            out[b] = math.inf if free[b] == 1 else math.nan


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    n, bins, two = 4, 8, np.array([0.0, 10.0])
    ranges, free = np.full(bins, np.inf), np.zeros(bins, np.uint8)
    draw_scan(
        np.zeros((3, n), np.float32), np.zeros(n, np.uint8), np.array([0.0, 0.0, 1.0, 0.0]), np.ones((bins, 2)), two, two, 0,
        np.zeros((2, n), np.uint8), ranges, free, np.zeros(bins, np.int16), np.zeros(bins, np.int32),
    )  # fmt: skip
    finish_scan(ranges, free, np.zeros(bins, np.float32))
