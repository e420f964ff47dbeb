"""A random search for counterexamples to what the protective field promises: draws footprints, points and arcs, and checks each case.

Half of the cases have round numbers (multiples of 1/64), where points lie exactly on edges, arcs are tangent and axes are zero.
"""

import math

import numpy as np

from ambler.kernels.jit import jit
from ambler.kernels.protective_field import braking_time, free_scale, stopping_time

PROPERTIES = ("monotone", "bounded", "safe", "careful", "mirrored", "turned", "crowded")
"""monotone: at every share of a velocity the same absolute speed is allowed; bounded: the scale is a number from 0 to 1; safe: on
the way to a stand fewer than `min_points` points come nearer than they may; careful: a robot held back would stand where a
point touches; mirrored, turned: the same from the other side and in any other frame; crowded: one more point never frees."""
POINTS_MOST, EDGES_MOST = 14, 7
MARGIN, REACTION, AX, AY, AZ, SHARE, MIN_POINTS = range(7)
NEARER, SELF_DEPTH = 1e-4, 0.05
SAME = 1e-6  # largest difference of two equal scales
GRAZE = 1e-7  # metres within which rounding decides whether a point is touched
TOUCH = 1e-6  # metres
CHANCES = 128  # uniform numbers that a case may use
SAMPLES = 6  # instants of the way to a stand at which the distances are looked at


@jit
def uniform(rng, low, high):
    """Take the next uniform number. `rng` is (float64 (CHANCES,) uniform in 0..1, int64 (1,) how many of them are used up)."""
    numbers, used = rng
    used[0] += 1
    return low + (high - low) * numbers[used[0] - 1]


@jit
def whole(rng, low, end):
    """Take a whole number, low <= number < end."""
    return int(math.floor(uniform(rng, low, end)))


@jit
def draw_value(rng, low, high, is_round):
    """Return a uniform number, a multiple of 1/64 if it shall be round."""
    value = uniform(rng, low, high)
    return math.floor(64.0 * value + 0.5) / 64.0 if is_round else value


@jit
def draw_footprint(rng, is_round, corners):
    """Write the corners of a convex, counter-clockwise polygon around the base into float64 (EDGES_MOST, 2); returns how many."""
    length, width = draw_value(rng, 0.15, 0.7, is_round), draw_value(rng, 0.15, 0.7, is_round)
    if is_round or uniform(rng, 0.0, 1.0) < 0.3:
        for m in range(4):
            corners[m, 0] = length if m in (0, 1) else -length
            corners[m, 1] = width if m in (1, 2) else -width
        return 4
    count = whole(rng, 3, EDGES_MOST + 1)
    for m in range(count):
        angle = 2.0 * math.pi * (m + uniform(rng, 0.0, 0.7)) / count
        corners[m, 0], corners[m, 1] = length * math.cos(angle), width * math.sin(angle)
    return count


@jit
def edges_of(corners, count, normals, offsets, margin):
    """Write normals and offsets of the polygon's edges; returns the radius about the base around it with its margin."""
    radius = 0.0
    for m in range(count):
        n = (m + 1) % count
        dx, dy = corners[n, 0] - corners[m, 0], corners[n, 1] - corners[m, 1]
        length = math.hypot(dx, dy)
        normals[m, 0], normals[m, 1] = dy / length, -dx / length
        offsets[m] = normals[m, 0] * corners[m, 0] + normals[m, 1] * corners[m, 1]
    for m in range(count):
        n = (m + 1) % count
        a, b = offsets[m] + margin, offsets[n] + margin
        det = normals[m, 0] * normals[n, 1] - normals[m, 1] * normals[n, 0]
        x, y = (a * normals[n, 1] - b * normals[m, 1]) / det, (normals[m, 0] * b - normals[n, 0] * a) / det
        radius = max(radius, math.hypot(x, y))
    return radius


@jit
def draw_case(rng, corners, points, twist, numbers):
    """Write one case; returns (edges, points)."""
    is_round = uniform(rng, 0.0, 1.0) < 0.5
    edges = draw_footprint(rng, is_round, corners)
    for m in range(3):
        is_used = uniform(rng, 0.0, 1.0) < 0.75
        twist[m] = draw_value(rng, -1.0, 1.0, is_round) if is_used else 0.0
    twist[2] *= 1.5
    if uniform(rng, 0.0, 1.0) < 0.1:
        twist[2] *= 10.0 ** uniform(rng, -12.0, 0.0)
    if uniform(rng, 0.0, 1.0) < 0.1:
        twist *= 10.0 ** uniform(rng, -4.0, 0.0)
    numbers[MARGIN] = 0.01 * whole(rng, 0, 6)
    numbers[REACTION] = 0.1 * whole(rng, 0, 4)
    for m in (AX, AY, AZ):
        numbers[m] = draw_value(rng, 0.5, 3.0, is_round)
    numbers[SHARE] = draw_value(rng, 0.02, 1.0, is_round)
    numbers[MIN_POINTS] = whole(rng, 1, 4)
    count = 0
    while count < POINTS_MOST - 4 and (count == 0 or uniform(rng, 0.0, 1.0) < 0.7):
        count = draw_thing(rng, is_round, corners, edges, points, count)
    return edges, count


