"""Kernels from ranges and clouds to planar points: motion compensation, height band, voxel filters.

A point measured at `t` seconds after the reference instant moves with the base. How that moved is a `sweep` float64 (K, 4), K >= 2, of
(t, x, y, yaw) at even steps from t = 0, blended linearly in between; or, for a moment, a constant `twist` (vx, vy, wz): p_ref = exp(twist * t) *
base_from_sensor * p. Matrices are the upper (3, 4) of a homogeneous transform.
"""

import math

import numpy as np

from ambler.kernels.jit import jit, read_only

ALONG_BEAMS = 0.5  # sine of the incidence below which what lies one behind the other may be no surface
UPRIGHT = (
    0.15  # metres behind the nearest return within which what is seen above it is the same thing: a person, a wall
)


@jit
def carry(x, y, t, twist):
    """Return (x, y) of a point known in the base frame of time t, in the base frame of time 0."""
    w = twist[2] * t
    vx, vy = twist[0] * t, twist[1] * t
    if abs(w) < 1e-9:
        return x + vx, y + vy
    c, s = math.cos(w), math.sin(w)
    a, b = s / w, (1.0 - c) / w
    return c * x - s * y + a * vx - b * vy, s * x + c * y + b * vx + a * vy


@jit
def carry_along(x, y, t, sweep):
    """Return (x, y) of a point known in the base frame of time t, in the base frame of time 0; beyond its end the sweep goes on as it was."""
    at = t / sweep[1, 0]
    k = min(max(int(at), 0), sweep.shape[0] - 2)
    f = at - k
    yaw = sweep[k, 3] + f * (sweep[k + 1, 3] - sweep[k, 3])
    c, s = math.cos(yaw), math.sin(yaw)
    dx = sweep[k, 1] + f * (sweep[k + 1, 1] - sweep[k, 1])
    dy = sweep[k, 2] + f * (sweep[k + 1, 2] - sweep[k, 2])
    return c * x - s * y + dx, s * x + c * y + dy


@jit
def mount_at(mounts, step, t, m):
    """Write the pose of a sensor `t` seconds after the stamp into `m` float64 (3, 4), blended between `mounts` float64 (K, 3, 4), which
    are `step` seconds apart."""
    last = mounts.shape[0] - 1
    at = min(max(t / step, 0.0), float(last))
    k = min(int(at), last - 1)
    f = at - k
    for i in range(3):
        for j in range(4):
            m[i, j] = mounts[k, i, j] + f * (mounts[k + 1, i, j] - mounts[k, i, j])


@jit
def beams_to_points(
    ranges, beam, limits, floor, mounts, step, sweep, matrix, points, free_points, beams, free_beams, counts
):
    """Split a laser scan into returns and free ends, both in the base frame of the scan's stamp.

    `beam` (angle_min, angle_increment, time_increment); `limits` (range_min, range_max, free_length). NaN and too short
    ranges are dropped; ranges beyond range_max (and +inf) become free ends at free_length. `mounts` float64 (K, 3, 4) are the sensor's
    poses every `step` seconds, level where the body leans (K = 1: at rest in the base); `floor` (height, doubt): a return lower than height +
    doubt * range is the floor, and its beam free up to where it sank below that. `matrix` float64 (3, 4) is scratch. `points`,
    `free_points` float32 (N, 2), `beams`, `free_beams` int32 (N,) the beam of each, `counts` int64 (2,) how many of each were written.
    """
    n_hit = 0
    n_free = 0
    matrix[:, :] = mounts[0]
    m = matrix
    for i in range(ranges.shape[0]):
        r = float(ranges[i])
        if math.isnan(r) or r < limits[0]:
            continue
        if mounts.shape[0] > 1:
            mount_at(mounts, step, i * beam[2], m)
        a = beam[0] + i * beam[1]
        sink = -(m[2, 0] * math.cos(a) + m[2, 1] * math.sin(a)) + floor[1]
        over = m[2, 3] - floor[0]
        is_free = r > limits[1]
        if is_free:
            r = limits[2]
        if over < r * sink:
            r = min(limits[2], over / sink) if over > 0.0 else 0.0
            is_free = True
            if r < limits[0]:
                continue
        sx, sy = r * math.cos(a), r * math.sin(a)
        x, y = carry_along(
            m[0, 0] * sx + m[0, 1] * sy + m[0, 3], m[1, 0] * sx + m[1, 1] * sy + m[1, 3], i * beam[2], sweep
        )
        if is_free:
            free_points[n_free, 0] = x
            free_points[n_free, 1] = y
            free_beams[n_free] = i
            n_free += 1
        else:
            points[n_hit, 0] = x
            points[n_hit, 1] = y
            beams[n_hit] = i
            n_hit += 1
    counts[0] = n_hit
    counts[1] = n_free


