"""Paths of straight legs over weighted cells: the integral of the weights along them, and how they are made to cost least.

A path off the grid's eight directions is found from one on them: legs are replaced by chords that cost no more (`shortcut`); then the
corners, set `spacing` cells apart, move across the path while that lowers the integral (`relax`: coordinate descent with a step of its
own at each corner). Nothing here comes nearer to an obstacle than what it replaces: no leg may touch a cell that is blocked, or dearer
than the dearest of the legs before. Points are float64 (N, 2) of (y, x) in cells; cell i covers [i, i + 1).
"""

import numpy as np

from ambler.kernels.jit import jit_ieee as jit

ANY_WEIGHT = 65535
FAR = 1e30
CORNER = 1e-9  # of a leg: borders that are crossed so close together are crossed in a corner
at = np.uintp  # an unsigned index spares the check for a negative one
SLACK = 1e-9  # of a cost, which a sum of floats may be wrong by
LEAST_GAIN = 1e-6  # cells times weight that a move must save


@jit
def segment_cost(weights, y0, x0, y1, x1, most):
    """Return the integral of the weights along a straight segment, and the dearest weight on it; (-1, 0) when it touches a cell that is
    blocked or dearer than `most`. Where it passes a corner exactly, neither of the two neighbours may be so."""
    iy, ix, end_y, end_x = int(y0), int(x0), int(y1), int(x1)
    dy, dx = y1 - y0, x1 - x0
    length = np.sqrt(dy * dy + dx * dx)
    weight = np.int64(weights[at(iy), at(ix)])
    if weight == 0 or weight > most:
        return -1.0, 0
    step_y, step_x = (1 if dy > 0 else -1), (1 if dx > 0 else -1)
    per_y = abs(1.0 / dy) if dy != 0.0 else FAR
    per_x = abs(1.0 / dx) if dx != 0.0 else FAR
    next_y = ((iy + 1 - y0) if dy > 0 else (y0 - iy)) * per_y if dy != 0.0 else FAR
    next_x = ((ix + 1 - x0) if dx > 0 else (x0 - ix)) * per_x if dx != 0.0 else FAR
    t, total, dearest = 0.0, 0.0, weight
    for _ in range(abs(end_y - iy) + abs(end_x - ix) + 2):
        until = min(next_y, next_x)
        if until >= 1.0 or (iy == end_y and ix == end_x):
            break
        total += (until - t) * weight
        t = until
        if abs(next_y - next_x) < CORNER:
            first, second = weights[at(iy + step_y), at(ix)], weights[at(iy), at(ix + step_x)]
            if first == 0 or second == 0 or first > most or second > most:
                return -1.0, 0
            iy += step_y
            ix += step_x
            next_y += per_y
            next_x += per_x
        elif next_y < next_x:
            iy += step_y
            next_y += per_y
        else:
            ix += step_x
            next_x += per_x
        weight = np.int64(weights[at(iy), at(ix)])
        if weight == 0 or weight > most:
            return -1.0, 0
        dearest = max(dearest, weight)
    return (total + (1.0 - t) * weight) * length, dearest


@jit
def leg_costs(weights, points, costs, dearest):
    """Write the integral of the weights along every leg, float64 (N - 1,), and its dearest weight, int64."""
    for i in range(len(points) - 1):
        costs[i], dearest[i] = segment_cost(
            weights, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1], ANY_WEIGHT
        )


@jit
def path_cost(weights, points):
    """Return the integral of the weights along the legs between the points; inf when one touches a blocked cell."""
    total = 0.0
    for i in range(len(points) - 1):
        cost, _ = segment_cost(weights, points[i, 0], points[i, 1], points[i + 1, 0], points[i + 1, 1], ANY_WEIGHT)
        total += cost if cost >= 0.0 else np.inf
    return total


@jit
def shortcut(weights, points, costs, dearest, window, keep):
    """Mark in `keep` bool (N,) the corners of a shorter way through the points, whose legs are as `leg_costs` tells.

    A run of points (at most `window`) is replaced by its chord when the chord costs no more than the run and touches no cell
    that is blocked or dearer than the dearest of the run.
    """
    n = len(points)
    keep[:] = False
    keep[0] = True
    i = 0
    while i < n - 1:
        reach, run, most = i + 1, costs[i], dearest[i]
        j, due = i + 1, i + 2
        while j + 1 < n and j - i < window:
            run += costs[j]
            most = max(most, dearest[j])
            j += 1
            if j < due and j + 1 < n:
                continue
            chord, _ = segment_cost(weights, points[i, 0], points[i, 1], points[j, 0], points[j, 1], most)
            if chord < 0.0 or chord > run * (1.0 + SLACK):
                break
            reach = j
            due = j + 1 + (j - i) // 8
        i = reach
        keep[i] = True


@jit
def divided(points, spacing):
    """Return the points with every leg cut into equal pieces of at most `spacing` cells."""
    pieces = np.empty(len(points), np.int64)
    n = 1
    for i in range(len(points) - 1):
        leg = np.hypot(points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1])
        pieces[i] = max(1, int(np.ceil(leg / spacing)))
        n += pieces[i]
    out = np.empty((n, 2))
    n = 0
    for i in range(len(points) - 1):
        for k in range(pieces[i]):
            share = k / pieces[i]
            out[n, 0] = points[i, 0] + (points[i + 1, 0] - points[i, 0]) * share
            out[n, 1] = points[i, 1] + (points[i + 1, 1] - points[i, 1]) * share
            n += 1
    out[n] = points[len(points) - 1]
    return out


