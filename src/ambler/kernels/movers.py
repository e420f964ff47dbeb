"""Finding what moves in planar scans, and whether a robot's motion would start a contact with it.

What stands now where a ray passed before, and has not stood there or beside it for long, moves. A grid that rolls with the robot
remembers of each cell whether it was seen free and since when it is occupied (Wang et al. 2003 call the idea a stationary and moving
object grid; here the age of a cell decides). Where nothing was seen before, nothing is called moving.
"""

import math

import numpy as np

from ambler.kernels.footprint import footprint_edges
from ambler.kernels.jit import jit

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
STANDING, BESIDE, CAME, MOVING = 0, 1, 2, 3
ALONE = 1  # where nothing ever stood from the first look on, nor beside it
MISSES = 2  # scans in a row that must look through an occupied cell before it counts as free
GONE = 10  # scans in a row after which what stood there is gone; along a wall rays graze for fewer
UNSEEN = 20  # scans without a hit and without a look through after which nobody knows whether what is hit again stood there all the time
LEANING = 0.25  # metres to either side of a touched point that a turning robot brings nearer to who leans there
AWAY = 0.7  # share of a motion that must lead away from who presses on the robot, else it slides along him and pushes with what comes next
SLIDE = 0.1  # metres along its outline by which who touches the robot may do so farther on, where a corner comes, or swings to him
STRAIGHT = 0.05  # rad/s below which a robot does not turn
BEFORE_HIT = 0.25  # metres before a return where a ray stops to prove anything free: walls are hit at a glance


@jit
def _cell(x, y, resolution, size, keys, states):
    """Return the flat index of the cell of a place, forgetting what was there when the grid has rolled on; `size` is a power of two."""
    ix, iy = int(math.floor(x / resolution)), int(math.floor(y / resolution))
    k = (iy & (size - 1)) * size + (ix & (size - 1))
    key = iy * 1000003 + ix
    if keys[k] != key:
        keys[k] = key
        states[k] = UNKNOWN
    return k


@jit
def judge_points(points, starts, free_ends, free_starts, now, scan, reach, resolution, age, grid, times, out, alone):
    """Take one scan and write uint8 (N,) into `out`: of each point whether it stands, came into what was free beside something that stands,
    came into what was free, or moves; and into `alone` (N,) whether it came to where nothing has stood since the place came into sight: a wall
    along which rays graze is looked through and met again, and seems to have come.

    All places float64 (., 2) in a frame that does not move; `starts` and `free_starts` (N, 2) or (1, 2). `grid` int64 (5, size * size): key,
    state, scan of the last hit, scans that looked through since (`GONE` at most), the last of them; `times` float64 (3, size * size): since when a cell is
    occupied (or, if nothing was known before, in sight), 1 if it was free before, and 1 if it was ever found occupied without that. Points beyond `reach` stand.
    What is hit again within `UNSEEN` scans, before `GONE` of them in a row looked through, has been there all the time: rays meet bars and legs that are
    thinner than their distance now and then.
    """
    size = int(math.sqrt(grid.shape[1]))
    keys, states, hits, misses = grid[0], grid[1], grid[2], grid[3]
    since, was_free, stood = times[0], times[1], times[2]
    for i in range(points.shape[0]):
        s = min(i, starts.shape[0] - 1)
        if math.hypot(points[i, 0] - starts[s, 0], points[i, 1] - starts[s, 1]) > reach:
            continue
        k = _cell(points[i, 0], points[i, 1], resolution, size, keys, states)
        if states[k] == FREE and misses[k] < GONE and scan - hits[k] <= UNSEEN:
            states[k] = OCCUPIED  # a thin thing that rays meet now and then stood here all the time
        elif states[k] != OCCUPIED:
            was_free[k] = 1.0 if states[k] == FREE else 0.0
            if states[k] == UNKNOWN:
                stood[k] = 1.0
            states[k], since[k] = OCCUPIED, now
        elif was_free[k] == 0.0 and scan - hits[k] > UNSEEN:
            since[k] = now
        hits[k], misses[k] = scan, 0
    _look_through(points, starts, BEFORE_HIT, scan, reach, resolution, size, grid, stood)
    _look_through(free_ends, free_starts, 0.0, scan, reach, resolution, size, grid, stood)
    for i in range(points.shape[0]):
        out[i], alone[i] = STANDING, 0
        s = min(i, starts.shape[0] - 1)
        if math.hypot(points[i, 0] - starts[s, 0], points[i, 1] - starts[s, 1]) > reach:
            continue
        k = _cell(points[i, 0], points[i, 1], resolution, size, keys, states)
        if was_free[k] == 0.0:
            continue
        out[i] = CAME if now - since[k] > age else MOVING
        alone[i] = ALONE
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                x, y = points[i, 0] + dx * resolution, points[i, 1] + dy * resolution
                n = _cell(x, y, resolution, size, keys, states)
                if states[n] != UNKNOWN and stood[n] > 0.0:
                    alone[i] = 0
                if states[n] == OCCUPIED and was_free[n] == 0.0:
                    out[i] = BESIDE
                elif states[n] == OCCUPIED and now - since[n] > age:
                    out[i] = min(out[i], CAME)


