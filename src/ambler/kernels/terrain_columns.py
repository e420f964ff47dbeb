"""Terrain out of clouds: columns of voxels around the robot, the ground that is joined to where it stands, steps and drops.

A window of n x n columns rolls with the robot; row and column of a place are its cell numbers modulo n, so that nothing is ever moved. A column holds 32
voxels, by height modulo 32 voxels, of four numbers each: height, when it was seen last (s), returns, and how often it was looked through; `mask` says
which of them are there. `voxels` float32 [bin, iy, ix, number] holds them level by level: a floor, which fills one bin or two, lies together. Two by two columns are a cell of ground. The image of a scan holds the nearest return of each direction, how
far away (m) and how steep (rise per metre): a voxel nearer than that, and as high as that ray there, was looked through.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit_ieee, read_only

BINS = 32  # voxels of a column
Z, SEEN, COUNT, MISSED = 0, 1, 2, 3
THROUGH = 0.6  # of a voxel's side: how far above or below a low thing's height a ray may pass that looked through it
LOW_THING = 0.3  # m over the ground
LOW_PATIENCE = 3.0  # times as long, and as many looks through it, until something low that stands alone is forgotten
TURNS = 4  # scans in which every cell is renewed once, touched or not
RETURNS = 3.0  # that a low needs: a beam at an edge lies between two surfaces
MEMORY, LOW_MEMORY = (
    16.0,
    3.0,
)  # returns that a voxel's height remembers: it follows lower ones sooner, so that the foot of a face shows
COUNT_MOST = 100.0
QUARTER = 64  # directions of the image in a quarter turn
DIRECTIONS = 4 * QUARTER
ROW, ROW_LOW, ROWS = 0.03, -0.9, 42  # the image's rows: tangents of elevation from ROW_LOW on
# For a power of two of 32 bits, its exponent: multiply, shift, look up.
_DE_BRUIJN = np.uint32(0x077CB531)
_EXPONENTS = np.zeros(32, np.int64)
for _k in range(32):
    _EXPONENTS[((0x077CB531 << _k) & 0xFFFFFFFF) >> 27] = _k


@jit_ieee
def lowest_bit(mask):
    """Return the number of the lowest bit that is set."""
    m = np.uint32(mask)
    return _EXPONENTS[np.uint32(np.uint32(m & (~m + np.uint32(1))) * _DE_BRUIJN) >> np.uint32(27)]


@jit_ieee
def wrapped(i, n):
    """Return i modulo n for -n <= i < 2 n, without a division."""
    if i < 0:
        return i + n
    return i - n if i >= n else i


@jit_ieee
def direction(dx, dy):
    """Return the image's column of a direction: bins of nearly equal angle, without trigonometry."""
    s = abs(dx) + abs(dy)
    if s <= 0.0:
        return 0
    a = dy / s
    if dx < 0.0:
        a = 2.0 - a
    elif dy < 0.0:
        a = 4.0 + a
    return min(DIRECTIONS - 1, int(a * QUARTER))