@jit
def beam_starts(beams, step, offset, sweep, starts):
    """Write where the sensor was when each beam was measured, in the base frame of the scan's stamp.

    `beams` int32 (N,), taken `step` seconds one after the other; `offset` float64 (2,) the sensor in the base frame; `starts` float32 (N, 2).
    """
    for i in range(beams.shape[0]):
        x, y = carry_along(offset[0], offset[1], beams[i] * step, sweep)
        starts[i, 0] = x
        starts[i, 1] = y


@jit
def split_rays(ends, sources, times, offsets, twist, limits, points, starts, free_points, free_starts, kept, counts):
    """Split the rays of a merged cloud, whose ends already lie in the base frame of its stamp, into returns and free ends.

    `ends` float32 (N, 3); `sources` uint16 (N,) which sensor; `times` float32 (N,) when each was measured, s after the stamp; `offsets`
    float64 (S, 2) the sensors in the base frame, carried to each ray's start by `twist`; `limits` (range_min, range_max, free_length)
    along the ray. Outputs float32 (N, 2), `kept` int32 (N,) the row of each return; `counts` int64 (2,). A negative range_max makes all rays free.
    """
    n_hit = 0
    n_free = 0
    for i in range(ends.shape[0]):
        source = sources[i]
        if source >= offsets.shape[0]:
            continue
        sx, sy = carry(offsets[source, 0], offsets[source, 1], float(times[i]), twist)
        dx, dy = float(ends[i, 0]) - sx, float(ends[i, 1]) - sy
        d = math.hypot(dx, dy)
        if not d >= limits[0]:
            continue
        if d > limits[1]:
            share = min(1.0, limits[2] / d)
            free_points[n_free, 0] = sx + share * dx
            free_points[n_free, 1] = sy + share * dy
            free_starts[n_free, 0] = sx
            free_starts[n_free, 1] = sy
            n_free += 1
        else:
            points[n_hit, 0] = ends[i, 0]
            points[n_hit, 1] = ends[i, 1]
            starts[n_hit, 0] = sx
            starts[n_hit, 1] = sy
            kept[n_hit] = i
            n_hit += 1
    counts[0] = n_hit
    counts[1] = n_free


@jit
def _rise(x, y, ground, place):
    """Return how much higher the ground is at a place of the base's frame than under the base; 0 where it is not known."""
    if ground.shape[0] == 0:
        return 0.0
    ix = int(math.floor((place[3] + place[5] * x - place[6] * y - place[0]) / place[2]))
    iy = int(math.floor((place[4] + place[6] * x + place[5] * y - place[1]) / place[2]))
    if ix < 0 or iy < 0 or ix >= ground.shape[1] or iy >= ground.shape[0] or not math.isfinite(ground[iy, ix]):
        return 0.0
    return ground[iy, ix] - place[7]