@jit
def draw_thing(rng, is_round, corners, edges, points, count):
    """Add one to three points of one thing, somewhere or beside an edge of the footprint; returns how many there are now."""
    if uniform(rng, 0.0, 1.0) < 0.4:
        x, y = draw_value(rng, -1.6, 1.6, is_round), draw_value(rng, -1.6, 1.6, is_round)
    else:
        m = whole(rng, 0, edges)
        n = (m + 1) % edges
        along, beside = uniform(rng, 0.0, 1.0), uniform(rng, -0.06, 0.2)
        dx, dy = corners[n, 0] - corners[m, 0], corners[n, 1] - corners[m, 1]
        length = math.hypot(dx, dy)
        x = corners[m, 0] + along * dx + beside * dy / length
        y = corners[m, 1] + along * dy - beside * dx / length
        if is_round:
            x, y = math.floor(64.0 * x + 0.5) / 64.0, math.floor(64.0 * y + 0.5) / 64.0
    for k in range(whole(rng, 1, 4)):
        points[count, 0], points[count, 1] = x, y + 0.004 * k
        count += 1
    return count


@jit
def clearances(points, count, normals, offsets, edges, twist, t, out):
    """Write the signed distance of every point from the footprint that has moved for t seconds, by its pose in the old frame."""
    a = twist[2] * t
    c, s = math.cos(a), math.sin(a)
    if abs(a) < 1e-7:
        x, y = t * (twist[0] - 0.5 * a * twist[1]), t * (twist[1] + 0.5 * a * twist[0])
    else:
        x = (s * twist[0] - 2.0 * math.sin(0.5 * a) ** 2 * twist[1]) / twist[2]
        y = (2.0 * math.sin(0.5 * a) ** 2 * twist[0] + s * twist[1]) / twist[2]
    for i in range(count):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        px, py = c * dx + s * dy, c * dy - s * dx
        out[i] = -np.inf
        for e in range(edges):
            out[i] = max(out[i], normals[e, 0] * px + normals[e, 1] * py - offsets[e])


@jit
def scale_of(corners, edges, points, count, twist, braking, numbers, shift):
    """Return what the field leaves of a velocity, with every limit of a distance moved outwards by `shift`."""
    normals, offsets = np.empty((edges, 2)), np.empty(edges)
    margin = numbers[MARGIN] + shift
    radius = edges_of(corners, edges, normals, offsets, margin)
    least, reaction = int(numbers[MIN_POINTS]), numbers[REACTION]
    seen = points[:count]
    return free_scale(
        seen, normals, offsets, radius, twist, braking, reaction, margin, NEARER - shift, SELF_DEPTH, least
    )


@jit
def brake_of(twist, numbers):
    """Return the seconds from this velocity to a stand."""
    return braking_time(twist[0], twist[1], twist[2], numbers[AX], numbers[AY], numbers[AZ])


@jit
def is_graze(value, share, corners, edges, points, count, twist, numbers):
    """Say whether `value` is what a margin a hair larger or smaller allows: a point grazes the margin, and rounding decides."""
    for shift in (GRAZE, -GRAZE):
        allowed = min(share, scale_of(corners, edges, points, count, twist, brake_of(twist, numbers), numbers, shift))
        if (shift > 0.0 and value < allowed - SAME) or (shift < 0.0 and value > allowed + SAME):
            return False
    return True


@jit
def is_stop_safe(scale, corners, edges, points, count, twist, numbers, rng):
    """Return (safe, careful): on the way to a stand too few points come too near; and a point touches where it ends, if it is held."""
    normals, offsets = np.empty((edges, 2)), np.empty(edges)
    edges_of(corners, edges, normals, offsets, 0.0)
    limit, now = np.empty(count), np.empty(count)
    is_near = np.zeros(count, np.bool_)
    clearances(points, count, normals, offsets, edges, twist, 0.0, limit)
    for i in range(count):
        # what is deep inside is the robot itself and may come as near as it likes
        limit[i] = min(numbers[MARGIN], limit[i] - NEARER) if limit[i] > -SELF_DEPTH else -np.inf
    end = stopping_time(scale, numbers[REACTION], brake_of(twist, numbers))
    for k in range(SAMPLES):
        clearances(points, count, normals, offsets, edges, twist, end if k == 0 else end * uniform(rng, 0.0, 1.0), now)
        touching = 0
        for i in range(count):
            is_near[i] |= now[i] < limit[i] - TOUCH
            touching += k == 0 and abs(now[i] - limit[i]) < TOUCH
        if k == 0:
            is_careful = scale >= 1.0 or touching > 0
    return is_near.sum() < numbers[MIN_POINTS], is_careful


