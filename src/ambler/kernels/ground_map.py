"""Merging what a terrain analysis says of a window into a map of ground: evidence for and against each cell, and the height of its ground.

Evidence is int8: `UNKNOWN`, `ASSUMED`, or a count, positive for ground. A window has kinds uint8 [iy, ix] of cells, 0 where nothing is known,
and tops float32 [2 iy, 2 ix]: how high the voxels reach that stand on them, -inf where none does.
"""

import math

import numpy as np

from ambler.kernels.jit import jit

UNKNOWN, ASSUMED = -128, 100
GROUND = 1  # the kind of a window's cell that can be crossed
BLIND = 255  # the kind of a window's cell that the sensor cannot see from where it is
DROP = 3  # the kind of a window's cell at which ground ends above something lower
GROUND_MOST, OBSTACLE_MOST = 4, -6
STOOD = 2  # what `firm` says where the robot has stood; 1 of ground beside it
BESIDE = 3  # cells to either side that say whether one is alone
UNDER = 0.05  # metres by which what a ray passes below reaches higher than it
HIT = 3  # looks at ground that one look at an obstacle outweighs
FOOT, HEAD = (
    0.02,
    0.4,
)  # metres of what is low that must be in sight, down to the ground, and of what is high, down from its top, for a look to tell that it is gone


@jit
def find_blind(kinds, tops, origin, sensor, sensor_from_odom, sines, ground, reach):
    """Mark unknown cells of a window that the sensor cannot see and nothing hides as `BLIND`.

    `origin` (x, y, side of a cell), `sensor` its place (3,), `sensor_from_odom` (3, 3), `sines` of its lowest and highest elevation, `ground`
    (x, y, z, rise along x, rise along y) the plane on which the robot stands, `reach` (m) how far from it.
    """
    ny, nx = kinds.shape
    x0, y0, size = origin
    low, high = sines
    for iy in range(ny):
        for ix in range(nx):
            if kinds[iy, ix] != 0:
                continue
            x, y = x0 + (ix + 0.5) * size, y0 + (iy + 0.5) * size
            bx, by = x - ground[0], y - ground[1]
            far = math.hypot(bx, by)
            if far > reach:
                continue
            z = ground[2] + bx * ground[3] + by * ground[4]
            dx, dy, dz = x - sensor[0], y - sensor[1], z - sensor[2]
            length = math.sqrt(dx * dx + dy * dy + dz * dz)
            r = sensor_from_odom
            sine = (r[2, 0] * dx + r[2, 1] * dy + r[2, 2] * dz) / max(length, 1e-6)
            if low <= sine <= high:
                continue
            steps = int(far / size) + 1
            is_open = True
            for k in range(steps):
                t = (k + 0.5) / steps
                jy = int((ground[1] + t * by - y0) / size)
                jx = int((ground[0] + t * bx - x0) / size)
                if jy < 0 or jx < 0 or jy >= ny or jx >= nx:
                    continue
                if (kinds[jy, jx] > GROUND and kinds[jy, jx] != BLIND) or _is_marked(tops, jy, jx):
                    is_open = False
                    break
            if is_open:
                kinds[iy, ix] = BLIND


@jit
def keep_joined(kinds, tops, heights, origin, base, step, rise, queue):
    """Forget the ground of a window that is not joined to the robot at `base` (x, y, z) by ground: the roofs of cars, on which a terrain may
    climb up over what hides the gap below them.

    Two cells are joined when they lie at most two apart, with nothing in the way between them, and differ by at most `step` + `rise` for each metre. `queue` int32 (N,) has room for every cell.
    """
    ny, nx = kinds.shape
    joined = np.zeros((ny, nx), np.uint8)
    ends = 0
    by, bx = (base[1] - origin[1]) / origin[2], (base[0] - origin[0]) / origin[2]
    reach = int(1.5 / origin[2])
    for iy in range(max(0, int(by) - reach), min(ny, int(by) + reach + 1)):
        for ix in range(max(0, int(bx) - reach), min(nx, int(bx) + reach + 1)):
            far = math.hypot(iy + 0.5 - by, ix + 0.5 - bx) * origin[2]
            if kinds[iy, ix] in (GROUND, BLIND) and abs(heights[iy, ix] - base[2]) <= step + rise * far:
                joined[iy, ix] = 1
                queue[ends] = iy * nx + ix
                ends += 1
    at = 0
    while at < ends:
        iy, ix = queue[at] // nx, queue[at] % nx
        at += 1
        for jy in range(max(0, iy - 2), min(ny, iy + 3)):
            for jx in range(max(0, ix - 2), min(nx, ix + 3)):
                if joined[jy, jx] or kinds[jy, jx] not in (GROUND, BLIND):
                    continue
                my, mx = iy + int((jy - iy) / 2), ix + int((jx - ix) / 2)
                if kinds[my, mx] != 0 and (kinds[my, mx] not in (GROUND, BLIND) or _is_marked(tops, my, mx)):
                    continue  # a parapet between two decks joins nothing
                far = math.hypot(jy - iy, jx - ix) * origin[2]
                if abs(heights[jy, jx] - heights[iy, ix]) <= step + rise * far:
                    joined[jy, jx] = 1
                    queue[ends] = jy * nx + jx
                    ends += 1
    for iy in range(ny):
        for ix in range(nx):
            if kinds[iy, ix] in (GROUND, BLIND) and not joined[iy, ix]:
                kinds[iy, ix] = 0