@jit
def cloud_to_points(
    cloud, times, mounts, step, sweep, band, limits, ground, place, matrix, inside, nearest, reach, points, free_points,
    heights, free_sinks, counts,
):  # fmt: skip
    """Flatten a cloud: per azimuth bin the nearest surface inside the height band, else how far the bin is seen to be free.

    The nearest surface is the mean of the returns within `limits[3]` behind the nearest one: the nearest of several noisy returns by
    itself would lie too near.

    `cloud` float32 (N, 3) in the sensor frame, `times` float32 (N,) s after the stamp, `mounts` float64 (K, 3, 4) the sensor's poses
    every `step` seconds, level where the body leans, `matrix` float64 (3, 4) scratch, `band` (z_min, z_max, doubt) above the base
    origin's ground, whose lower edge rises by `doubt` with the distance, `limits` (range_min, range_max, free_length, depth) of planar distance
    from the sensor. A return above or below the band proves its ray free while the ray is inside the band. Heights count from the floor, which is
    level but where `ground` float32 (H, W) tells how high it is (NaN: not known), with `place` float64 (8,) its first corner and the edge of a cell, and the base's
    x, y, cosine and sine of its yaw and height in its frame; towards there it rises or falls evenly. `nearest` and `reach`
    float64 (B, 6) and (B, 3) and `inside` float64 (N, 5) are scratch: planar distance, sums of x, y and their number, fall of the lowest ray
    per metre, top; distance, x, y; bin, distance, x, y, height of a return. Outputs as in `beams_to_points`, and `heights` float32 (B, 2): top of
    the surface (inf where it goes on above the band) and fall of the lowest ray per metre; `free_sinks` float32 (B,) that fall of free rays.
    """
    bins = nearest.shape[0]
    matrix[:, :] = mounts[0]
    m = matrix
    for b in range(bins):
        nearest[b, 0] = math.inf
        nearest[b, 1], nearest[b, 2], nearest[b, 3] = 0.0, 0.0, 0.0
        nearest[b, 4], nearest[b, 5] = -math.inf, -math.inf
        reach[b, 0] = 0.0
    n_inside = 0
    for i in range(cloud.shape[0]):
        px, py, pz = float(cloud[i, 0]), float(cloud[i, 1]), float(cloud[i, 2])
        if mounts.shape[0] > 1:
            mount_at(mounts, step, float(times[i]), m)
        ox, oy, oz = m[0, 3], m[1, 3], m[2, 3]
        bx = m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + ox
        by = m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + oy
        z = m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + oz - _rise(bx, by, ground, place)
        dx, dy = bx - ox, by - oy
        d = math.hypot(dx, dy)
        if not d >= limits[0]:
            continue
        b = int((math.atan2(dy, dx) + math.pi) / (2.0 * math.pi) * bins)
        b = min(max(b, 0), bins - 1)
        nearest[b, 4] = max(nearest[b, 4], (oz - z) / d)
        length = d
        is_obstacle = False
        if z < band[0] + band[2] * d:
            length = d * (oz - band[0]) / (oz - z + band[2] * d) if oz > band[0] else 0.0
        elif z > band[1]:
            length = d * (band[1] - oz) / (z - oz) if oz < band[1] else 0.0
        else:
            is_obstacle = d <= limits[1]
        if is_obstacle:
            x, y = carry_along(bx, by, float(times[i]), sweep)
            inside[n_inside, 0], inside[n_inside, 1], inside[n_inside, 2], inside[n_inside, 3] = b, d, x, y
            inside[n_inside, 4] = z
            n_inside += 1
            nearest[b, 0] = min(nearest[b, 0], d)
        else:
            if z > band[1]:
                inside[n_inside, 0], inside[n_inside, 1], inside[n_inside, 4] = b, d, math.inf
                n_inside += 1
            length = min(length, limits[2])
            if length > reach[b, 0]:
                x, y = carry_along(ox + dx * length / d, oy + dy * length / d, float(times[i]), sweep)
                reach[b, 0], reach[b, 1], reach[b, 2] = length, x, y
    for i in range(n_inside):
        b = int(inside[i, 0])
        if inside[i, 1] <= nearest[b, 0] + UPRIGHT:
            nearest[b, 5] = max(nearest[b, 5], inside[i, 4])
        if inside[i, 4] < math.inf and inside[i, 1] <= nearest[b, 0] + limits[3]:
            nearest[b, 1] += inside[i, 2]
            nearest[b, 2] += inside[i, 3]
            nearest[b, 3] += 1.0
    n_hit = 0
    n_free = 0
    for b in range(bins):
        if nearest[b, 3] > 0.0:
            points[n_hit, 0] = nearest[b, 1] / nearest[b, 3]
            points[n_hit, 1] = nearest[b, 2] / nearest[b, 3]
            heights[n_hit, 0], heights[n_hit, 1] = nearest[b, 5], nearest[b, 4]
            n_hit += 1
        elif reach[b, 0] > limits[0]:
            free_points[n_free, 0] = reach[b, 1]
            free_points[n_free, 1] = reach[b, 2]
            free_sinks[n_free] = nearest[b, 4]
            n_free += 1
    counts[0] = n_hit
    counts[1] = n_free


@jit
def _voxel_key(x, y, size):
    kx = int(math.floor(x / size)) + 1048576
    ky = int(math.floor(y / size)) + 1048576
    return (kx << 21) | ky


