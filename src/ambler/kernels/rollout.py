"""Rolling out many commands at once, and the map grid that scores where they end (navigation reference, Trajectory Rollout)."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.footprint import LethalCells, Outline, lethal_cells_inside, lethal_distance, lethal_row_sums
from ambler.kernels.jit import jit

FAR = 0.25  # metres of clearance beyond which nobody asks how much it is exactly
MARKS_MAX = 8  # places of a trajectory that are looked up on the path: four, and what is left of its steps
MOVERS_FAR = 2.0  # metres of gap to movers beyond which nobody asks
FREE, END_X, END_Y, END_YAW, ALONG, CLEARANCE, MOVER_GAP, MARKS, OFF_PATH, OFF_HEADING = range(10)
COLUMNS = 10  # of a result of `roll_out`, named in the line above; the last two by `look_along`
UNSEEN = -1.0  # stands in `OFF_PATH` until somebody asks


@jit
def spread_path(path_cells, distance, blocked_radius, steps, label, queue):
    """Breadth-first search from the cells of a path: how many 4-connected steps is each cell from it, and from which point.

    `path_cells` int32 (P, 2) of (iy, ix), in the order of the path; `steps` int32 (H, W) becomes -1 where the path cannot be
    reached by the robot's centre (`distance` below `blocked_radius`); `label` int32 (H, W) the index of the path point;
    `queue` int32 (H * W) is scratch, H and W below 32768.
    """
    height, width = steps.shape
    steps[:] = -1
    label[:] = -1
    tail = 0
    for p in range(path_cells.shape[0]):
        iy, ix = path_cells[p, 0], path_cells[p, 1]
        if 0 <= iy < height and 0 <= ix < width and steps[iy, ix] < 0:
            steps[iy, ix] = 0
            label[iy, ix] = p
            queue[tail] = iy << 16 | ix  # shifts where a division would take most of the time
            tail += 1
    head = 0
    while head < tail:
        iy, ix = np.uint64(queue[head] >> 16), np.uint64(queue[head] & 0xFFFF)
        ahead, nearest = steps[iy, ix] + 1, label[iy, ix]
        head += 1
        for k in range(4):
            # What is left of or below 0 is larger than any grid.
            ny = iy + np.uint64((k == 0) - (k == 1))
            nx = ix + np.uint64((k == 2) - (k == 3))
            if (
                ny < np.uint64(height)
                and nx < np.uint64(width)
                and steps[ny, nx] < 0
                and distance[ny, nx] >= blocked_radius
            ):
                steps[ny, nx] = ahead
                label[ny, nx] = nearest
                queue[tail] = np.int64(ny) << 16 | np.int64(nx)
                tail += 1


@jit
def locate_on_path(gx, gy, guide, resolution, out):
    """Write (distance to the path, arc length of the nearest point, its heading) for a place (gx, gy) from the grid's origin.

    `guide` holds the path float64 (P, 4) of (x, y, arc length, heading), from the grid's origin too. Its grid says which stretch of the
    path is the nearest without crossing an obstacle; the distance to that stretch is exact.
    """
    path, steps, label = guide.path, guide.steps, guide.label
    count = path.shape[0]
    height, width = steps.shape
    iy, ix = int(math.floor(gy / resolution)), int(math.floor(gx / resolution))
    is_reached = 0 <= iy < height and 0 <= ix < width and steps[iy, ix] >= 0
    first, last, walk = 0, count - 1, -1.0
    if is_reached:
        first, last = max(0, label[iy, ix] - 6), min(count - 1, label[iy, ix] + 6)
        walk = steps[iy, ix] * resolution
    best, at = 1e30, first
    for q in range(np.uint64(first), np.uint64(last + 1)):
        d = (path[q, 0] - gx) ** 2 + (path[q, 1] - gy) ** 2
        if d < best:
            best, at = d, np.int64(q)
    along = 0.0
    if count > 1:
        best = 1e30
        for p in range(max(0, at - 1), min(count - 2, at) + 1):
            dx, dy = path[p + 1, 0] - path[p, 0], path[p + 1, 1] - path[p, 1]
            length = dx * dx + dy * dy
            u = ((gx - path[p, 0]) * dx + (gy - path[p, 1]) * dy) / max(length, 1e-12)
            u = min(1.0, max(0.0, u))
            d = (path[p, 0] + u * dx - gx) ** 2 + (path[p, 1] + u * dy - gy) ** 2
            if d < best:
                best, at, along = d, p, u
    straight = math.sqrt(best)
    out[0] = walk if walk > 1.5 * straight + 3.0 * resolution else straight
    if not is_reached:
        out[0] = straight + 1.0
    out[1] = path[at, 2]
    if count > 1:
        out[1] += along * (path[min(at + 1, count - 1), 2] - path[at, 2])
    out[2] = path[at, 3]


@jit
def approach_speed(value, target, acceleration, braking, dt):
    """Return a velocity after `dt` seconds on the way to `target`."""
    rate = braking if value * target < 0.0 or abs(target) < abs(value) else acceleration
    change = rate * dt
    if abs(target - value) <= change:
        return target
    return value + math.copysign(change, target - value)


@jit
def clearance_at(gx, gy, cos, sin, circles, distance, resolution):
    """Return a lower bound of the distance between the footprint, covered by circles (M, 3) of (x, y, r), and lethal cells."""
    height, width = distance.shape
    per_metre = 1.0 / resolution
    best = 1e30
    for c in range(np.uint64(circles.shape[0])):
        x = gx + cos * circles[c, 0] - sin * circles[c, 1]
        y = gy + sin * circles[c, 0] + cos * circles[c, 1]
        iy, ix = int(y * per_metre), int(x * per_metre)
        gap = -circles[c, 2]
        if x >= 0.0 and y >= 0.0 and iy < height and ix < width:
            gap += distance[np.uint64(iy), np.uint64(ix)]
        else:
            iy = min(max(int(math.floor(y * per_metre)), 0), height - 1)
            ix = min(max(int(math.floor(x * per_metre)), 0), width - 1)
            gap += distance[iy, ix] - max(0.0, -x, x - width * resolution) - max(0.0, -y, y - height * resolution)
        best = min(best, gap)
    return best - 0.7072 * resolution


@jit
def no_more_covered(gx, gy, cos, sin, inside, cells, outline):
    """Return how many of the `LethalCells` the `Outline` covers at a pose; -1 if they are more than the `inside` ones of the pose before, for a
    robot that already touches something may only leave it. This is the one collision check of everything that moves a footprint."""
    now = lethal_cells_inside(cells.row_sums, cells.resolution, gx, gy, cos, sin, outline.normals, outline.offsets)
    return -1 if now > inside else now


@jit
def covered_cells(gx, gy, cos, sin, inside, cells, outline):
    """Return what `no_more_covered` says, at once where the circles are clear of everything."""
    if clearance_at(gx, gy, cos, sin, outline.circles, cells.distance, cells.resolution) > 0.0:
        return 0
    return no_more_covered(gx, gy, cos, sin, inside, cells, outline)


@jit
def covered_at_start(start, cells, outline):
    """Return how many lethal cells the footprint covers at `start` (x, y, yaw)."""
    c, s = math.cos(start[2]), math.sin(start[2])
    return lethal_cells_inside(
        cells.row_sums, cells.resolution, start[0], start[1], c, s, outline.normals, outline.offsets
    )


@jit
def mover_gap(gx, gy, cos, sin, circles, movers, seconds):
    """Return the least gap between the circles (M, 3) of a footprint and movers (K, 6) of (x, y, vx, vy, radius, growth) after so many seconds."""
    best = 1e30
    for m in range(movers.shape[0]):
        px, py = movers[m, 0] + movers[m, 2] * seconds - gx, movers[m, 1] + movers[m, 3] * seconds - gy
        bx, by = cos * px + sin * py, cos * py - sin * px
        wide = movers[m, 4] + movers[m, 5] * seconds
        for c in range(circles.shape[0]):
            dx, dy = bx - circles[c, 0], by - circles[c, 1]
            best = min(best, math.sqrt(dx * dx + dy * dy) - circles[c, 2] - wide)
    return best


class Guide(NamedTuple):
    """A path float64 (P, 4) as `locate_on_path` takes it, and what `spread_path` says of the cells around it."""

    path: NDArray[np.float64]
    steps: NDArray[np.int32]
    label: NDArray[np.int32]


@jit
def roll_out(samples, start, velocity, rates, plan, cells, outline, guide, movers, out, marks):
    """Simulate every wanted velocity of `samples` (N, 3) from `start` (x, y, yaw), measured from the grid's origin.

    Axes approach the wanted velocity with `rates` (ax, ay, az, brake x, y, z). `plan` is (horizon, stop_distance,
    step_length, radius, near_speed, speed_per_clearance, slowest): a trajectory ends after the horizon or when it has covered the stop
    distance. A footprint pose may never cover more lethal cells than the one before (`no_more_covered`), and a sample faster than `slowest`
    may not be faster than near_speed + speed_per_clearance * clearance; either ends it at once, not free. `movers` as in `mover_gap`, from the start on.
    `out` (N, COLUMNS): free (1 or 0), x, y, yaw, arc length reached, least clearance (at most FAR), least gap to movers (at most MOVERS_FAR), how many places (x, y, yaw) of
    the way were written to `marks` (N, MARKS_MAX, 3); the rest is `UNSEEN`, for `look_along`.
    """
    horizon, stop_distance, step_length, radius = plan[0], plan[1], plan[2], plan[3]
    near_speed, speed_per_clearance, slowest = plan[4], plan[5], plan[6]
    place = np.zeros(3)
    has_movers = movers.shape[0] > 0
    circles, distance, resolution = outline.circles, cells.distance, cells.resolution
    inside_at_start = covered_at_start(start, cells, outline)
    start_c, start_s = math.cos(start[2]), math.sin(start[2])
    moving = math.sqrt(velocity[0] * velocity[0] + velocity[1] * velocity[1])
    for i in range(samples.shape[0]):
        x, y, yaw = start[0], start[1], start[2]
        vx, vy, wz = velocity[0], velocity[1], velocity[2]
        tx, ty, tw = samples[i, 0], samples[i, 1], samples[i, 2]
        speed = math.hypot(tx, ty)
        is_slow = speed <= slowest
        fast = max(speed, moving)
        fast += max(abs(tw), abs(wz)) * radius
        count = min(80, max(8, int(math.ceil(fast * horizon / step_length))))
        dt = horizon / count
        inside, travelled, least, room, gap = inside_at_start, 0.0, FAR, 0.0, MOVERS_FAR
        count_marks = 0
        stride = max(1, count // 4)
        next_mark = stride - 1
        is_free = 1.0
        c, s = start_c, start_s
        half_c, half_s, last_turn = 1.0, 0.0, 0.0
        is_settled = False
        mx, my, turn, way, bend = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            if not is_settled:
                is_settled = vx == tx and vy == ty and wz == tw
                nx = approach_speed(vx, tx, rates[0], rates[3], dt)
                ny = approach_speed(vy, ty, rates[1], rates[4], dt)
                nw = approach_speed(wz, tw, rates[2], rates[5], dt)
                mx, my = 0.5 * (vx + nx) * dt, 0.5 * (vy + ny) * dt
                turn = 0.5 * (wz + nw) * dt
                vx, vy, wz = nx, ny, nw
                way = math.sqrt(mx * mx + my * my)
                bend = abs(turn) * radius
            is_last = k == count - 1
            if travelled + way >= stop_distance:
                part = (stop_distance - travelled) / way if way > 0.0 else 1.0
                mx, my, turn, way, bend = mx * part, my * part, turn * part, way * part, bend * part
                is_last = True
            if turn != last_turn:
                half_c, half_s, last_turn = math.cos(0.5 * turn), math.sin(0.5 * turn), turn
            c, s = c * half_c - s * half_s, s * half_c + c * half_s
            x += c * mx - s * my
            y += s * mx + c * my
            c, s = c * half_c - s * half_s, s * half_c + c * half_s
            yaw += turn
            travelled += way
            room -= way + bend
            if room <= FAR:
                room = clearance_at(x, y, c, s, circles, distance, resolution)
                least = min(least, room)
                if not is_slow and speed > near_speed + speed_per_clearance * max(0.0, least):
                    is_free = 0.0
                    break
                if room <= 0.0:
                    inside = no_more_covered(x, y, c, s, inside, cells, outline)
                    if inside < 0:
                        is_free = 0.0
                        break
                else:
                    inside = 0
            if has_movers:
                gap = min(gap, mover_gap(x, y, c, s, circles, movers, (k + 1) * dt))
            if is_last or k == next_mark:
                next_mark += stride
                marks[i, count_marks, 0], marks[i, count_marks, 1], marks[i, count_marks, 2] = x, y, yaw
                count_marks += 1
            if is_last:
                break
        if is_free > 0.0:  # nobody asks where a collision leads
            locate_on_path(x, y, guide, resolution, place)
        out[i, FREE] = is_free
        out[i, END_X], out[i, END_Y], out[i, END_YAW] = x, y, yaw
        out[i, ALONG], out[i, CLEARANCE], out[i, MOVER_GAP] = place[1], least, gap
        out[i, MARKS], out[i, OFF_PATH], out[i, OFF_HEADING] = count_marks, UNSEEN, UNSEEN


@jit
def look_along(marks, guide, resolution, place, result):
    """Write the mean distance to the path and the mean heading error of one way of `roll_out` into its `result`; `place` float64 (3,) is scratch."""
    path_sum, heading_sum = 0.0, 0.0
    count = int(result[MARKS])
    for k in range(count):
        locate_on_path(marks[k, 0], marks[k, 1], guide, resolution, place)
        path_sum += place[0]
        off = marks[k, 2] - place[2] + math.pi
        if not 0.0 <= off < 2.0 * math.pi:
            off = off % (2.0 * math.pi)
        heading_sum += abs(off - math.pi)
    result[OFF_PATH], result[OFF_HEADING] = path_sum / max(count, 1), heading_sum / max(count, 1)


@jit
def best_sample(samples, results, marks, guide, resolution, weights, end_s, before, gain, last_turn):
    """Return the index of the sample that costs least among those that are free and gain more than `gain` metres; -1 if there is none.

    `results` and `marks` are those of `roll_out`; `before` is the length of path that is left now, with the way back to the path. `weights` (none below 0) are (progress,
    path, heading, clearance, turn change, sideways, near, movers, movers_near), as in `control.config.RolloutConfig`. Only ways that may still be the best are looked at along the path,
    the fastest samples first, which stand last.
    """
    best, chosen = np.inf, -1
    off = min(1.0, weights[1])
    place = np.empty(3)
    for i in range(samples.shape[0] - 1, -1, -1):
        left = end_s - results[i, ALONG]
        if results[i, FREE] <= 0.0 or not left < before - gain:
            continue
        is_seen = results[i, OFF_PATH] != UNSEEN
        if not is_seen:
            results[i, OFF_PATH], results[i, OFF_HEADING] = 0.0, 0.0
            if _cost(samples[i], results[i], weights, left, last_turn) > best:
                results[i, OFF_PATH], results[i, OFF_HEADING] = UNSEEN, UNSEEN
                continue
            look_along(marks[i], guide, resolution, place, results[i])
        if not left + off * results[i, OFF_PATH] < before - gain:
            continue
        cost = _cost(samples[i], results[i], weights, left, last_turn)
        if cost <= best:
            best, chosen = cost, i
    return chosen


@jit
def _cost(sample, result, weights, left, last_turn):
    """Return what a way costs that leaves `left` metres of path; the others as in `best_sample`."""
    cost = weights[0] * left + weights[1] * result[OFF_PATH] + weights[2] * result[OFF_HEADING]
    cost += weights[3] * max(0.0, weights[6] - result[CLEARANCE])
    cost += weights[4] * abs(sample[2] - last_turn)
    cost += weights[5] * abs(sample[1])
    cost -= 0.05 * sample[0]
    return cost + weights[7] * max(0.0, weights[8] - result[MOVER_GAP])


@jit
def free_turn(start, angle, cells, outline):
    """Return how far (signed radians, at most `angle`) the footprint at `start` (x, y, yaw) can turn in place."""
    count = max(1, int(math.ceil(abs(angle) / 0.04)))
    inside = covered_at_start(start, cells, outline)
    for k in range(1, count + 1):
        yaw = start[2] + angle * k / count
        c, s = math.cos(yaw), math.sin(yaw)
        inside = covered_cells(start[0], start[1], c, s, inside, cells, outline)
        if inside < 0:
            return angle * (k - 1) / count
    return angle


@jit
def free_slide(start, heading, length, cells, outline):
    """Return how far (metres, at most `length`) the footprint at `start` can slide along the world direction `heading`."""
    count = max(1, int(math.ceil(length / 0.02)))
    c, s = math.cos(start[2]), math.sin(start[2])
    inside = covered_at_start(start, cells, outline)
    for k in range(1, count + 1):
        x = start[0] + math.cos(heading) * length * k / count
        y = start[1] + math.sin(heading) * length * k / count
        inside = covered_cells(x, y, c, s, inside, cells, outline)
        if inside < 0:
            return length * (k - 1) / count
    return length


def warm_up() -> None:
    """Compile every kernel of this module."""
    n = 8
    sums, distance = np.zeros((n, n + 1), np.int32), np.empty((n, n))
    lethal_row_sums(np.zeros((n, n), np.uint8), 254, sums)
    lethal_distance(sums, 0.05, distance)
    steps, label = np.empty((n, n), np.int32), np.empty((n, n), np.int32)
    spread_path(np.array([[1, 1], [1, 2]], np.int32), distance, 0.1, steps, label, np.empty(n * n, np.int32))
    path = np.array([[0.05, 0.05, 0.0, 0.0], [0.1, 0.05, 0.05, 0.0]])
    guide = Guide(path, steps, label)
    locate_on_path(0.1, 0.1, guide, 0.05, np.empty(3))
    normals = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    cells, outline = LethalCells(sums, distance, 0.05), Outline(normals, np.full(4, 0.1), np.array([[0.0, 0.0, 0.15]]))
    start = np.array([0.2, 0.2, 0.0])
    clearance_at(0.2, 0.2, 1.0, 0.0, outline.circles, distance, 0.05)
    approach_speed(0.0, 1.0, 1.0, 1.0, 0.1)
    plan = np.array([1.0, 1.0, 0.05, 0.3, 0.3, 3.5, 0.1])
    samples, results = np.array([[0.1, 0.0, 0.1]]), np.empty((1, COLUMNS))
    marks = np.empty((1, MARKS_MAX, 3))
    roll_out(samples, start, np.zeros(3), np.ones(6), plan, cells, outline, guide, np.zeros((0, 6)), results, marks)
    best_sample(samples, results, marks, guide, 0.05, np.ones(9), 1.0, 1.0, 0.02, 0.0)
    covered_cells(0.2, 0.2, 1.0, 0.0, 0, cells, outline)
    no_more_covered(0.2, 0.2, 1.0, 0.0, 0, cells, outline)
    covered_at_start(start, cells, outline)
    mover_gap(0.2, 0.2, 1.0, 0.0, outline.circles, np.array([[1.0, 0.0, 0.5, 0.0, 0.3, 0.1]]), 1.0)
    free_turn(start, 0.5, cells, outline)
    free_slide(start, 0.0, 0.1, cells, outline)
