"""Kernels that carry every beam of a moving scanner to one common time.

Between two odometry knots the base moves with a constant twist:
p_ref = ref_from_base(t_k) * exp(twist_k * (t - t_k)) * base_from_sensor * p.

The passes are straight loops over separate float32 columns, block by block, which LLVM turns into vector instructions.
"""

import math

import numpy as np

from ambler.kernels.jit import jit, jit_fused, read_only
from ambler.kernels.scan_points import carry
from ambler.kernels.self_mask import is_inside

NOTHING, RETURN, EMPTY = 0, 1, 2
RETURNS, EMPTIES, MASKED, INVALID, UNUSED = 0, 1, 2, 3, 4
BLOCK = 512
ONE, SMALL_TURN = np.float32(1.0), np.float32(0.5)
A2, A4, A6 = np.float32(1 / 6), np.float32(1 / 120), np.float32(1 / 5040)
B1, B3, B5, B7 = np.float32(0.5), np.float32(1 / 24), np.float32(1 / 720), np.float32(1 / 40320)


@jit_fused
def carry_block(x, y, times, twist, pose):
    """Move points (seen at `times` seconds after a knot) by the knot's twist, then by its pose (x, y, yaw), in place.

    `x`, `y`, `times` float32 (N,). Slow turns take the series of sin(w)/w and (1 - cos(w))/w, exact to float32.
    """
    cos_k, sin_k = np.float32(math.cos(pose[2])), np.float32(math.sin(pose[2]))
    vx, vy, wz = np.float32(twist[0]), np.float32(twist[1]), np.float32(twist[2])
    px, py = np.float32(pose[0]), np.float32(pose[1])
    n = x.shape[0]
    fast = np.int32(0)
    for i in range(n):
        fast = np.int32(fast + np.int32(abs(times[i] * wz) >= SMALL_TURN))
    if fast == 0:
        for i in range(n):
            t = times[i]
            w = wz * t
            w2 = w * w
            a = ONE - w2 * (A2 - w2 * (A4 - w2 * A6))
            b = w * (B1 - w2 * (B3 - w2 * (B5 - w2 * B7)))
            s, c = w * a, ONE - w * b
            bx = c * x[i] - s * y[i] + t * (a * vx - b * vy)
            by = s * x[i] + c * y[i] + t * (b * vx + a * vy)
            x[i] = px + cos_k * bx - sin_k * by
            y[i] = py + sin_k * bx + cos_k * by
    else:
        for i in range(n):
            fx, fy = carry(np.float64(x[i]), np.float64(y[i]), np.float64(times[i]), twist)
            x[i] = px + cos_k * np.float32(fx) - sin_k * np.float32(fy)
            y[i] = py + sin_k * np.float32(fx) + cos_k * np.float32(fy)


@jit_fused
def _place_beams(ranges, dx, dy, used, limits, offset, x, y, kinds):
    """Write where each beam ends in the base frame of its own instant, and its kind."""
    near, far = np.float32(limits[0]), np.float32(limits[1])
    ox, oy = np.float32(offset[0]), np.float32(offset[1])
    for i in range(ranges.shape[0]):
        r = ranges[i]
        kind = np.uint8(RETURN) if r <= far else np.uint8(EMPTY)
        r = r if r <= far else far
        is_good = (ranges[i] >= near) & (used[i] != 0)
        kinds[i] = kind if is_good else np.uint8(NOTHING)
        x[i] = r * dx[i] + ox
        y[i] = r * dy[i] + oy


