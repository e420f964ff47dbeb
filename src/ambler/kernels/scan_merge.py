"""Kernels that draw the returns of several moving scanners into the bins of one virtual scanner.

Every beam is moved to one common time by the odometry: between two odometry knots the base moves with a constant twist,
p_ref = ref_from_base(t_k) * exp(twist_k * (t - t_k)) * base_from_sensor * p. Neighbouring returns that lie on one straight
surface are joined, and the joint is intersected with the centre ray of each bin it crosses, so that bins hold true ranges
whatever the parallax between scanner and virtual origin; the nearest surface wins.

The passes over all beams are straight loops over separate columns, which LLVM turns into vector instructions; only the last
pass, which touches bins, looks at one beam after the other.
"""

import math

import numpy as np

from ambler.kernels.jit import jit, jit_fused
from ambler.kernels.scan_points import carry

NOTHING, RETURN, EMPTY = 0, 1, 2
RETURNS, EMPTIES, MASKED, INVALID, UNUSED = 0, 1, 2, 3, 4
SMALL_TURN = 0.5
BLOCK = 512


@jit_fused
def turn_of(y, x):
    """Return atan2(y, x) / (2 pi) in [-0.5, 0.5], exact to 2e-9 turns (odd polynomial on Chebyshev nodes)."""
    ax, ay = abs(x), abs(y)
    z = min(ax, ay) / max(ax, ay, 1e-30)
    s = z * z
    a = 0.0004402677
    a = a * s - 0.0025037060
    a = a * s + 0.0067064111
    a = a * s - 0.0118679530
    a = a * s + 0.0168996617
    a = a * s - 0.0225964970
    a = a * s + 0.0318180526
    a = a * s - 0.0530511756
    a = a * s + 0.1591549402
    a *= z
    a = 0.25 - a if ay > ax else a
    a = 0.5 - a if x < 0.0 else a
    return -a if y < 0.0 else a


@jit_fused
def _carry_columns(x, y, t0, step, twist, pose):
    """Move points (seen at t0 + i * step seconds after a knot) by the knot's twist, then by its pose, in place."""
    cos_k, sin_k = math.cos(pose[2]), math.sin(pose[2])
    vx, vy, wz = twist[0], twist[1], twist[2]
    px, py = pose[0], pose[1]
    n = x.shape[0]
    if max(abs(t0), abs(t0 + n * step)) * abs(wz) < SMALL_TURN:
        for i in range(n):
            t = t0 + i * step
            w = wz * t
            w2 = w * w
            a = 1.0 - w2 * (1 / 6 - w2 * (1 / 120 - w2 * (1 / 5040 - w2 / 362880)))
            b = w * (0.5 - w2 * (1 / 24 - w2 * (1 / 720 - w2 / 40320)))
            s, c = w * a, 1.0 - w * b
            bx = c * x[i] - s * y[i] + t * (a * vx - b * vy)
            by = s * x[i] + c * y[i] + t * (b * vx + a * vy)
            x[i] = px + cos_k * bx - sin_k * by
            y[i] = py + sin_k * bx + cos_k * by
    else:
        for i in range(n):
            bx, by = carry(x[i], y[i], t0 + i * step, twist)
            x[i] = px + cos_k * bx - sin_k * by
            y[i] = py + sin_k * bx + cos_k * by


@jit_fused
def _place_beams(ranges, dx, dy, used, limits, offset, x, y, kinds):
    """Write where each beam ends in the base frame of its own instant, and its kind."""
    near, far = limits[0], limits[1]
    for i in range(ranges.shape[0]):
        r = np.float64(ranges[i])
        kind = np.uint8(RETURN) if r <= far else np.uint8(EMPTY)
        r = r if r <= far else far
        is_good = (ranges[i] >= near) & (used[i] != 0)
        kinds[i] = kind if is_good else np.uint8(NOTHING)
        x[i] = r * dx[i] + offset[0]
        y[i] = r * dy[i] + offset[1]


@jit
def is_inside(x, y, vertices, starts):
    """Say whether a point lies in any of the polygons (even-odd rule). `vertices` (M, 2); polygon k is starts[k]:starts[k+1]."""
    for k in range(starts.shape[0] - 1):
        inside = False
        j = starts[k + 1] - 1
        for i in range(starts[k], starts[k + 1]):
            yi, yj = vertices[i, 1], vertices[j, 1]
            if (yi > y) != (yj > y):
                cut = vertices[i, 0] + (y - yi) * (vertices[j, 0] - vertices[i, 0]) / (yj - yi)
                if x < cut:
                    inside = not inside
            j = i
        if inside:
            return True
    return False