@jit
def _voxel_slot(key, mask):
    h = key ^ (key >> 17)
    h = (h * 0x9E3779B1) & 0x7FFFFFFFFFFF
    return (h ^ (h >> 23)) & mask


@jit
def _slot_of(key, keys):
    """Return where a key lies in the hash table, put there if it was not yet."""
    mask = keys.shape[0] - 1
    h = _voxel_slot(key, mask)
    while keys[h] != -1 and keys[h] != key:
        h = (h + 1) & mask
    keys[h] = key
    return h


@jit
def _count_voxels(points, size, table):
    """Write into `table` how many points each voxel holds; returns how many voxels there are."""
    keys, counts = table[0], table[1]
    keys[:], counts[:] = -1, 0
    n = 0
    for i in range(points.shape[0]):
        h = _slot_of(_voxel_key(points[i, 0], points[i, 1], size), keys)
        n += counts[h] == 0
        counts[h] += 1
    return n


@jit
def choose_voxels(points, size, table, picks_middle, chosen):
    """Write the row of one point of every square voxel into `chosen` int64 (N,), in their order; returns how many.

    Of the points of a voxel it is the first one in the order of the scan, or with `picks_middle` the middle one. The first one is biased: along a wall, noise of the range brings a beam
    into the next voxel early, so that walls would be chosen too near before the foot of their perpendicular and too far behind it, and every
    scan turns with its scanner. `points` float32 (N, 2); `table` int64 (3, M), M a power of two of at least 2 N, scratch.
    """
    _count_voxels(points, size, table)
    keys, counts, seen = table[0], table[1], table[2]
    seen[:] = 0
    n = 0
    for i in range(points.shape[0]):
        h = _slot_of(_voxel_key(points[i, 0], points[i, 1], size), keys)
        middle = (counts[h] - 1 + (h & 1)) >> 1  # of an even number the lower or the upper one, by chance
        if seen[h] == (middle if picks_middle else 0):
            chosen[n] = i
            n += 1
        seen[h] += 1
    return n


@jit
def voxel_filter(points, size, table, picks_middle, chosen, out):
    """Copy the points that `choose_voxels` chooses to `out` float32 (N, 2); returns how many. `chosen` int64 (N,) is scratch."""
    n = choose_voxels(points, size, table, picks_middle, chosen)
    for k in range(n):
        out[k, 0], out[k, 1] = points[chosen[k], 0], points[chosen[k], 1]
    return n


@jit
def adaptive_voxel_filter(points, max_size, min_points, table, picks_middle, chosen, out):
    """Filter with the largest voxel that keeps at least `min_points`; returns how many were written to `out`.

    Halving, then bisection to 10 % (Cartographer's adaptive voxel filter).
    """
    n_all = points.shape[0]
    if n_all <= min_points:
        for i in range(n_all):
            out[i, 0] = points[i, 0]
            out[i, 1] = points[i, 1]
        return n_all
    n = _count_voxels(points, max_size, table)
    if n >= min_points:
        return voxel_filter(points, max_size, table, picks_middle, chosen, out)
    high = max_size
    low = max_size * 0.5
    while low > 0.01 * max_size:
        n = _count_voxels(points, low, table)
        if n >= min_points:
            break
        high = low
        low *= 0.5
    while n >= min_points and (high - low) / low > 0.1:
        middle = 0.5 * (low + high)
        if _count_voxels(points, middle, table) >= min_points:
            low = middle
        else:
            high = middle
    return voxel_filter(points, low, table, picks_middle, chosen, out)


@jit
def _turn_cosine(points, i, j, k, m):
    """Return the cosine of the angle between the segments i -> j and k -> m; -1 where one has no length."""
    ax, ay = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    bx, by = points[m, 0] - points[k, 0], points[m, 1] - points[k, 1]
    length = math.hypot(ax, ay) * math.hypot(bx, by)
    return (ax * bx + ay * by) / length if length > 0.0 else -1.0


@jit
def _runs_on(points, i, least):
    """Whether the segment from return i to the next one runs on to the return behind that, bent by no more than the cosine `least`."""
    return i >= 0 and i + 2 < points.shape[0] and _turn_cosine(points, i, i + 1, i + 1, i + 2) >= least