@jit
def _is_marked(tops, iy, ix):
    """Whether a voxel stands on a cell."""
    y, x = 2 * iy, 2 * ix
    return max(tops[y, x], tops[y, x + 1], tops[y + 1, x], tops[y + 1, x + 1]) > -np.inf


@jit
def merge(
    kinds,
    tops,
    heights,
    origin,
    odom_from_map,
    rise,
    base,
    sensor,
    sensor_from_odom,
    lowest,
    limits,
    spec,
    box,
    evidence,
    map_heights,
    firm,
    reaches,
):
    """Take a window into the map's cells of a box (y0, y1, x0, x1); returns how many of them changed what they mean.

    `heights` float32 [iy, ix] in odom; `odom_from_map` (cos, sin, x, y) and `rise` (m) added to get heights in the map; `base` (x, y) in the
    map, `sensor` (3,) in odom: what is assumed farther than `limits[0]` from it is unknown again, and looks at ground from farther than `limits[3]` do not clear what was in the way. What stands or lies more than `limits[1]` metres above or below what is known there is of
    another level, and left out, unless nearly all that is known around it lies where it lies (single cells of a deck that were drawn into the level below it); as is a drop farther than `limits[2]`: it may be a ramp that falls behind its edge. Where `firm` uint8 [iy, ix] says
    that the robot has stood, only what stands on the ground is in the way. Ground that the sensor sees under something, as below a car, says nothing of what stands on it; nor does ground that is told where the sensor (`sensor_from_odom` (3, 3), `lowest` the sine of its lowest
    elevation) would not see what stood there, which reached `reaches` float32 [iy, ix] (m, -inf: nothing did): a kerb, of which it sees the edge only as it comes near. `spec` (x, y, resolution) of the map's first corner.
    """
    reach, apart, drop_most, clear_most = limits
    c, s, tx, ty = odom_from_map
    ny, nx = kinds.shape
    y0, y1, x0, x1 = box
    under = np.zeros((ny, nx), np.uint8)  # of cells that were asked about: 1 not under anything, 2 under something
    changed = 0
    for iy in range(y0, y1):
        my = spec[1] + (iy + 0.5) * spec[2]
        for ix in range(x0, x1):
            mx = spec[0] + (ix + 0.5) * spec[2]
            was = evidence[iy, ix]
            away = math.hypot(mx - base[0], my - base[1])
            if was == ASSUMED and away > reach:
                was = UNKNOWN
            u = (c * mx - s * my + tx - origin[0]) / origin[2]
            v = (s * mx + c * my + ty - origin[1]) / origin[2]
            now = was
            if 0.0 <= u < nx and 0.0 <= v < ny:
                jx, jy = int(u), int(v)
                kind = kinds[jy, jx]
                known = map_heights[iy, ix]
                is_marked = tops[int(2.0 * v), int(2.0 * u)] > -np.inf
                height = heights[jy, jx] + rise
                is_other = was != UNKNOWN and abs(height - known) > apart
                if is_other and kind == GROUND and _is_alone(evidence, map_heights, iy, ix, height, apart):
                    was, is_other, firm[iy, ix] = UNKNOWN, False, 0
                if kind not in (0, GROUND, BLIND) and not is_marked:
                    is_far = kind == DROP and away > drop_most
                    is_other = is_other or is_far or firm[iy, ix] != 0
                if kind != 0 and not is_other:
                    is_open = kind == GROUND and not is_marked
                    if is_open and UNKNOWN < was <= 0 and away > clear_most:
                        continue
                    if is_open and was <= 0 and under[jy, jx] == 0:
                        under[jy, jx] = 2 if _is_under(tops, origin, sensor, heights[jy, jx], jx, jy) else 1
                    tells = not is_open or was > 0 or under[jy, jx] == 1
                    if tells and is_open and UNKNOWN < was <= 0 and reaches[iy, ix] > -np.inf:
                        foot = _lowest_around(evidence, map_heights, iy, ix) + FOOT
                        z = max(foot, reaches[iy, ix] - HEAD) - rise
                        place = (origin[0] + u * origin[2], origin[1] + v * origin[2], z)
                        tells = _is_above(place, sensor, sensor_from_odom, lowest)
                    if tells:
                        now = _weighed(was, kind, is_open)
                        if is_marked:
                            reaches[iy, ix] = max(reaches[iy, ix], tops[int(2.0 * v), int(2.0 * u)] + rise)
                        elif now > 0:
                            reaches[iy, ix] = -np.inf
                        if kind == GROUND or math.isnan(known) or (kind == BLIND and was == ASSUMED):
                            map_heights[iy, ix] = height
            if _meaning(now) != _meaning(evidence[iy, ix]):
                changed += 1
            evidence[iy, ix] = now
    return changed