@jit
def mask_points(points, vertices, starts, out):
    """Write to `out` uint8 (N,) whether each point (N, 2) lies in any of the polygons."""
    for i in range(points.shape[0]):
        out[i] = is_inside(points[i, 0], points[i, 1], vertices, starts)


@jit_fused
def _count_kinds(used, x, y, kinds, reach2, counts):
    """Count the kinds of a block; returns how many returns lie within the reach of the self-mask."""
    returns, empties, unused, near = 0, 0, 0, 0
    for i in range(kinds.shape[0]):
        is_return = kinds[i] == RETURN
        returns += int(is_return)
        empties += int(kinds[i] == EMPTY)
        unused += int(used[i] == 0)
        near += int(is_return & (x[i] * x[i] + y[i] * y[i] <= reach2))
    counts[RETURNS] += returns
    counts[EMPTIES] += empties
    counts[UNUSED] += unused
    counts[INVALID] += kinds.shape[0] - returns - empties - unused
    return near


@jit
def _mask_block(x, y, kinds, vertices, starts, counts):
    for i in range(kinds.shape[0]):
        if kinds[i] == RETURN and is_inside(x[i], y[i], vertices, starts):
            kinds[i] = NOTHING
            counts[MASKED] += 1
            counts[RETURNS] -= 1


@jit
def move_beams(
    ranges, directions, used, limits, timing, offset, knots, poses, twists, vertices, starts, mask_reach,
    columns, kinds, counts,
):  # fmt: skip
    """Move every beam of one scan into the base frame of the common time.

    `ranges` float32 (N,); `directions` float64 (3, N) unit vectors in the base frame and `offset` (3,) the scanner's position;
    `used` uint8 (N,) the angle windows; `limits` (range_min, range_max); `timing` (first beam, step) in seconds after the
    common time; `knots` (K,) odometry times after it, `poses` (K, 3) reference_from_base at them, `twists` (K, 3) until the
    next. Returns within `mask_reach` (>= 0) of the base that lie in a polygon of the robot itself are dropped. Writes
    `columns` float64 (3, N): x, y where the beam ends (at range_max for an empty one); `kinds` uint8 (N,), `counts` int64 (5,).
    """
    n = ranges.shape[0]
    x, y, dx, dy = columns[0], columns[1], directions[0], directions[1]
    last_knot = knots.shape[0] - 1
    k = 0
    first = 0
    while first < n:
        t = timing[0] + first * timing[1]
        while k < last_knot and knots[k + 1] <= t:
            k += 1
        last = min(n, first + BLOCK)
        if k < last_knot and timing[1] > 0.0:
            last = min(last, max(first + 1, int(math.ceil((knots[k + 1] - timing[0]) / timing[1]))))
        bx, by, block = x[first:last], y[first:last], kinds[first:last]
        _place_beams(
            ranges[first:last], dx[first:last], dy[first:last], used[first:last], limits, offset, bx, by, block
        )
        if _count_kinds(used[first:last], bx, by, block, mask_reach * mask_reach, counts) > 0:
            _mask_block(bx, by, block, vertices, starts, counts)
        _carry_columns(bx, by, t - knots[k], timing[1], twists[k], poses[k])
        first = last


@jit_fused
def _to_virtual(x, y, a, origin, bins):
    """Turn columns x, y of the base frame into the frame of the virtual scanner, and write the bin position to `a`."""
    ox, oy, c, s = origin[0], origin[1], origin[2], origin[3]
    for i in range(x.shape[0]):
        dx, dy = x[i] - ox, y[i] - oy
        vx, vy = c * dx + s * dy, c * dy - s * dx
        x[i] = vx
        y[i] = vy
        a[i] = (turn_of(vy, vx) + 0.5) * bins


