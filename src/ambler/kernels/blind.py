"""What the velocity gate remembers of places that its scanners do not see: rays, and columns of floor (`safety/blind_memory.py` says why)."""

import math

import numpy as np

from ambler.kernels.jit import jit

NONE = -(2**62)
ON_CIRCLE = 1e-6  # square metres


@jit
def rays_to(sensor_from_base, points, ranges, azimuth, elevation):
    """Write range (m), azimuth and elevation (rad), each (N,), of points (N, 3) seen from a sensor whose pose is `sensor_from_base` (3, 4)."""
    m = sensor_from_base
    for k in range(len(points)):
        px, py, pz = points[k]
        x = m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3]
        y = m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3]
        z = m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3]
        flat = math.hypot(x, y)
        ranges[k], azimuth[k], elevation[k] = math.hypot(flat, z), math.atan2(y, x), math.atan2(z, flat)


@jit
def are_inside(ranges, azimuth, elevation, nearest, sector, heights, out):
    """Write into `out` bool (N,) which rays are at least `nearest` long, within a sector of azimuths (low, high), which may
    go round, and one of elevations (low, high)."""
    middle, half = 0.5 * (sector[0] + sector[1]), 0.5 * (sector[1] - sector[0])
    for k in range(len(ranges)):
        turned = abs((azimuth[k] - middle + math.pi) % (2.0 * math.pi) - math.pi)
        out[k] = ranges[k] >= nearest and turned <= half and heights[0] <= elevation[k] <= heights[1]


@jit
def look_through(kept, seen, step, behind, beside, out):
    """Write into `out` bool (N,) of each kept ray whether there are returns in its direction and in those within `beside` metres of it, at least one
    on either side, and all of them lie more than `behind` metres farther away: one that passes a thin thing's edge says nothing of the thing. `kept` and `seen`
    are (range, azimuth, elevation), each (N,), (M,); directions are bins of `step` radians."""
    rows, columns = int(round(2.0 * math.pi / step)), int(0.5 * math.pi / step) + 2
    nearest = np.full((rows, 2 * columns), np.inf)
    for k in range(len(seen[0])):
        if not seen[0][k] < math.inf:
            continue
        row, column = math.floor(seen[1][k] / step + 0.5) % rows, columns + math.floor(seen[2][k] / step + 0.5)
        nearest[row, column] = min(nearest[row, column], seen[0][k])
    for k in range(len(kept[0])):
        out[k] = False
        if not kept[0][k] < math.inf:
            continue
        row, column = math.floor(kept[1][k] / step + 0.5), columns + math.floor(kept[2][k] / step + 0.5)
        around = max(1, math.ceil(math.atan2(beside, kept[0][k] * math.cos(kept[2][k])) / step))
        out[k] = True
        for there in range(row - around, row + around + 1):
            out[k] &= math.inf > nearest[there % rows, column] > kept[0][k] + behind


@jit
def _column(x, y, side):
    """The column of a place, as one number."""
    return np.int64(math.floor(x / side)) * np.int64(1_000_003) + np.int64(math.floor(y / side))


@jit
def _table(count):
    """An empty hash table of columns, never more than half full."""
    size = 16
    while size < 2 * count:
        size *= 2
    return np.full(size, NONE, np.int64)


@jit
def _find(table, key):
    """Where a column stands in the table, or belongs."""
    mask = len(table) - 1
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    at = np.int64((h ^ (h >> np.uint64(29))) & np.uint64(mask))
    while table[at] != NONE and table[at] != key:
        at = (at + 1) & mask
    return at


@jit
def are_in_columns(places, points, is_wanted, side, out):
    """Write into `out` bool (N,) which places (N, 3) share a column of floor with one of the wanted points (M, 3)."""
    if len(places) == 0:
        return
    table = _table(len(places))
    is_met = np.zeros(len(table), np.bool_)
    for k in range(len(places)):
        key = _column(places[k, 0], places[k, 1], side)
        table[_find(table, key)] = key
    for k in range(len(points)):
        if is_wanted[k]:
            at = _find(table, _column(points[k, 0], points[k, 1], side))
            is_met[at] = table[at] != NONE
    for k in range(len(places)):
        out[k] = is_met[_find(table, _column(places[k, 0], places[k, 1], side))]