@jit
def _is_straight_and_cheap(points, i, least, costs):
    """Whether a corner lies on a straight line over cells of the least weight: no move can make that cheaper."""
    chord = np.hypot(points[i + 1, 0] - points[i - 1, 0], points[i + 1, 1] - points[i - 1, 1])
    return costs[i - 1] + costs[i] <= least * chord * (1.0 + SLACK)


@jit
def relax(weights, points, costs, dearest, least, first_step, last_step, sweeps):
    """Move the corners across the path while that lowers the integral; `points`, `costs` and `dearest` are changed in place.

    A corner that gains at neither side halves its step, down to `last_step` (cells); one that moves wakes its neighbours.
    """
    n = len(points)
    step = np.full(n, first_step)
    side = np.ones(n)
    for i in range(1, n - 1):
        if _is_straight_and_cheap(points, i, least, costs):
            step[i] = 0.0
    for _ in range(sweeps):
        is_done = True
        for i in range(1, n - 1):
            if step[i] < last_step:
                continue
            along_y, along_x = points[i + 1, 0] - points[i - 1, 0], points[i + 1, 1] - points[i - 1, 1]
            length = np.hypot(along_y, along_x)
            if length == 0.0:
                step[i] = 0.0
                continue
            is_done = False
            if not _move(weights, points, costs, dearest, i, side[i] * step[i] / length, along_y, along_x):
                side[i] = -side[i]
                if not _move(weights, points, costs, dearest, i, side[i] * step[i] / length, along_y, along_x):
                    side[i] = -side[i]
                    step[i] *= 0.5
                    continue
            step[i - 1], step[i + 1] = max(step[i - 1], step[i]), max(step[i + 1], step[i])
        if is_done:
            break


@jit
def _move(weights, points, costs, dearest, i, by, along_y, along_x):
    """Move one corner by `by` times the vector across the path, if that is allowed and cheaper; returns whether it was."""
    y, x = points[i, 0] - by * along_x, points[i, 1] + by * along_y
    before, most = costs[i - 1] + costs[i] - LEAST_GAIN, max(dearest[i - 1], dearest[i])
    first, first_dearest = segment_cost(weights, points[i - 1, 0], points[i - 1, 1], y, x, most)
    if first < 0.0 or first >= before:
        return False
    second, second_dearest = segment_cost(weights, y, x, points[i + 1, 0], points[i + 1, 1], most)
    if second < 0.0 or first + second >= before:
        return False
    points[i, 0], points[i, 1] = y, x
    costs[i - 1], dearest[i - 1] = first, first_dearest
    costs[i], dearest[i] = second, second_dearest
    return True


@jit
def _thinned(weights, points, stride):
    """Return every `stride`-th point; all of a run whose chord touches a cell that is blocked or dearer than the dearest of the run."""
    n = len(points)
    keep = np.zeros(n, np.bool_)
    keep[0] = keep[n - 1] = True
    for i in range(0, n - 1, stride):
        j = min(i + stride, n - 1)
        most = np.int64(0)
        for k in range(i, j + 1):
            most = max(most, np.int64(weights[int(points[k, 0]), int(points[k, 1])]))
        chord, _ = segment_cost(weights, points[i, 0], points[i, 1], points[j, 0], points[j, 1], most)
        if chord >= 0.0:
            keep[j] = True
        else:
            keep[i : j + 1] = True
    return points[keep]


@jit
def any_angle(weights, points, least, spacing, sweeps, window):
    """Return the corners of a path that costs less than the one through the points, one a cell; `weights` uint16, 0: blocked, at least
    `least` elsewhere. Corners are set `spacing` cells apart, then half as far; their moves go down from a quarter of `spacing` to a sixteenth, then to a 64th."""
    step = 0.25 * spacing
    points = _thinned(weights, points, int(spacing))
    for level in range(3):
        if level > 0:
            points = divided(points, spacing)
        costs, dearest = np.empty(len(points) - 1), np.empty(len(points) - 1, np.int64)
        leg_costs(weights, points, costs, dearest)
        if level > 0:
            relax(weights, points, costs, dearest, least, step, 0.25 * step, sweeps)
            step *= 0.25
            spacing *= 0.5
        keep = np.empty(len(points), np.bool_)
        shortcut(weights, points, costs, dearest, window, keep)
        points = points[keep]
    return points


@jit
def to_poses(corners, last_yaw, spacing):
    """Return poses float64 (N, 3) of (x, y, yaw) along the corners (M, 2), at most `spacing` apart, facing forward; the last faces
    `last_yaw`, and so do all when the corners are one place."""
    legs = max(1, len(corners) - 1)
    pieces = np.ones(legs, np.int64)
    total = 0.0
    for i in range(len(corners) - 1):
        leg = np.hypot(corners[i + 1, 0] - corners[i, 0], corners[i + 1, 1] - corners[i, 1])
        pieces[i] = max(1, int(np.ceil(leg / spacing - SLACK)))
        total += leg
    out = np.empty((pieces.sum() + 1, 3))
    n = 0
    for i in range(legs):
        j = min(i + 1, len(corners) - 1)
        along_x, along_y = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1]
        yaw = np.arctan2(along_y, along_x) if total > 0.0 else last_yaw
        for k in range(pieces[i]):
            share = k / pieces[i]
            out[n, 0], out[n, 1], out[n, 2] = corners[i, 0] + along_x * share, corners[i, 1] + along_y * share, yaw
            n += 1
    out[n, :2] = corners[len(corners) - 1]
    out[n, 2] = last_yaw
    return out


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    weights = np.zeros((6, 6), np.uint16)
    weights[1:5, 1:5] = 50
    points = np.array([[1.5, 1.5], [2.5, 2.5], [3.5, 2.5]])
    any_angle(weights, points, 50, 8.0, 12, 50)
    path_cost(weights, points)
    to_poses(points, 0.0, 0.05)