@jit_fused
def _find_joints(columns, kinds, joining, joints, events):
    """Write to `joints` uint8 (N,) whether beam i and i + 1 saw one surface: a neighbour lies on their straight line.

    The gap must continue the neighbouring gap: no jump in spacing (factor 3), no kink beyond the tolerance, not too long;
    `joining` is (tolerance, longest gap) in metres. `events` uint8 (N,)
    marks the beams that the drawing must look at: ends of surfaces, and joints that cross a bin centre.
    """
    x, y, position = columns[0], columns[1], columns[2]
    n = kinds.shape[0]
    t2, longest2 = joining[0] * joining[0], joining[1] * joining[1]
    slack = 4.0 * t2
    for i in range(n - 2):
        ex, ey = x[i + 1] - x[i], y[i + 1] - y[i]
        fx, fy = x[i + 2] - x[i + 1], y[i + 2] - y[i + 1]
        e2, f2 = ex * ex + ey * ey, fx * fx + fy * fy
        cross = ex * fy - ey * fx
        is_line = cross * cross <= t2 * max(e2, f2)
        events[i] = np.uint8(is_line & (e2 <= min(9.0 * f2 + slack, longest2))) + np.uint8(2) * np.uint8(
            is_line & (f2 <= min(9.0 * e2 + slack, longest2))
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
    `joining` as in `_find_joints`. `columns` are moved into the virtual frame, `scratch` uint8 (2, N). Lowers `ranges` float64 (B,) to the nearest
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
        a = positions[i]
        if joints[i] == 0:
            if kinds[i] == EMPTY:
                free[int(a + 0.5) % bins] = 1
            elif kinds[i] == RETURN and drawn == 0:
                best = _find_speck(columns, start, i)
                k = int(positions[best] + 0.5) % bins
                r = math.hypot(xs[best], ys[best])
                if r > far:
                    free[k] = 1
                elif near <= r < ranges[k]:
                    ranges[k], sources[k], indices[k] = r, source, best
            start, drawn = i + 1, 0
            continue
        span = positions[i + 1] - a
        span -= bins if span > 0.5 * bins else (-bins if span < -0.5 * bins else 0)
        first = int(math.ceil(min(a, a + span)))
        last = int(math.floor(max(a, a + span)))
        drawn += last - first + 1
        x0, y0, x1, y1 = xs[i], ys[i], xs[i + 1], ys[i + 1]
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


@jit_fused
def gather_returns(
    columns, kinds, ranges, directions, offset, intensities, timing, source, row,
    out_points, out_intensity, out_time, out_source,
):  # fmt: skip
    """Append the returns of one moved scan to the merged cloud from `row`; returns the next free row.

    `columns` are those of `move_beams`, before they are drawn; `intensities` float32 (N,) or (0,: left as they are). Times are
    seconds after the common time at which each point was measured.
    """
    n = kinds.shape[0]
    begin = 0
    while begin < n:
        if kinds[begin] != RETURN:
            begin += 1
            continue
        end = begin + 1
        while end < n and kinds[end] == RETURN:
            end += 1
        m = end - begin
        x, y = columns[0, begin:end], columns[1, begin:end]
        r, up = ranges[begin:end], directions[2, begin:end]
        place, when = out_points[row : row + m], out_time[row : row + m]
        for i in range(m):
            place[i, 0] = x[i]
            place[i, 1] = y[i]
            place[i, 2] = r[i] * up[i] + offset[2]
        for i in range(m):
            when[i] = timing[0] + (begin + i) * timing[1]
        out_source[row : row + m] = source
        if intensities.shape[0] == n:
            out_intensity[row : row + m] = intensities[begin:end]
        row += m
        begin = end
    return row


@jit_fused
def _place_points(cloud, m, x, y, z):
    for i in range(cloud.shape[0]):
        px, py, pz = np.float64(cloud[i, 0]), np.float64(cloud[i, 1]), np.float64(cloud[i, 2])
        x[i] = m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3]
        y[i] = m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3]
        z[i] = m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3]


@jit_fused
def _carry_points(x, y, times, twist):
    vx, vy, wz = twist[0], twist[1], twist[2]
    longest = np.float32(0.0)
    for i in range(times.shape[0]):
        longest = max(longest, abs(times[i]))
    if longest * abs(wz) < SMALL_TURN:
        for i in range(times.shape[0]):
            t = np.float64(times[i])
            w = wz * t
            w2 = w * w
            a = 1.0 - w2 * (1 / 6 - w2 * (1 / 120 - w2 * (1 / 5040 - w2 / 362880)))
            b = w * (0.5 - w2 * (1 / 24 - w2 * (1 / 720 - w2 / 40320)))
            s, c = w * a, 1.0 - w * b
            bx, by = x[i], y[i]
            x[i] = c * bx - s * by + t * (a * vx - b * vy)
            y[i] = s * bx + c * by + t * (b * vx + a * vy)
    else:
        for i in range(times.shape[0]):
            x[i], y[i] = carry(x[i], y[i], np.float64(times[i]), twist)


@jit_fused
def _is_any_near(x, y, reach2):
    near = 0
    for i in range(x.shape[0]):
        near += int(x[i] * x[i] + y[i] * y[i] <= reach2)
    return near > 0