@jit
def _lowest_around(evidence, map_heights, iy, ix):
    """The lowest known height within two cells of one, which has one."""
    least = map_heights[iy, ix]
    for jy in range(max(0, iy - 2), min(evidence.shape[0], iy + 3)):
        for jx in range(max(0, ix - 2), min(evidence.shape[1], ix + 3)):
            if evidence[jy, jx] != UNKNOWN and map_heights[jy, jx] < least:
                least = map_heights[jy, jx]
    return least


@jit
def _is_above(place, sensor, sensor_from_odom, lowest):
    """Whether a place (x, y, z) lies above the lowest elevation, given by its sine, that a sensor sees."""
    dx, dy, dz = place[0] - sensor[0], place[1] - sensor[1], place[2] - sensor[2]
    r = sensor_from_odom
    return r[2, 0] * dx + r[2, 1] * dy + r[2, 2] * dz >= lowest * math.sqrt(dx * dx + dy * dy + dz * dz)


@jit
def _is_under(tops, origin, sensor, height, ix, iy):
    """Whether the line from a sensor to the middle of a cell of a window, at a height, passes below what stands before it."""
    u, v = ix + 0.5, iy + 0.5
    su, sv = (sensor[0] - origin[0]) / origin[2], (sensor[1] - origin[1]) / origin[2]
    steps = int(2.0 * math.hypot(u - su, v - sv)) + 1
    for k in range(steps - 1, -1, -1):  # what hides a place stands nearer to it than to the sensor, as a rule
        t = k / steps
        jx, jy = math.floor(2.0 * (su + t * (u - su))), math.floor(2.0 * (sv + t * (v - sv)))
        is_inside = 0 <= jx < tops.shape[1] and 0 <= jy < tops.shape[0]
        if is_inside and tops[jy, jx] > sensor[2] + t * (height - sensor[2]) + UNDER:
            return True
    return False


@jit
def _is_alone(evidence, map_heights, iy, ix, height, apart):
    """Whether a cell contradicts a height with which at least three quarters of the cells around it agree."""
    same, other = 0, 0
    for jy in range(max(0, iy - BESIDE), min(evidence.shape[0], iy + BESIDE + 1)):
        for jx in range(max(0, ix - BESIDE), min(evidence.shape[1], ix + BESIDE + 1)):
            if evidence[jy, jx] == UNKNOWN or evidence[jy, jx] == ASSUMED or math.isnan(map_heights[jy, jx]):
                continue
            if abs(map_heights[jy, jx] - height) <= apart:
                same += 1
            else:
                other += 1
    return same >= 4 and same >= 3 * other