@jit
def _look_through(ends, starts, short, scan, reach, resolution, size, grid, stood):
    keys, states, hits, misses, missed = grid[0], grid[1], grid[2], grid[3], grid[4]
    pace, inverse = 0.7 * resolution, 1.0 / resolution
    for i in range(ends.shape[0]):
        s = min(i, starts.shape[0] - 1)
        dx, dy = ends[i, 0] - starts[s, 0], ends[i, 1] - starts[s, 1]
        length = math.hypot(dx, dy)
        if length <= short:
            continue
        dx, dy = dx / length, dy / length
        last_x, last_y = 0, 0
        for j in range(int(min(length - short, reach) / pace)):
            d = pace * j
            ix = int(math.floor((starts[s, 0] + d * dx) * inverse))
            iy = int(math.floor((starts[s, 1] + d * dy) * inverse))
            if j > 0 and ix == last_x and iy == last_y:
                continue
            last_x, last_y = ix, iy
            # As `_cell`, the call of which takes as long as all the rest.
            k = (iy & (size - 1)) * size + (ix & (size - 1))
            key = iy * 1000003 + ix
            if keys[k] != key:
                keys[k], states[k] = key, UNKNOWN
            if hits[k] == scan:
                continue
            if states[k] == UNKNOWN:
                states[k], misses[k], stood[k] = FREE, GONE, 0.0
            elif missed[k] != scan and misses[k] < GONE:
                misses[k], missed[k] = misses[k] + 1, scan
                if misses[k] >= MISSES:
                    states[k] = FREE
                if misses[k] >= GONE:
                    stood[k] = 0.0


@jit
def count_occupied(points, resolution, grid):
    """Return how many of the points (N, 2) lie in cells of `judge_points`' grid that are occupied as far as anybody has seen."""
    size, count = int(math.sqrt(grid.shape[1])), 0
    for i in range(points.shape[0]):
        if grid[1, _cell(points[i, 0], points[i, 1], resolution, size, grid[0], grid[1])] == OCCUPIED:
            count += 1
    return count


@jit
def came_into_sight(points, after, resolution, grid, times, out):
    """Write into `out` uint8 (N,) which of the points (N, 2) lie in cells of `judge_points`' grid that came into sight occupied
    after `after` (s): nothing tells whether what is there came."""
    size = int(math.sqrt(grid.shape[1]))
    for i in range(points.shape[0]):
        k = _cell(points[i, 0], points[i, 1], resolution, size, grid[0], grid[1])
        out[i] = grid[1, k] == OCCUPIED and times[1, k] == 0.0 and times[0, k] > after


@jit
def make_free_before(points, resolution, grid, times):
    """Take the cells of `judge_points`' grid under the points (N, 2) for ones that were free before what stands in them came."""
    size = int(math.sqrt(grid.shape[1]))
    for i in range(points.shape[0]):
        k = _cell(points[i, 0], points[i, 1], resolution, size, grid[0], grid[1])
        times[1, k], times[2, k] = 1.0, 0.0


@jit
def group_points(points, kinds, wanted, link, labels, queue):
    """Label the points (N, 2) of the kind `wanted` by chains of steps up to `link` metres: int32 (N,), -1 for the others; returns how many
    groups there are. `queue` int32 (N,) is scratch."""
    count = 0
    for i in range(points.shape[0]):
        labels[i] = -1
    for i in range(points.shape[0]):
        if kinds[i] != wanted or labels[i] >= 0:
            continue
        labels[i] = count
        queue[0] = i
        head, tail = 0, 1
        while head < tail:
            a = queue[head]
            head += 1
            for b in range(points.shape[0]):
                if kinds[b] != wanted or labels[b] >= 0:
                    continue
                if (points[a, 0] - points[b, 0]) ** 2 + (points[a, 1] - points[b, 1]) ** 2 <= link * link:
                    labels[b] = count
                    queue[tail] = b
                    tail += 1
        count += 1
    return count