@jit_fused
def _sort_points(x, y, z, n, origin, band, limits, bins, values, cells, fates):
    """Write each point's bin, its fate (the index in the counts of `cloud_to_bins`), and its distance or how far it is free."""
    ox, oy, c, s, oz = origin[0], origin[1], origin[2], origin[3], origin[4]
    low, high, near, far = band[0], band[1], limits[0], limits[1]
    below = oz - low if low < oz < high else 0.0
    above = oz - high if low < oz < high else 0.0
    for i in range(n):
        dx, dy = x[i] - ox, y[i] - oy
        d = math.sqrt(dx * dx + dy * dy)
        is_below, is_above = z[i] < low, z[i] > high
        is_far = d > far
        fate = np.uint8(3) if is_far | (d < near) else np.uint8(0)
        fate = np.uint8(1) if is_below | is_above else fate
        fates[i] = fate if abs(z[i]) + d < math.inf else np.uint8(4)
        inside = (below if is_below else above) / (oz - z[i])
        free = d * inside if is_below | is_above else (math.inf if is_far else 0.0)
        values[i] = d if fate == 0 else free
        cell = np.int32((turn_of(c * dy - s * dx, c * dx + s * dy) + 0.5) * bins + 0.5)
        cells[i] = cell - bins if cell >= bins else cell


@jit
def cloud_to_bins(
    cloud, times, base_from_sensor, twist, vertices, starts, mask_reach, origin, band, limits, ranges, reach, counts
):
    """Flatten a cloud into the bins of a virtual scanner: the nearest return inside the height band of each azimuth.

    `cloud` float32 (N, 3) in the sensor frame, `times` float32 (N,) seconds after the common time, `twist` (vx, vy, wz) of the
    base over the cloud, `origin` (x, y, cos, sin, z) of the virtual scanner in the base frame, `band` (z_min, z_max) in the
    base frame, `limits` (range_min, range_max). Lowers `ranges` float64 (B,); raises `reach` float64 (B,) to how far the
    rays of the bin are known free inside the band, seen from the virtual origin at height z. `counts` int64 (5,): used,
    outside the band, on the robot itself, outside the range limits, not finite.
    """
    bins = np.int32(ranges.shape[0])
    work = np.empty((4, BLOCK))
    x, y, z, values = work[0], work[1], work[2], work[3]
    cells, fates = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.uint8)
    moves = twist[0] != 0.0 or twist[1] != 0.0 or twist[2] != 0.0
    for first in range(0, cloud.shape[0], BLOCK):
        last = min(first + BLOCK, cloud.shape[0])
        _place_points(cloud[first:last], base_from_sensor, x, y, z)
        if _is_any_near(x[: last - first], y, mask_reach * mask_reach):
            for i in range(last - first):
                if x[i] * x[i] + y[i] * y[i] <= mask_reach * mask_reach and is_inside(x[i], y[i], vertices, starts):
                    counts[2] += 1
                    counts[4] -= 1
                    z[i] = math.nan
        if moves:
            _carry_points(x, y, times[first:last], twist)
        _sort_points(x, y, z, last - first, origin, band, limits, bins, values, cells, fates)
        for i in range(last - first):
            fate = fates[i]
            counts[fate] += 1
            if fate == 0:
                ranges[cells[i]] = min(ranges[cells[i]], values[i])
            elif fate < 4 and values[i] > reach[cells[i]]:
                reach[cells[i]] = values[i]


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    n, bins = 4, 8
    columns, kinds, counts = np.zeros((3, n)), np.zeros(n, np.uint8), np.zeros(5, np.int64)
    vertices, starts = np.zeros((0, 2)), np.zeros(1, np.int64)
    scan, directions, three = np.ones(n, np.float32), np.ones((3, n)), np.zeros(3)
    knots, poses = np.zeros(1), np.zeros((1, 3))
    two, used = np.array([0.0, 10.0]), np.ones(n, np.uint8)
    move_beams(
        scan, directions, used, two, np.zeros(2), three, knots, poses, poses.copy(), vertices, starts, 0.0,
        columns, kinds, counts,
    )  # fmt: skip
    gather_returns(
        columns, kinds, scan, directions, three, scan, np.zeros(2), 0, 0,
        np.zeros((n, 3), np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.uint16),
    )  # fmt: skip
    ranges, free = np.full(bins, np.inf), np.zeros(bins, np.uint8)
    draw_scan(
        columns, kinds, np.array([0.0, 0.0, 1.0, 0.0]), np.ones((bins, 2)), two, two, 0, np.zeros((2, n), np.uint8),
        ranges, free, np.zeros(bins, np.int16), np.zeros(bins, np.int32),
    )  # fmt: skip
    finish_scan(ranges, free, np.zeros(bins, np.float32))
    mask_points(np.zeros((1, 2)), vertices, starts, np.zeros(1, np.uint8))
    cloud_to_bins(
        np.ones((n, 3), np.float32), np.zeros(n, np.float32), np.ascontiguousarray(np.eye(4)[:3]), three,
        vertices, starts, 0.0, np.array([0.0, 0.0, 1.0, 0.0, 0.5]), two, two, ranges, np.zeros(bins), counts,
    )  # fmt: skip