@jit
def stand(plane, heading, limits, spec, box, evidence, map_heights, firm):
    """Make the ground firm on which the robot stands, and what beside it is seen to lie in the plane of its wheels: it is the better instrument.

    `plane` (x, y, z, rise along x, rise along y) and `heading` (cos, sin) of the base in the map; `limits`: metres around the base that it stands on, those to
    its sides within which seen ground counts, by how much that may lie off the plane, and how much more for each metre; ground farther than the last one off is of
    another level.
    """
    own, reach, off, slope, apart = limits
    y0, y1, x0, x1 = box
    for iy in range(y0, y1):
        dy = spec[1] + (iy + 0.5) * spec[2] - plane[1]
        for ix in range(x0, x1):
            dx = spec[0] + (ix + 0.5) * spec[2] - plane[0]
            ahead, beside = heading[0] * dx + heading[1] * dy, heading[0] * dy - heading[1] * dx
            if abs(ahead) > own or abs(beside) > reach:
                continue
            height = plane[2] + dx * plane[3] + dy * plane[4]
            if abs(map_heights[iy, ix] - height) > apart:
                continue
            is_in_plane = abs(map_heights[iy, ix] - height) <= off + slope * abs(beside)
            if math.hypot(dx, dy) <= own:
                firm[iy, ix] = STOOD
                evidence[iy, ix] = GROUND_MOST
                if not is_in_plane:
                    map_heights[iy, ix] = height
            elif 0 < evidence[iy, ix] != ASSUMED and is_in_plane:
                firm[iy, ix] = max(firm[iy, ix], 1)


@jit
def _weighed(was, kind, is_open):
    """The evidence of a cell after one more look."""
    if kind == BLIND:
        return ASSUMED if was == UNKNOWN else was
    count = 0 if was in (UNKNOWN, ASSUMED) else was
    if is_open:
        return min(count + 1, GROUND_MOST)
    return max(count - HIT, OBSTACLE_MOST)


@jit
def _meaning(evidence):
    """-1 unknown, 0 ground, 1 in the way, 2 assumed to be ground."""
    if evidence == UNKNOWN:
        return -1
    if evidence == ASSUMED:
        return 2
    return 0 if evidence > 0 else 1


@jit
def agreement(kinds, heights, origin, odom_from_map, rise, base, limits, spec, box, evidence, map_heights, tolerance):
    """Return how many cells of the map's box agree with a window's ground, seen or too near to be seen, within `tolerance` (m) and lie within `limits[0]` metres of `base` (x, y), how many
    agree at all, how many within `limits[1]` contradict it by more than twice that, and how high the window's and the map's ground is there on average."""
    c, s, tx, ty = odom_from_map
    ny, nx = kinds.shape
    y0, y1, x0, x1 = box
    close, same, other, total, known = 0, 0, 0, 0.0, 0.0
    for iy in range(y0, y1):
        my = spec[1] + (iy + 0.5) * spec[2]
        for ix in range(x0, x1):
            if evidence[iy, ix] <= 0 or math.isnan(map_heights[iy, ix]):
                continue
            mx = spec[0] + (ix + 0.5) * spec[2]
            u = (c * mx - s * my + tx - origin[0]) / origin[2]
            v = (s * mx + c * my + ty - origin[1]) / origin[2]
            if not (0.0 <= u < nx and 0.0 <= v < ny) or kinds[int(v), int(u)] not in (GROUND, BLIND):
                continue
            height = heights[int(v), int(u)] + rise
            off, away = abs(height - map_heights[iy, ix]), math.hypot(mx - base[0], my - base[1])
            if off <= tolerance:
                same += 1
                close += away <= limits[0]
            elif off > 2.0 * tolerance and away <= limits[1]:
                other += 1
                total += height
                known += map_heights[iy, ix]
    return close, same, other, total / max(other, 1), known / max(other, 1)


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    kinds, tops = np.zeros((4, 4), np.uint8), np.zeros((8, 8), np.float32)
    heights, origin = np.zeros((4, 4), np.float32), np.array([0.0, 0.0, 0.2])
    find_blind(kinds, tops, origin, np.zeros(3), np.eye(3), np.zeros(2), np.zeros(5), 1.0)
    keep_joined(kinds, tops, heights, origin, np.zeros(3), 0.1, 0.4, np.empty(16, np.int32))
    evidence, map_heights = np.full((8, 8), UNKNOWN, np.int8), np.full((8, 8), np.nan, np.float32)
    turn, spec, box = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.1]), np.array([0, 8, 0, 8])
    firm = np.zeros((8, 8), np.uint8)
    merge(
        kinds,
        tops,
        heights,
        origin,
        turn,
        0.0,
        np.zeros(2),
        np.zeros(3),
        np.eye(3),
        0.0,
        np.ones(4),
        spec,
        box,
        evidence,
        map_heights,
        firm,
        np.full((8, 8), -np.inf, np.float32),
    )
    stand(np.zeros(5), np.ones(2), np.ones(5), spec, box, evidence, map_heights, firm)
    agreement(
        kinds, heights, origin, turn, 0.0, np.zeros(2), np.array([1.5, 3.0]), spec, box, evidence, map_heights, 0.5
    )
