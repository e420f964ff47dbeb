"""What the velocity gate takes from a cloud: the points in its way, and the means of their patches (`safety/points.py` says why)."""

import math

import numpy as np

from ambler.kernels.jit import jit, read_only


@jit
def near_points(points, times, sweep, reach, sin_lowest, out, out_times, is_lowest):
    """Write the points (N, 3) within `reach` metres of a scanner's axis into `out`, in the level base, with their times (N,); return how many.

    `sweep` (K, 3, 4) holds where the scanner was, at equal times from the first point to the last. `is_lowest` (N,) says
    of each whether the sine of its elevation is at most `sin_lowest`.
    """
    duration = 0.0
    for k in range(len(times)):
        duration = max(duration, times[k])
    per_second = (len(sweep) - 1) / duration if duration > 0.0 else 0.0
    count, most, sine = 0, np.float32(reach * reach), np.float32(sin_lowest)
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        if not x * x + y * y <= most:
            continue
        there = sweep[max(0, min(int(times[k] * per_second + 0.5), len(sweep) - 1))]
        for row in range(3):
            out[count, row] = there[row, 0] * x + there[row, 1] * y + there[row, 2] * z + there[row, 3]
        out_times[count] = times[k]
        is_lowest[count] = z <= sine * math.sqrt(x * x + y * y + z * z)
        count += 1
    return count


@jit
def standing_points(points, times, heights, is_lowest, band, tallest, twist, out):
    """Write those points (N, 3) into `out` whose heights (N,) over the floor lie in `band`, or, of the lowest rays, above it and at most at `tallest`;
    return how many. Each is carried from the base of its own time (s after the stamp) to that of the stamp, to second order in the angle."""
    count = 0
    for k in range(len(points)):
        is_in_way = band[0] <= heights[k] <= band[1] or (is_lowest[k] and band[1] < heights[k] <= tallest)
        if not is_in_way:
            continue
        t, x, y = times[k], points[k, 0], points[k, 1]
        angle = twist[2] * t
        cos = 1.0 - 0.5 * angle * angle
        out[count, 0] = cos * x - angle * y + (twist[0] - 0.5 * angle * twist[1]) * t
        out[count, 1] = angle * x + cos * y + (twist[1] + 0.5 * angle * twist[0]) * t
        out[count, 2] = points[k, 2]
        count += 1
    return count


@jit
def patch_means(points, origin, patch, behind, out):
    """Write the mean of every patch of points (N, 3) into `out` (N, 3), return how many. `patch` is the azimuth (rad) and the distance (m) from
    `origin` that share one mean; lone points with a patch of several at most `behind` patches behind them, or behind their neighbours, are left out."""
    n, far, sectors = len(points), 0, round(2.0 * math.pi / patch[0])
    place = np.empty((n, 2), np.int64)
    for k in range(n):
        dx, dy = points[k, 0] - origin[0], points[k, 1] - origin[1]
        place[k, 0] = math.floor((math.atan2(dy, dx) + math.pi) / patch[0]) % sectors
        place[k, 1] = math.floor(math.hypot(dx, dy) / patch[1])
        far = max(far, place[k, 1])
    counts, first = np.zeros((sectors, far + 1), np.int32), np.empty((sectors, far + 1), np.int32)
    sums, met = np.zeros((n, 3)), 0
    order = np.empty((n, 2), np.int64)
    for k in range(n):
        sector, step = place[k]
        if counts[sector, step] == 0:
            first[sector, step] = met
            order[met] = place[k]
            met += 1
        counts[sector, step] += 1
        for axis in range(3):
            sums[first[sector, step], axis] += points[k, axis]
    count = 0
    for k in range(met):
        sector, step = order[k]
        held = counts[sector, step]
        if held == 1 and _has_surface_behind(counts, sector, step, behind):
            continue
        for axis in range(3):
            out[count, axis] = sums[k, axis] / held
        count += 1
    return count


@jit
def _has_surface_behind(counts, sector, step, behind):
    """Whether a patch of several points lies closely behind, in this or a neighbouring direction; all directions go round."""
    sectors = len(counts)
    for beside in range(-1, 2):
        row = counts[(sector + beside) % sectors]
        for further in range(step + 1, min(step + behind + 1, counts.shape[1])):
            if row[further] > 1:
                return True
    return False


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    out, seconds, is_lowest = np.empty((3, 3)), np.empty(3), np.empty(3, np.bool_)
    for cloud, times in (  # as messages hold them, and as a copy
        (read_only(np.ones((3, 3), np.float32)), read_only(np.zeros(3, np.float32))),
        (np.ones((3, 3), np.float32), np.zeros(3, np.float32)),
    ):
        near_points(cloud, times, np.zeros((2, 3, 4)), 2.0, 0.0, out, seconds, is_lowest)
    standing_points(out, seconds, np.zeros(3), is_lowest, (0.0, 1.0), 2.0, np.zeros(3), np.empty((3, 3)))
    patch_means(np.ones((3, 3)), (0.0, 0.0), (0.01, 0.05), 3, out)