@jit_fused
def _count_kinds(used, x, y, kinds, reach2, counts):
    """Count the kinds of a block; returns how many returns lie within the reach of the self-mask."""
    returns = empties = unused = near = np.int32(0)
    limit = np.float32(reach2)
    for i in range(kinds.shape[0]):
        is_return = kinds[i] == RETURN
        is_near = is_return & (x[i] * x[i] + y[i] * y[i] <= limit)
        returns = np.int32(
            returns + np.int32(is_return)
        )  # as narrow as the compared floats, so that LLVM vectorises it
        empties = np.int32(empties + np.int32(kinds[i] == EMPTY))
        unused = np.int32(unused + np.int32(used[i] == 0))
        near = np.int32(near + np.int32(is_near))
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

    `ranges` float32 (N,); `directions` float32 (3, N) unit vectors in the base frame and `offset` (3,) the scanner's position;
    `used` uint8 (N,) the angle windows; `limits` (range_min, range_max); `timing` (first beam, step) in seconds after the
    common time; `knots` (K,) odometry times after it, `poses` (K, 3) reference_from_base at them, `twists` (K, 3) until the
    next. Returns within `mask_reach` (>= 0) of the base that lie in a polygon of the robot itself are dropped. Writes
    `columns` float32 (3, N): x, y where the beam ends (at range_max for an empty one); `kinds` uint8 (N,), `counts` int64 (5,).
    """
    n = ranges.shape[0]
    x, y, dx, dy = columns[0], columns[1], directions[0], directions[1]
    last_knot = knots.shape[0] - 1
    times = np.empty(BLOCK, np.float32)
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
        begin, step, when = np.float32(t - knots[k]), np.float32(timing[1]), times[: last - first]
        for i in range(last - first):
            when[i] = begin + np.float32(i) * step
        carry_block(bx, by, when, twists[k], poses[k])
        first = last


@jit_fused
def gather_rays(
    columns, kinds, kind, ranges, directions, offset, intensities, timing, source, row,
    out_points, out_intensity, out_time, out_source,
):  # fmt: skip
    """Append the rays of one kind (RETURN, EMPTY) of one moved scan to a merged cloud from `row`; returns the next free row.

    `columns` are those of `move_beams`, before they are drawn; `intensities` float32 (N,) or (0,: left as they are). Times are
    seconds after the common time at which each point was measured.
    """
    n = kinds.shape[0]
    begin = 0
    while begin < n:
        if kinds[begin] != kind:
            begin += 1
            continue
        end = begin + 1
        while end < n and kinds[end] == kind:
            end += 1
        m = end - begin
        x, y = columns[0, begin:end], columns[1, begin:end]
        r, up = ranges[begin:end], directions[2, begin:end]
        place, when = out_points[row : row + m], out_time[row : row + m]
        height = np.float32(offset[2])
        for i in range(m):
            place[i, 0] = x[i]
            place[i, 1] = y[i]
            place[i, 2] = r[i] * up[i] + height if kind == RETURN else height
        for i in range(m):
            when[i] = np.float32(timing[0] + (begin + i) * timing[1])
        out_source[row : row + m] = source
        if intensities.shape[0] == n:
            out_intensity[row : row + m] = intensities[begin:end]
        row += m
        begin = end
    return row


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    n = 4
    columns, kinds, counts = np.zeros((3, n), np.float32), np.zeros(n, np.uint8), np.zeros(5, np.int64)
    scan, directions, three = read_only(np.ones(n, np.float32)), np.ones((3, n), np.float32), np.zeros(3)
    poses = np.zeros((1, 3))
    move_beams(
        scan, directions, np.ones(n, np.uint8), np.array([0.0, 10.0]), np.zeros(2), three, np.zeros(1), poses, poses.copy(),
        np.zeros((0, 2)), np.zeros(1, np.int64), 0.0, columns, kinds, counts,
    )  # fmt: skip
    for intensities in (scan, scan.copy()):  # of a scan, and of none
        gather_rays(
            columns, kinds, RETURN, scan, directions, three, intensities, np.zeros(2), 0, 0,
            np.zeros((n, 3), np.float32), np.zeros(n, np.float32), np.zeros(n, np.float32), np.zeros(n, np.uint16),
        )  # fmt: skip