@jit
def outline_distance(x, y, normals, offsets, corners, nearest):
    """Return the distance of a point from a convex footprint, 0 inside, and write the nearest point of it into `nearest` (2,)."""
    outside = -1e30
    for e in range(normals.shape[0]):
        outside = max(outside, normals[e, 0] * x + normals[e, 1] * y - offsets[e])
    best = 1e30
    for e in range(corners.shape[0]):
        f = (e + 1) % corners.shape[0]
        ax, ay = corners[e, 0], corners[e, 1]
        dx, dy = corners[f, 0] - ax, corners[f, 1] - ay
        u = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)))
        px, py = ax + u * dx, ay + u * dy
        d = (x - px) ** 2 + (y - py) ** 2
        if d < best:
            best = d
            nearest[0], nearest[1] = px, py
    return 0.0 if outside <= 0.0 else math.sqrt(best)


@jit
def starts_contact(pose, now, twist, plan, movers, normals, offsets, corners, past):
    """Say how soon (s) a motion would start a contact: the robot at `pose` (x, y, yaw) moves with `now` (vx, vy, wz), takes on `twist` after a
    reaction, keeps it for a while and then brakes to a stand; inf if it never does.

    `plan` is (reaction, hold, brake x, y (m/s^2), z (rad/s^2), calm, slow, step): a contact counts as started by the robot when, within `calm`
    seconds before it, the touched point of the footprint moved towards the mover faster than `slow`. `movers` float64 (K, 6) of (x, y, vx, vy,
    radius, growth): a disc on its way from now on, its radius growing by so many m/s. All in one frame. `past` float64 (T, 6) is scratch for
    the poses and twists of all steps; what happened before now is done and does not count.
    """
    reaction, hold, dt = plan[0], plan[1], plan[7]
    nearest, touched = np.empty(2), np.zeros((movers.shape[0], 3))
    stand = reaction + hold + max(abs(twist[0]) / plan[2], abs(twist[1]) / plan[3], abs(twist[2]) / plan[4])
    steps = min(past.shape[0] - 1, int(math.ceil((stand + plan[5]) / dt)))
    x, y, yaw, farthest = pose[0], pose[1], pose[2], 0.0
    for e in range(corners.shape[0]):
        farthest = max(farthest, math.hypot(corners[e, 0], corners[e, 1]))
    for k in range(steps + 1):
        t = k * dt
        vx, vy, wz = _faster(now[0], twist[0]), _faster(now[1], twist[1]), _faster(now[2], twist[2])
        if t >= reaction:
            since = max(0.0, t - reaction - hold)
            vx = math.copysign(max(0.0, abs(twist[0]) - plan[2] * since), twist[0])
            vy = math.copysign(max(0.0, abs(twist[1]) - plan[3] * since), twist[1])
            wz = math.copysign(max(0.0, abs(twist[2]) - plan[4] * since), twist[2])
        past[k, 0], past[k, 1], past[k, 2] = x, y, yaw
        past[k, 3], past[k, 4], past[k, 5] = vx, vy, wz
        c, s = math.cos(yaw), math.sin(yaw)
        for m in range(movers.shape[0]):
            if touched[m, 2] > 0.0:  # nobody walks through the robot: who has reached it stays where he touches it
                dx, dy = touched[m, 0] - x, touched[m, 1] - y
                bx, by = c * dx + s * dy, -s * dx + c * dy
                stands = movers[m, 2] == 0.0 and movers[m, 3] == 0.0
                if _pushes(bx, by, vx, vy, wz, stands, normals, offsets, corners, nearest) > plan[6]:
                    return t
                continue
            dx, dy = movers[m, 0] + movers[m, 2] * t - x, movers[m, 1] + movers[m, 3] * t - y
            reach = farthest + movers[m, 4] + movers[m, 5] * t
            if dx * dx + dy * dy > reach * reach:
                continue
            bx, by = c * dx + s * dy, -s * dx + c * dy
            gap = outline_distance(bx, by, normals, offsets, corners, nearest)
            if gap <= movers[m, 4] + movers[m, 5] * t:
                if _came_nearer(nearest, movers[m], past, k, plan):
                    return t
                touched[m, 0], touched[m, 1], touched[m, 2] = dx + x, dy + y, 1.0
        x += (c * vx - s * vy) * dt
        y += (s * vx + c * vy) * dt
        yaw += wz * dt
    return np.inf