@jit
def column_means(points, ranges, is_wanted, side, most, least, out):
    """Write into `out` (N, 4) the mean of the wanted points (N, 3) of every column that holds at least `most` of them, none nearer
    to the scanner, by its `ranges` (N,), than `least`, and how many they are; return the number of columns."""
    wanted = 0
    for k in range(len(points)):
        wanted += is_wanted[k]
    table = _table(wanted)
    number = np.empty(len(table), np.int64)
    sums, counts, nearest, met = np.zeros((wanted, 3)), np.zeros(wanted, np.int64), np.full(wanted, np.inf), 0
    for k in range(len(points)):
        if not is_wanted[k]:
            continue
        key = _column(points[k, 0], points[k, 1], side)
        at = _find(table, key)
        if table[at] == NONE:
            table[at], number[at] = key, met
            met += 1
        column = number[at]
        counts[column] += 1
        nearest[column] = min(nearest[column], ranges[k])
        for axis in range(3):
            sums[column, axis] += points[k, axis]
    count = 0
    for column in range(met):
        if counts[column] >= most and nearest[column] >= least:
            for axis in range(3):
                out[count, axis] = sums[column, axis] / counts[column]
            out[count, 3] = counts[column]
            count += 1
    return count


@jit
def first_of_columns(points, side, out):
    """Write into `out` int64 (N,) which of the points (N, 3) are the first of their column; return how many."""
    table, count = _table(len(points)), 0
    for k in range(len(points)):
        key = _column(points[k, 0], points[k, 1], side)
        at = _find(table, key)
        if table[at] == NONE:
            table[at], out[count] = key, k
            count += 1
    return count


@jit
def bridge(points, count, most, step, out):
    """Write level points between neighbours among points (N, 3) that stand more than `step` and at most `most` metres apart, so that none of them are farther
    apart than `step`; return how many. Neighbours have no other point within the circle over both (Gabriel), and one of them is among the first `count`."""
    near, bridges = np.empty(len(points), np.int64), 0
    for i in range(count):
        found = 0
        for k in range(len(points)):
            dx, dy = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
            if k != i and dx * dx + dy * dy <= most * most:
                near[found] = k
                found += 1
        for j in near[:found]:
            dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            apart = math.hypot(dx, dy)
            if apart <= step or i > j or _is_between(points, near[:found], i, j):
                continue
            parts = math.ceil(apart / step)
            for part in range(1, parts):
                for axis in range(3):
                    out[bridges, axis] = points[i, axis] + (points[j, axis] - points[i, axis]) * part / parts
                bridges += 1
    return bridges


@jit
def _is_between(points, near, i, j):
    """Whether one of the `near` points lies within or on the circle over two others."""
    for k in near:
        ax, ay = points[i, 0] - points[k, 0], points[i, 1] - points[k, 1]
        if k != j and ax * (points[j, 0] - points[k, 0]) + ay * (points[j, 1] - points[k, 1]) < ON_CIRCLE:
            return True
    return False


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    points, out, one = np.ones((3, 3)), np.empty(3, np.bool_), np.ones(3)
    rays = (one, one, one)
    rays_to(np.ascontiguousarray(np.eye(4)[:3]), points, *rays)
    are_inside(*rays, 0.1, (-3.0, 3.0), (-1.0, 1.0), out)
    look_through(rays, rays, 0.03, 0.1, 0.04, out)
    are_in_columns(points, points, out, 0.04, out)
    column_means(points, one, out, 0.04, 3, 0.1, np.empty((3, 4)))
    first_of_columns(points, 0.04, np.empty(3, np.int64))
    bridge(points, 1, 0.1, 0.05, np.empty((9, 3)))