@jit
def write_view(view, rng, case, other, numbers):
    """Write the case as seen at a smaller share (0), from the other side (1), in a turned frame (2). A case is (corners, points,
    twist). Returns (share, braking time)."""
    corners, points, twist = case
    seen_corners, seen_points, seen_twist = other
    if view == 0:
        seen_corners[:], seen_points[:] = corners, points
        seen_twist[:] = numbers[SHARE] * twist
        return numbers[SHARE], brake_of(seen_twist, numbers)
    if view == 1:
        seen_corners[:, 0], seen_corners[:, 1] = corners[:, 0], -corners[:, 1]
        seen_points[:, 0], seen_points[:, 1] = points[:, 0], -points[:, 1]
        seen_twist[0], seen_twist[1], seen_twist[2] = twist[0], -twist[1], -twist[2]
        return 1.0, brake_of(seen_twist, numbers)
    angle = uniform(rng, -math.pi, math.pi)
    c, s = math.cos(angle), math.sin(angle)
    seen_corners[:, 0], seen_corners[:, 1] = (
        c * corners[:, 0] - s * corners[:, 1],
        s * corners[:, 0] + c * corners[:, 1],
    )
    seen_points[:, 0], seen_points[:, 1] = c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]
    seen_twist[0], seen_twist[1] = c * twist[0] - s * twist[1], s * twist[0] + c * twist[1]
    seen_twist[2] = twist[2]
    return 1.0, brake_of(twist, numbers)  # the limits of braking belong to the axes and do not turn


@jit
def failed_property(rng, corners, edges, points, count, twist, numbers, grazes):
    """Return the number of the first property that a case violates, -1 for none."""
    braking = brake_of(twist, numbers)
    scale = scale_of(corners, edges, points, count, twist, braking, numbers, 0.0)
    if not 0.0 <= scale <= 1.0:
        return 1
    is_safe, is_careful = is_stop_safe(scale, corners, edges, points, count, twist, numbers, rng)
    if not is_safe:
        return 2
    if not is_careful:
        return 3
    other = (np.empty_like(corners), np.empty_like(points), np.empty(3))
    for view in range(3):
        share, brake = write_view(view, rng, (corners, points, twist), other, numbers)
        if view == 1:
            other[0][:edges] = other[0][:edges][::-1].copy()  # counter-clockwise again
        value = share * scale_of(other[0], edges, other[1], count, other[2], brake, numbers, 0.0)
        if abs(value - min(share, scale)) > SAME:
            grazes[0] += 1
            if not is_graze(value, share, corners, edges, points, count, twist, numbers):
                return 0 if view == 0 else 3 + view
    points[count, 0], points[count, 1] = uniform(rng, -1.0, 1.0), uniform(rng, -1.0, 1.0)
    if scale_of(corners, edges, points, count + 1, twist, braking, numbers, 0.0) > scale:
        return 6
    return -1


@jit
def search(chances, violations, grazes, corners, points, twist, numbers):
    """Check one case per row of `chances`, float64 (N, CHANCES), uniform in 0..1, until one is bad. Counts into int64 `violations` (7,)
    and `grazes` (1,); the arrays hold the case checked last. Returns (its row, edges, points, property), property -1 for none."""
    edges, count, failed = 0, 0, -1
    used = np.zeros(1, np.int64)
    for row in range(chances.shape[0]):
        used[0] = 0
        rng = (chances[row], used)
        edges, count = draw_case(rng, corners, points, twist, numbers)
        failed = failed_property(rng, corners, edges, points, count, twist, numbers, grazes)
        if failed >= 0:
            violations[failed] += 1
            return row, edges, count, failed
    return chances.shape[0], edges, count, failed


def warm_up() -> None:
    """Compile every kernel of this module."""
    corners, points = np.empty((EDGES_MOST, 2)), np.empty((POINTS_MOST, 2))
    counts, grazes = np.zeros(len(PROPERTIES), np.int64), np.zeros(1, np.int64)
    chances = np.random.default_rng(0).random((2, CHANCES))
    search(chances, counts, grazes, corners, points, np.empty(3), np.empty(7))