@jit
def _pushes(x, y, vx, vy, wz, stands, normals, offsets, corners, nearest):
    """Return how fast (m/s) a robot that moves with (vx, vy, wz) comes nearer to who touches it and stands at (x, y) of its frame, or as far as
    `SLIDE` to either side of there. One that turns, or that he presses on, must lead away from him, also from who leans at it."""
    gap = outline_distance(x, y, normals, offsets, corners, nearest)
    ux, uy = (x - nearest[0], y - nearest[1]) if gap > 0.0 else (x, y)
    length = max(1e-9, math.hypot(ux, uy))
    ux, uy = ux / length, uy / length
    if abs(wz) > STRAIGHT or not stands:
        speed = math.hypot(vx - wz * nearest[1], vy + wz * nearest[0]) + abs(wz) * LEANING
        nearer = (vx - wz * nearest[1]) * ux + (vy + wz * nearest[0]) * uy + abs(wz) * LEANING
        return speed if nearer > -AWAY * speed else 0.0
    fastest = -1e30
    for side in range(-1, 2):
        px, py = x - side * SLIDE * uy, y + side * SLIDE * ux
        gap = outline_distance(px, py, normals, offsets, corners, nearest)
        tx, ty = (px - nearest[0], py - nearest[1]) if gap > 0.0 else (px, py)
        fastest = max(fastest, (vx * tx + vy * ty) / max(1e-9, math.hypot(tx, ty)))
    return fastest


@jit
def _faster(now, wanted):
    """Return the velocity that counts while nobody knows whether the base obeys already."""
    return wanted if abs(wanted) > abs(now) else now


@jit
def _came_nearer(point, mover, past, last, plan):
    """Say whether a point of the robot, or of a turning one a point up to `SLIDE` beside it, moved towards a mover within the calm time before the step `last`."""
    calm, slow, dt = plan[5], plan[6], plan[7]
    for k in range(last, max(-1, last - int(math.ceil(calm / dt)) - 1), -1):
        c, s = math.cos(past[k, 2]), math.sin(past[k, 2])
        px, py = past[k, 0] + c * point[0] - s * point[1], past[k, 1] + s * point[0] + c * point[1]
        ux, uy = mover[0] + mover[2] * k * dt - px, mover[1] + mover[3] * k * dt - py
        bx, by = past[k, 3] - past[k, 5] * point[1], past[k, 4] + past[k, 5] * point[0]
        if (c * bx - s * by) * ux + (s * bx + c * by) * uy > (slow - SLIDE * abs(past[k, 5])) * math.hypot(ux, uy):
            return True
    return False


def warm_up() -> None:
    """Compile every kernel of this module."""
    points, one = np.array([[1.0, 0.1], [1.0, 0.2]]), np.zeros((1, 2))
    grid, times = np.zeros((5, 64), np.int64), np.zeros((3, 64))
    kinds, alone = np.zeros(2, np.uint8), np.zeros(2, np.uint8)
    for scan in range(2):
        judge_points(points, one, points, points, 0.1 * scan, scan, 5.0, 0.1, 0.7, grid, times, kinds, alone)
    count_occupied(points, 0.1, grid)
    came_into_sight(points, 0.0, 0.1, grid, times, kinds)
    make_free_before(points, 0.1, grid, times)
    group_points(points, kinds, 0, 0.3, np.zeros(2, np.int32), np.zeros(2, np.int32))
    corners = np.array([[0.3, -0.2], [0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2]])
    normals, offsets = footprint_edges(corners, 0.0)
    outline_distance(1.0, 0.0, normals, offsets, corners, np.zeros(2))
    plan = np.array([0.2, 0.2, 1.0, 1.0, 1.0, 0.5, 0.05, 0.1])
    movers = np.array([[2.0, 0.0, -1.0, 0.0, 0.3, 0.1]])
    starts_contact(
        np.zeros(3), np.zeros(3), np.array([0.3, 0.0, 0.1]), plan, movers, normals, offsets, corners, np.zeros((9, 6))
    )