@jit
def _goes_on(points, i, origin, limits):
    """Whether a surface goes on from return i to the next one; `limits` as in `fill_surfaces`."""
    dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
    gap = math.hypot(dx, dy)
    if gap <= limits[0] or gap > limits[1]:
        return False
    ax, ay = points[i, 0] - origin[0], points[i, 1] - origin[1]
    bx, by = ax + dx, ay + dy
    across = abs(ax * by - ay * bx)
    if across > math.sin(limits[2]) * math.hypot(ax, ay) * math.hypot(bx, by) or ax * bx + ay * by <= 0.0:
        return False
    if across < limits[3] * gap * max(math.hypot(ax, ay), math.hypot(bx, by)):
        return False
    runs = int(_runs_on(points, i - 1, limits[4])) + int(_runs_on(points, i, limits[4]))
    if runs == 0 or across >= ALONG_BEAMS * gap * max(math.hypot(ax, ay), math.hypot(bx, by)):
        return runs > 0
    return (
        runs == 2
        or (_runs_on(points, i - 1, limits[4]) and _runs_on(points, i - 2, limits[4]))
        or (_runs_on(points, i, limits[4]) and _runs_on(points, i + 1, limits[4]))
    )


@jit
def fill_surfaces(points, origin, limits, out, counts):
    """Write the points of the surface between neighbouring returns, where a wall goes on from one to the next.

    `points` float32 (N, 2) in the order of the beams, `origin` float64 (2,) the sensor; `limits` float64 (L, 5), the strictest first: (spacing, longest gap, widest angle
    between neighbouring beams, least sine of incidence, least cosine of the bend to a neighbouring segment). A wall goes on where the
    segment before or behind runs the same way; two returns alone may be two things. Where it runs along the beams, two more segments must: one thing, a farther one and a return that
    their edge tears lie on a line as well. `out` float32 (M, 2), filling ends when it is full; `counts` int64 (L,): how many
    points are written when what each of the limits allows has been.
    """
    filled = 0
    for level in range(limits.shape[0]):
        for i in range(points.shape[0] - 1):
            if not _goes_on(points, i, origin, limits[level]):
                continue
            if level > 0 and _goes_on(points, i, origin, limits[level - 1]):
                continue
            dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
            steps = int(math.ceil(math.hypot(dx, dy) / limits[level, 0]))
            for k in range(1, min(steps, out.shape[0] - filled + 1)):
                out[filled, 0] = points[i, 0] + dx * k / steps
                out[filled, 1] = points[i, 1] + dy * k / steps
                filled += 1
        counts[level] = filled


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    points = np.zeros((4, 2), np.float32)
    out = np.zeros((4, 2), np.float32)
    counts = np.zeros(2, np.int64)
    eye = np.ascontiguousarray(np.eye(4)[:3])
    three = np.ones(3)
    beams = np.zeros(4, np.int32)
    mounts = np.stack((eye, eye))
    sweep = np.array([[0.0, 0.0, 0.0, 0.0], [0.1, 0.0, 0.0, 0.0]])
    matrix = np.empty((3, 4))
    beams_to_points(
        *(read_only(np.ones(4, np.float32)), three, three, np.zeros(2), mounts, 0.1, sweep, matrix),
        *(points, out, beams, beams.copy(), counts),
    )
    beam_starts(beams, 0.0, np.zeros(2), sweep, out)
    ends, when, source = np.ones((4, 3), np.float32), np.zeros(4, np.float32), np.zeros(4, np.uint16)
    split_rays(ends, source, when, np.zeros((1, 2)), three, three, points, out, points, out, beams, counts)
    cloud_to_points(
        read_only(np.ones((4, 3), np.float32)),
        read_only(np.zeros(4, np.float32)),
        mounts,
        0.1,
        sweep,
        three,
        np.ones(4),
        np.zeros((1, 1), np.float32),
        np.ones(8),
        matrix,
        np.zeros((8, 5)),
        np.zeros((8, 6)),
        np.zeros((8, 3)),
        np.zeros((8, 2), np.float32),
        np.zeros((8, 2), np.float32),
        np.zeros((8, 2), np.float32),
        np.zeros(8, np.float32),
        counts,
    )
    table, chosen = np.zeros((3, 16), np.int64), np.zeros(4, np.int64)
    voxel_filter(points, 0.1, table, True, chosen, out)
    choose_voxels(points, 0.1, table, True, chosen)
    adaptive_voxel_filter(points, 0.5, 2, table, True, chosen, out)
    fill_surfaces(points, np.zeros(2), np.ones((2, 5)), out, counts)