@jit_ieee
def forget_left(mask, newest, evidence, ground, lows, memory, old, new):
    """Forget what is not in the window any more. `old`, `new` int64 (2,): first column and row of the window before and now, both even."""
    n = mask.shape[0]
    for axis in range(2):
        step = new[axis] - old[axis]
        count = min(n, abs(step))
        first = old[axis] + n if step > 0 else new[axis]
        for k in range(count):
            at = (first + k) % n
            if axis == 0:
                mask[:, at] = 0
                newest[:, at] = -1e9
                evidence[:, at // 2] = 0
                ground[:, at // 2] = lows[:, at // 2] = memory[:, at // 2] = np.nan
            else:
                mask[at, :] = 0
                newest[at, :] = -1e9
                evidence[at // 2, :] = 0
                ground[at // 2, :] = lows[at // 2, :] = memory[at // 2, :] = np.nan


@jit_ieee
def insert(points, origin, base, now, limits, first, size, ground, voxels, mask, newest, image, touched):
    """Put a scan into the columns and draw its image.

    `points` float32 (N, 3) and `origin`, `base` (3,) in the odom frame: where the sensor and the base are. `limits`: how high above the
    ground counts, how much more per metre away, depth below, more per metre, and the radius of the robot itself (m). `touched` uint8 (m, m) becomes 1 where
    points fall.
    """
    n = mask.shape[0]
    high, high_slope, low, low_slope, own = limits
    own2 = own * own
    inverse = 1.0 / size
    ox, oy, oz = origin
    bx, by, bz = base
    x0, y0 = first[0] * size, first[1] * size
    reach = n * size
    column0, row0 = first[0] % n, first[1] % n
    image[:, :, 0] = np.inf
    too_high = max(oz, bz + high)
    for i in range(points.shape[0]):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        dx, dy = x - ox, y - oy
        squared = dx * dx + dy * dy
        over = z - too_high
        if over > 0.0 and over * over > high_slope * high_slope * squared:
            continue
        away = math.sqrt(squared)
        t = (z - oz) / away
        row = int((t - ROW_LOW) / ROW)
        if t >= ROW_LOW and row < ROWS:
            d = direction(dx, dy)
            if away < image[d, row, 0]:
                image[d, row, 0], image[d, row, 1] = away, t
        u, v = x - x0, y - y0
        if not (u >= 0.0 and v >= 0.0 and u < reach and v < reach):
            continue
        px, py = x - bx, y - by
        p2 = px * px + py * py
        if p2 < own2:
            continue
        if z > bz + high + high_slope * away or z < bz - low - low_slope * away:
            continue
        ix, iy = int(u * inverse) + column0, int(v * inverse) + row0
        ix -= n if ix >= n else 0
        iy -= n if iy >= n else 0
        g = ground[iy >> 1, ix >> 1]
        if z > g + high:  # false while there is no ground
            continue
        b = int(math.floor(z * inverse)) & (BINS - 1)
        bit = np.uint32(1) << np.uint32(b)
        if (mask[iy, ix] & bit) != 0 and abs(voxels[b, iy, ix, Z] - z) < size:
            count = min(COUNT_MOST, voxels[b, iy, ix, COUNT] + 1.0)
            off = z - voxels[b, iy, ix, Z]
            voxels[b, iy, ix, Z] += off / min(count, MEMORY) if off > 0.0 else off / min(count, LOW_MEMORY)
            voxels[b, iy, ix, COUNT] = count
        else:
            mask[iy, ix] |= bit
            voxels[b, iy, ix, Z] = z
            voxels[b, iy, ix, COUNT] = 1.0
        voxels[b, iy, ix, SEEN] = now
        voxels[b, iy, ix, MISSED] = 0.0
        newest[iy, ix] = now
        touched[iy >> 1, ix >> 1] = 1


@jit_ieee
def renew(
    origin,
    up,
    elevations,
    now,
    decay,
    margin,
    misses,
    turn,
    first,
    size,
    ground,
    voxels,
    mask,
    newest,
    image,
    touched,
    lows,
    highs,
    returns,
    changed,
):
    """Forget voxels whose column was seen again for `decay` seconds without them, and those that were looked through; find each cell's low and high, and of how many
    `returns` they are.

    Cells that the scan touched are renewed; every `TURNS`th cell, in `turn`s, also by what was looked through. `up` (3,) is the sensor's upward axis in odom and `elevations` the sines between which it looks. `lows`, `highs` float32 (m, m): see
    `low_and_high`. `changed` uint8 (m, m) becomes 1 where something came or went, else 0.
    """
    n = mask.shape[0]
    half = n // 2
    column0, row0 = first[0] % n, first[1] % n
    heights, counts = np.empty(4 * BINS), np.empty(4 * BINS)
    for cy in range(half):
        for cx in range(half):
            is_turn = (cy + cx) & (TURNS - 1) == turn
            is_changed = touched[cy, cx] != 0
            changed[cy, cx] = touched[cy, cx]
            if not is_changed and not is_turn:
                continue
            touched[cy, cx] = 0
            y, x = 2 * cy, 2 * cx
            everything = mask[y, x] | mask[y, x + 1] | mask[y + 1, x] | mask[y + 1, x + 1]
            if everything == 0:
                lows[cy, cx] = np.nan
                continue
            found = 0
            g = ground[cy, cx]
            # Few returns tell of what is low, a kerb: it is forgotten slowly, unless what stood over it has gone, too.
            is_low = not math.isnan(g) and (everything & ~_low_bins(g, size)) == 0
            patience = LOW_PATIENCE if is_low else 1.0
            is_left = False
            for q in range(4):
                iy, ix = y + (q >> 1), x + (q & 1)
                m = mask[iy, ix]
                fresh = newest[iy, ix]
                rx = ry = away = 0.0
                seen_in = 0
                if is_turn and m != 0:
                    rx = (first[0] + wrapped(ix - column0, n) + 0.5) * size - origin[0]
                    ry = (first[1] + wrapped(iy - row0, n) + 0.5) * size - origin[1]
                    away, seen_in = math.sqrt(rx * rx + ry * ry), direction(rx, ry)
                while m != 0:
                    b = lowest_bit(m)
                    bit = np.uint32(1) << np.uint32(b)
                    m &= ~bit
                    if voxels[b, iy, ix, SEEN] < now:
                        is_gone = fresh - voxels[b, iy, ix, SEEN] > decay * patience
                        if not is_gone and is_turn and not voxels[b, iy, ix, Z] < g + 0.5 * size:  # true without ground
                            if away >= 2.0 * size:
                                ray = (rx, ry, voxels[b, iy, ix, Z] - origin[2], away, seen_in)
                                beside = THROUGH * size if is_low else np.inf
                                voxels[b, iy, ix, MISSED] += _looked_through(ray, up, elevations, margin, beside, image)
                            is_gone = voxels[b, iy, ix, MISSED] >= misses * patience
                        if is_gone:
                            mask[iy, ix] &= ~bit
                            is_changed = True
                            is_left = is_left or voxels[b, iy, ix, Z] > g + LOW_THING
                            continue
                    heights[found], counts[found] = voxels[b, iy, ix, Z], voxels[b, iy, ix, COUNT]
                    found += 1
            if is_left:
                found = _leave(y, x, g, now, size, voxels, mask, heights, counts)
            changed[cy, cx] = is_changed
            if is_changed:
                lows[cy, cx], highs[cy, cx], returns[cy, cx] = low_and_high(heights, counts, found, 1.5 * size)


@jit_ieee
def _low_bins(g, size):
    """Return the bins of a column between as much below the ground at height `g` as a low thing stands above it, and the top of that, as bits."""
    reach = int(math.ceil(LOW_THING / size))
    own = int(math.floor(g / size))
    bits = np.uint32(0)
    for k in range(-reach, reach + 1):
        bits |= np.uint32(1) << np.uint32((own + k) & (BINS - 1))
    return bits


@jit_ieee
def _leave(y, x, g, now, size, voxels, mask, heights, counts):
    """Forget what of a cell was not seen just now between the ground at height `g` and `LOW_THING` over it: the feet of who has left. Write the rest into `heights` and `counts`; returns how many."""
    found = 0
    for q in range(4):
        iy, ix = y + (q >> 1), x + (q & 1)
        m = mask[iy, ix]
        while m != 0:
            b = lowest_bit(m)
            bit = np.uint32(1) << np.uint32(b)
            m &= ~bit
            z = voxels[b, iy, ix, Z]
            if g + 0.5 * size < z < g + LOW_THING and voxels[b, iy, ix, SEEN] < now:
                mask[iy, ix] &= ~bit
                continue
            heights[found], counts[found] = z, voxels[b, iy, ix, COUNT]
            found += 1
    return found


@jit_ieee
def low_and_high(heights, counts, found, lift):
    """Return the heights below which a quarter of the returns lie and above which a tenth, three at least, of those at most `lift` above the lowest voxel of two returns
    (NaN: too few), and how many they are."""
    lowest = np.inf
    for k in range(found):
        if counts[k] >= 2.0 and heights[k] < lowest:
            lowest = heights[k]
    if lowest == np.inf:
        return np.nan, np.nan, 0.0
    total = 0.0
    kept = 0
    for k in range(found):
        z, count = heights[k], counts[k]
        if z < lowest or z > lowest + lift:
            continue
        total += count
        j = kept
        while j > 0 and heights[j - 1] > z:
            heights[j], counts[j] = heights[j - 1], counts[j - 1]
            j -= 1
        heights[j], counts[j] = z, count
        kept += 1
    if total < RETURNS:
        return np.nan, np.nan, total
    low = high = np.nan
    below = 0.0
    for k in range(kept):
        below += counts[k]
        if math.isnan(low) and below >= 0.25 * total:
            low = heights[k]
        if below >= min(0.9 * total, max(total - RETURNS, 0.25 * total)):
            high = heights[k]
            break
    return low, high, total


@jit_ieee
def _looked_through(ray, up, elevations, margin, beside, image):
    """Return 1 when the scan's rays in a voxel's direction went on behind it, 0.2 when none came back though it is in view, else 0.

    `ray`: x, y and z from the sensor to the voxel, its length in the plane, and its column of the image. Rays count that pass at most `beside` metres above or below it.
    """
    x, y, z, away, seen_in = ray
    t = (z / away - ROW_LOW) / ROW
    if not (t >= 0.0 and t < ROWS):
        return 0.0
    nearest = image[seen_in, int(t), 0]
    if nearest < np.inf:
        is_through = abs(image[seen_in, int(t), 1] - z / away) * away < beside
        return 1.0 if is_through and nearest > away + margin * (1.0 + away * 0.1) else 0.0
    sine = (x * up[0] + y * up[1] + z * up[2]) / math.sqrt(away * away + z * z)
    return 0.2 if elevations[0] + 0.03 < sine < elevations[1] - 0.03 else 0.0


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    n = 8
    voxels, mask = np.zeros((BINS, n, n, 4), np.float32), np.zeros((n, n), np.uint32)
    newest = np.full((n, n), -1e9, np.float32)
    ground, evidence = np.full((n // 2, n // 2), np.nan, np.float32), np.zeros((n // 2, n // 2), np.uint8)
    image, first = np.empty((DIRECTIONS, ROWS, 2), np.float32), np.zeros(2, np.int64)
    forget_left(mask, newest, evidence, ground, ground, ground, first, first)
    points = np.array([[0.35, 0.35, 0.0], [0.35, 0.35, 0.3]], np.float32)
    origin, up, limits = np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.1, 1.0, 0.1, 0.1])
    elevations = np.array([-0.1, 0.8])
    for now in (0.0, 0.1):
        insert(points, origin, np.zeros(3), now, limits, first, 0.1, ground, voxels, mask, newest, image, evidence)
    insert(
        read_only(points), origin, np.zeros(3), 0.1, limits, first, 0.1, ground, voxels, mask, newest, image, evidence
    )
    args = (first, 0.1, ground, voxels, mask, newest, image, evidence)
    renew(origin, up, elevations, 0.2, 1.0, 0.3, 3.0, 0, *args, *np.empty((3, n // 2, n // 2), np.float32), evidence)
