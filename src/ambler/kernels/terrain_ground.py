"""Ground out of the lows of cells: what is joined to the place where the robot stands, its slopes, steps, drops and stairs.

Arrays (m, m) of cells roll with the robot as the columns of `terrain_columns` do: row and column of a cell are its numbers modulo m.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit_ieee
from ambler.kernels.terrain_columns import BINS, COUNT, DIRECTIONS, QUARTER, ROW, ROW_LOW, ROWS, Z, lowest_bit, wrapped

UNKNOWN, GROUND, OBSTACLE, DROP, STEEP, STAIRS = 0, 1, 2, 3, 4, 5
JOINED_DROP, JOINED_STEP = 8, 9  # only within `mark_edges`
LEVEL, UNEVEN, UNSEEN, CLOSED_NOW = 16, 17, 18, 19  # only within `_close_holes`
CLOSED = 6  # cells of a hole in an edge that are closed: no robot is as narrow as that
EVIDENCE_MOST = 12
SURE = 7.0  # returns from which on the height of a cell is sure to some centimetres
RUN = 0.8  # metres over which seen ground tells its slope; after shorter runs it may go on by 0.1 lower for each metre
RAMP = 0.45  # the steepest fall behind an edge that may be a ramp
BRIDGE = 0.9  # metres behind an edge that are hidden where rays pass above what follows: beyond, it is a drop
SPREAD = 0.65  # of a cell's side lies between the places where a slope has the low and the high of the cell
LOW_RETURNS = 5.0  # that make a low obstacle: beams between two surfaces lie near the floor


def _lines() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return, for every cell within `CLOSED` rows and columns of one and not beside it (half of them: the other half is the same from the other
    end), its offset (dy, dx) and those of the cells on the line to it, int64 (N, CLOSED, 2), and how many cells the line has with its end, (N,)."""
    ends = [
        (dy, dx)
        for dy in range(CLOSED + 1)
        for dx in range(-CLOSED if dy > 0 else 2, CLOSED + 1)
        if max(dy, abs(dx)) > 1
    ]
    counts = np.array([max(dy, abs(dx)) for dy, dx in ends])
    offsets = np.zeros((len(ends), CLOSED, 2), np.int64)
    for (dy, dx), count, line in zip(ends, counts.tolist(), offsets, strict=True):
        line[0] = dy, dx
        for i in range(1, count):
            line[i] = (2 * i * dy + count) // (2 * count), (2 * i * dx + count) // (2 * count)
    return offsets, counts


LINES, LENGTHS = _lines()


@jit_ieee
def grow_ground(
    lows,
    highs,
    returns,
    memory,
    evidence,
    touched,
    base,
    first,
    size,
    seed_radius,
    climb,
    slack,
    tilt,
    gap_most,
    ground,
    state,
    gap,
    queue,
    later,
):
    """Grow the ground from under the robot over cells that continue it; unseen ones carry the height on.

    Where too little is seen now, `memory` (m, m) of ground that is known to be firm, NaN elsewhere, stands for it where it continues the ground, and the `evidence` for a drop is void; `touched` uint8 (m, m)
    becomes 1 there, so that the cell's own low is found again.

    `lows`, `highs` (m, m) as the columns, modulo m; `ground` float32 (m, m) gets heights, `state` uint8 1 for seen ground, 2 for carried heights, 0
    elsewhere. Of two cells side by side one continues the other within `climb`; across a gap within `slack` + `tilt` per metre, where
    it may also lie as far away as its own slope, continued to the gap's other side, explains. `queue`, `later` int32 (m * m,).
    """
    m = lows.shape[0]
    cell = 2.0 * size
    cx0, cy0 = first[0] // 2, first[1] // 2
    ox, oy = cx0 % m, cy0 % m
    state[:, :] = 0
    ground[:, :] = np.nan
    sx, sy = int(math.floor(base[0] / cell)) - cx0, int(math.floor(base[1] / cell)) - cy0
    reach = int(math.ceil(seed_radius / cell))
    ends = 0
    waiting = 0
    for ly in range(max(0, sy - reach), min(m, sy + reach + 1)):
        for lx in range(max(0, sx - reach), min(m, sx + reach + 1)):
            ey, ex = (cy0 + ly + 0.5) * cell - base[1], (cx0 + lx + 0.5) * cell - base[0]
            if ex * ex + ey * ey > seed_radius * seed_radius:
                continue
            py, px = wrapped(oy + ly, m), wrapped(ox + lx, m)
            low = lows[py, px]
            is_seen = abs(low - base[2]) <= slack
            ground[py, px] = low if is_seen else base[2]
            state[py, px] = 1 if is_seen else 2
            gap[py, px] = 0
            queue[ends] = (ly << 16) | lx
            ends += 1
    at = 0
    while True:
        if at == ends:
            if waiting == 0:
                return
            for k in range(waiting):
                queue[k] = later[k]
            at, ends, waiting = 0, waiting, 0
        here = queue[at]
        at += 1
        ly, lx = here >> 16, here & 0xFFFF
        py, px = wrapped(oy + ly, m), wrapped(ox + lx, m)
        z = ground[py, px]
        wide = gap[py, px]
        for k in range(4):
            jy, jx = ly + (k == 2) - (k == 3), lx + (k == 0) - (k == 1)
            if jy < 0 or jx < 0 or jy >= m or jx >= m:
                continue
            qy, qx = wrapped(oy + jy, m), wrapped(ox + jx, m)
            if state[qy, qx] == 1:
                continue
            low = lows[qy, qx]
            known = memory[qy, qx]
            joined = climb if state[py, px] == 1 else slack + tilt * (wide + 1) * cell
            is_poor = math.isnan(low) or (returns[qy, qx] < SURE and abs(low - known) <= climb)
            if is_poor and abs(known - z) <= joined:  # false where nothing is known
                low = lows[qy, qx] = highs[qy, qx] = known
                returns[qy, qx] = SURE
                touched[qy, qx] = 1
            if abs(low - known) <= slack:
                evidence[qy, qx] = 0
            if state[qy, qx] == 2 and (math.isnan(low) or wide > gap[qy, qx]):
                continue
            if not math.isnan(low):
                off = low - z
                if state[py, px] == 1:
                    is_ground = abs(off) <= climb
                else:
                    width = (wide + 1) * cell
                    allowed = slack + tilt * width
                    is_ground = abs(off) <= allowed
                    if not is_ground:
                        is_ground = _slopes_down_to(lows, ox, oy, jx, jy, k, cell, low, off, width, slack)
                if is_ground:
                    state[qy, qx] = 1
                    gap[qy, qx] = 0
                    ground[qy, qx] = low
                    queue[ends] = (jy << 16) | jx
                    ends += 1
                    if ends == queue.shape[0]:
                        return
                    continue
            if state[qy, qx] == 0 and wide + 1 <= gap_most:
                state[qy, qx] = 2
                gap[qy, qx] = wide + 1
                ground[qy, qx] = z
                if waiting < later.shape[0]:
                    later[waiting] = (jy << 16) | jx
                    waiting += 1


@jit_ieee
def _slopes_down_to(lows, ox, oy, jx, jy, k, cell, low, off, width, slack):
    """Whether a surface seen behind a gap, continued by its slope over the next three cells, meets the height before the gap."""
    m = lows.shape[0]
    fx, fy = jx + 3 * ((k == 0) - (k == 1)), jy + 3 * ((k == 2) - (k == 3))
    if fx < 0 or fy < 0 or fx >= m or fy >= m:
        return False
    far = lows[wrapped(oy + fy, m), wrapped(ox + fx, m)]
    if math.isnan(far):
        return False
    rise = (far - low) / (3.0 * cell)
    if abs(rise) > 0.6 or rise * off <= 0.0:
        return False
    return abs(off - rise * width) <= slack + 0.05 * width


@jit_ieee
def _seen(ground, state, qy, qx, m):
    """Return the height of seen ground at a cell (modulo m), else NaN."""
    y, x = wrapped(qy, m), wrapped(qx, m)
    return np.float64(ground[y, x]) if state[y, x] == 1 else np.nan


@jit_ieee
def _lesser(a, b):
    """The smaller of two slopes of one sign, 0 for two signs; where one is not known the other."""
    a, b = b if math.isnan(a) else a, a if math.isnan(b) else b
    lesser = a if abs(a) < abs(b) else b
    return lesser if a * b > 0.0 else 0.0


@jit_ieee
def _step_down(h, beside, two_on, three_on, four_on, own_slope, cell):
    """Return how much lower than the upper side `h` of a cell the ground lies one to three cells on, beyond what a break between the slopes of the two sides explains.

    Over three cells, because the noise of a kerb's face spreads over two; each cell more asks for a centimetre and a half more. `own_slope`
    is the rise per metre towards the lower side, of this side; NaN where it is not known.
    """
    beyond = (two_on - four_on) / (2.0 * cell)
    fall = -own_slope if own_slope < 0.0 else 0.0
    fall = beyond if beyond > fall else fall
    # What is not known is NaN, and no comparison with that holds.
    one, two, three = (
        h - beside - fall * cell,
        h - two_on - fall * 2.0 * cell - 0.015,
        h - three_on - fall * 3.0 * cell - 0.03,
    )
    most = one if one > 0.0 else 0.0
    most = two if two > most else most
    return three if three > most else most


@jit_ieee
def _slopes(sure, y, x, dy, dx, h, cell):
    """Return the slope of a cell of height `h` along an axis from the cells beside it, its rise over two, and whether neither neighbour is known."""
    ahead, behind = np.float64(sure[y + dy, x + dx]), np.float64(sure[y - dy, x - dx])
    ahead2, behind2 = np.float64(sure[y + 2 * dy, x + 2 * dx]), np.float64(sure[y - 2 * dy, x - 2 * dx])
    slope = _lesser((ahead - h) / cell, (h - behind) / cell)
    rise = _lesser((ahead2 - h) / (2.0 * cell), (h - behind2) / (2.0 * cell))
    return slope, rise, math.isnan(ahead) and math.isnan(behind)


@jit_ieee
def _steps_along(sure, y, x, dy, dx, top, h, cell):
    """Return the larger of the two steps down from a cell's `top` along an axis; `h` is the height of its ground."""
    ahead, behind = np.float64(sure[y + dy, x + dx]), np.float64(sure[y - dy, x - dx])
    ahead2, behind2 = np.float64(sure[y + 2 * dy, x + 2 * dx]), np.float64(sure[y - 2 * dy, x - 2 * dx])
    ahead3, behind3 = np.float64(sure[y + 3 * dy, x + 3 * dx]), np.float64(sure[y - 3 * dy, x - 3 * dx])
    ahead4, behind4 = np.float64(sure[y + 4 * dy, x + 4 * dx]), np.float64(sure[y - 4 * dy, x - 4 * dx])
    forth = _step_down(top, ahead, ahead2, ahead3, ahead4, (h - behind2) / (2.0 * cell), cell)
    back = _step_down(top, behind, behind2, behind3, behind4, (h - ahead2) / (2.0 * cell), cell)
    return max(forth, back)


@jit_ieee
def _unroll(ground, state, returns, first, sure):
    """Write the heights of ground of which enough returns tell into `sure` (m + 8, m + 8) as the window lies, NaN elsewhere and in a rim of four."""
    m = ground.shape[0]
    ox, oy = (first[0] // 2) % m, (first[1] // 2) % m
    sure[:, :] = np.nan
    for ly in range(m):
        y = wrapped(oy + ly, m)
        for lx in range(m):
            x = wrapped(ox + lx, m)
            if state[y, x] == 1 and returns[y, x] >= SURE:
                sure[ly + 4, lx + 4] = ground[y, x]
    # A single cell below or above all of its neighbours is a beam between two surfaces, not a step.
    for ly in range(4, m + 4):
        for lx in range(4, m + 4):
            h = sure[ly, lx]
            if math.isnan(h):
                continue
            low, high, known = np.inf, -np.inf, 0
            for k in range(4):
                beside = sure[ly + (k == 2) - (k == 3), lx + (k == 0) - (k == 1)]
                if not math.isnan(beside):
                    low, high, known = min(low, np.float64(beside)), max(high, np.float64(beside)), known + 1
            if known >= 3:
                sure[ly, lx] = min(max(h, low), high)


@jit_ieee
def judge_ground(ground, state, lows, highs, returns, first, size, step, steep, sure, slopes, excess, classes):
    """Find slopes, steps and steep ground. `slopes` float32 (2, m, m): rise per metre along x and y; `excess` float32 (m, m): how much higher the high of a cell lies
    than the ground of one at most three away, beyond what its own and the other's slope explain; `classes` uint8 (m, m). `sure` float32
    (m + 8, m + 8) is room to work in."""
    m = ground.shape[0]
    cell = 2.0 * size
    cx0, cy0 = first[0] // 2, first[1] // 2
    ox, oy = cx0 % m, cy0 % m
    _unroll(ground, state, returns, first, sure)
    for ly in range(m):
        for lx in range(m):
            y, x = wrapped(oy + ly, m), wrapped(ox + lx, m)
            excess[y, x] = 0.0
            slopes[0, y, x] = slopes[1, y, x] = 0.0
            classes[y, x] = UNKNOWN
            if state[y, x] != 1:
                continue
            classes[y, x] = GROUND
            py, px = ly + 4, lx + 4
            is_sure = returns[y, x] >= SURE
            h = np.float64(sure[py, px]) if is_sure else np.float64(ground[y, x])
            slope_x, rise_x, is_alone_x = _slopes(sure, py, px, 0, 1, h, cell)
            slope_y, rise_y, is_alone_y = _slopes(sure, py, px, 1, 0, h, cell)
            slopes[0, y, x], slopes[1, y, x] = slope_x, slope_y
            # Both ways: floor between two cars is not steep for the hood beside it.
            if rise_x * rise_x + rise_y * rise_y > steep * steep:
                classes[y, x] = STEEP
            if not is_sure:
                continue
            spread = np.float64(highs[y, x]) - np.float64(lows[y, x])
            top, most = h, 0.0
            if returns[y, x] >= 2.0 * SURE and spread > step:
                most = spread  # a kerb may fill a cell of which no floor is seen, nor any around it
            # A slope spreads the returns of a cell, too; where it is not known, nothing is known of the rest.
            if not is_alone_x and not is_alone_y:
                top += max(0.0, spread - SPREAD * cell * (abs(slope_x) + abs(slope_y)))
            most = max(most, _steps_along(sure, py, px, 0, 1, top, h, cell))
            most = max(most, _steps_along(sure, py, px, 1, 0, top, h, cell))
            excess[y, x] = most
    # A step is longer than two cells: fewer are noise.
    for ly in range(1, m - 1):
        for lx in range(1, m - 1):
            y, x = wrapped(oy + ly, m), wrapped(ox + lx, m)
            if not excess[y, x] > step:
                continue
            others = 0
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    if (dy != 0 or dx != 0) and excess[wrapped(y + dy, m), wrapped(x + dx, m)] > 0.6 * step:
                        others += 1
            if others < 2:
                excess[y, x] = 0.5 * step
            else:
                classes[y, x] = OBSTACLE


@jit_ieee
def find_drops(
    lows, returns, ground, state, origin, first, size, turn, step_out, depth, hidden_most, image, evidence, depths
):
    """March outwards from the sensor over seen ground and find where it ends above something lower.

    The ground before the end is continued by its slope, level where that rises. It ends in a drop where what is seen next, within `hidden_most` metres, lies
    lower than that by `depth`, or where rays in the direction of the hidden ground went on behind it. `evidence` uint8 (m, m) counts
    marches, `depths` float32 (m, m) how deep it is; every second direction is marched, in `turn`s.
    """
    m = ground.shape[0]
    cell = 2.0 * size
    cx0, cy0 = first[0] // 2, first[1] // 2
    ox, oy = cx0 % m, cy0 % m
    reach = 0.5 * m * cell
    for d in range(turn, DIRECTIONS, 2):
        a = (d + 0.5) / QUARTER
        quarter = int(a)
        f = a - quarter
        ux, uy = 1.0 - f, f
        if quarter == 1:
            ux, uy = -f, 1.0 - f
        elif quarter == 2:
            ux, uy = f - 1.0, -f
        elif quarter == 3:
            ux, uy = f, f - 1.0
        norm = math.sqrt(ux * ux + uy * uy)
        ux /= norm
        uy /= norm
        known = 0  # cells of the run of seen ground
        run_z = run_r = near_z = near_r = mid_z = mid_r = 0.0
        edge_y = edge_x = last_y = last_x = before_y = before_x = just_y = just_x = -1
        is_hidden = is_through = False
        through = below = 0
        first_off = first_z = first_r = 0.0
        r = 2.0 * cell
        while r < reach:
            r += step_out
            lx = int(math.floor((origin[0] + ux * r) / cell)) - cx0
            ly = int(math.floor((origin[1] + uy * r) / cell)) - cy0
            if lx < 0 or ly < 0 or lx >= m or ly >= m:
                break
            if ly == last_y and lx == last_x:
                continue
            last_y, last_x = ly, lx
            y, x = wrapped(oy + ly, m), wrapped(ox + lx, m)
            low = np.float64(lows[y, x])
            rise, unsure = 0.0, 0.015 if near_r > run_r + RUN else 0.1
            if known >= 3 and near_r > run_r + 0.3:
                rise = min(0.0, (near_z - run_z) / (near_r - run_r))  # what rises may level off behind a crest
            expected = near_z + rise * (r - near_r)
            is_below = known >= 3 and low < expected - depth - unsure * (r - near_r)
            if returns[y, x] < 0.6 * SURE and not is_below and not math.isnan(low):
                if known == 0 and state[y, x] == 1:  # too little is known of it to go by, enough to begin with
                    known, run_z, run_r, mid_z, mid_r, near_z, near_r = 1, low, r, low, r, low, r
                continue
            if state[y, x] == 1 and not is_below:
                if is_hidden:
                    if abs(low - expected) >= depth:
                        known = 0  # rays may have passed over it: it falls
                    elif is_through:
                        _count_drop(evidence, depths, edge_y, edge_x, 2.0 * depth)
                    elif evidence[edge_y, edge_x] > 0:
                        evidence[edge_y, edge_x] -= 1  # it goes on as it was
                    is_hidden = False
                # The run remembers where it was 0.8 to 1.6 m before: shorter ones have no slope to go by.
                if known == 0:
                    run_z, run_r, mid_z, mid_r = low, r, low, r
                elif r - mid_r > RUN:
                    run_z, run_r, mid_z, mid_r = mid_z, mid_r, low, r
                near_z, near_r = low, r
                known += 1
                # Where it goes on as ground for two cells more there is no drop; few directions say so, for many run along an edge.
                if before_y >= 0 and evidence[before_y, before_x] > 0 and d & 6 == 0:
                    evidence[before_y, before_x] -= 1
                before_y, before_x, just_y, just_x = just_y, just_x, y, x
                continue
            before_y = before_x = just_y = just_x = -1
            if known < 3:
                known = 0
                continue
            if not is_hidden:
                is_hidden, edge_y, edge_x, through, below, is_through = True, y, x, 0, 0, False
            if not math.isnan(low):
                off = expected - low
                is_lower = off > depth + unsure * (r - near_r) and r - near_r <= hidden_most + cell
                if is_lower and below == 0:
                    below, first_off, first_z, first_r = 1, off, low, r  # one cell may be noise
                    continue
                is_ramp = first_off < RAMP * (first_r - near_r) + depth
                if is_lower and below == 1 and is_ramp:
                    below = 2
                    continue
                fall = (first_z - low) / (r - first_r)
                if is_lower and not (is_ramp and fall > 0.08 and first_off - fall * (first_r - near_r) < depth):
                    _count_drop(evidence, depths, edge_y, edge_x, off)
                known = 0
                is_hidden = False
                continue
            if r - near_r > hidden_most or (is_through and r - near_r > BRIDGE):
                if is_through:
                    _count_drop(evidence, depths, edge_y, edge_x, 2.0 * depth)
                known = 0
                is_hidden = False
                continue
            row = int(math.floor(((expected - 2.0 * depth - origin[2]) / r - ROW_LOW) / ROW))
            if 0 <= row < ROWS:
                nearest = image[d, row]
                if nearest < np.inf and nearest > r + 1.0 + 0.2 * r:
                    through += 1
                    is_through = through >= 2


@jit_ieee
def _count_drop(evidence, depths, y, x, depth):
    """Count a march that shows a drop of `depth` (m) at a cell."""
    evidence[y, x] = min(EVIDENCE_MOST, evidence[y, x] + 2)
    depths[y, x] = depth


@jit_ieee
def mark_edges(evidence, wanted, excess, step, classes):
    """Mark the cells for whose drop there is enough evidence, and join what belongs to marked edges: beside a drop a third of the evidence is
    enough, beside a step a third of its height. An edge that is marked with holes in it is none for a planner."""
    m = evidence.shape[0]
    for y in range(m):
        for x in range(m):
            if evidence[y, x] >= wanted and classes[y, x] != OBSTACLE:
                classes[y, x] = DROP
    for _ in range(3):
        for y in range(1, m - 1):
            for x in range(1, m - 1):
                kind = classes[y, x]
                if kind not in (DROP, OBSTACLE):
                    continue
                for dy in range(-1, 2):
                    for dx in range(-1, 2):
                        beside = classes[y + dy, x + dx]
                        if beside not in (GROUND, UNKNOWN):
                            continue
                        if kind == DROP and 3 * evidence[y + dy, x + dx] >= wanted:
                            classes[y + dy, x + dx] = JOINED_DROP
                        elif kind == OBSTACLE and beside == GROUND and excess[y + dy, x + dx] > 0.35 * step:
                            classes[y + dy, x + dx] = JOINED_STEP
                            excess[y + dy, x + dx] = 1.01 * step
        for y in range(m):
            for x in range(m):
                if classes[y, x] == JOINED_DROP:
                    classes[y, x] = DROP
                elif classes[y, x] == JOINED_STEP:
                    classes[y, x] = OBSTACLE
    _close_holes(evidence, excess, step, classes)


@jit_ieee
def _close_holes(evidence, excess, step, classes):
    """Close the holes of up to `CLOSED` cells in edges, unless half of one is seen to be level ground.

    Level ground is never filled, so that it does not change what is closed in which order.
    """
    m = classes.shape[0]
    wide = m + 2 * CLOSED
    parts = np.zeros(wide * wide, np.uint8)  # with a rim, so that no line leaves it
    for y in range(m):
        for x in range(m):
            kind = classes[y, x]
            if kind == GROUND:
                kind = LEVEL if excess[y, x] < 0.2 * step and evidence[y, x] == 0 else UNEVEN
            elif kind == UNKNOWN:
                kind = UNSEEN
            parts[(y + CLOSED) * wide + x + CLOSED] = kind
    lines = LINES[:, :, 0] * wide + LINES[:, :, 1]
    for y in range(m):
        for x in range(m):
            here = (y + CLOSED) * wide + x + CLOSED
            kind = parts[here]
            if kind not in (DROP, OBSTACLE):
                continue
            for k in range(lines.shape[0]):
                if parts[here + lines[k, 0]] != kind:
                    continue
                level = missing = 0
                for i in range(1, LENGTHS[k]):
                    part = parts[here + lines[k, i]]
                    level += part == LEVEL
                    missing += part == UNEVEN or (part == UNSEEN and kind == DROP)
                if missing == 0 or 2 * level > LENGTHS[k]:
                    continue
                for i in range(1, LENGTHS[k]):
                    part = parts[here + lines[k, i]]
                    if part == UNEVEN or (part == UNSEEN and kind == DROP):
                        parts[here + lines[k, i]] = CLOSED_NOW
                        qy, qx = y + LINES[k, i, 0], x + LINES[k, i, 1]
                        classes[qy, qx] = kind
                        if kind == OBSTACLE:
                            excess[qy, qx] = max(np.float64(excess[qy, qx]), 1.01 * step)


@jit_ieee
def _column_low(voxels, mask, iy, ix):
    """Return the height of a column's lowest voxel, NaN when it has none."""
    low = np.inf
    m = mask[iy, ix]
    while m != 0:
        b = lowest_bit(m)
        m &= ~(np.uint32(1) << np.uint32(b))
        low = min(low, voxels[iy, ix, b, Z])
    return low if low < np.inf else np.nan


@jit_ieee
def find_stairs(ground, state, first, size, voxels, mask, classes):
    """Call steep ground stairs where at least three rises of 10 to 25 cm follow one another with level treads between them."""
    m, n = ground.shape[0], mask.shape[0]
    cell = 2.0 * size
    cx0, cy0 = first[0] // 2, first[1] // 2
    ox, oy = cx0 % m, cy0 % m
    for ly in range(3, m - 3):
        for lx in range(3, m - 3):
            y, x = wrapped(oy + ly, m), wrapped(ox + lx, m)
            if classes[y, x] != STEEP and classes[y, x] != OBSTACLE:
                continue
            gx = (_seen(ground, state, y, x + 2, m) - _seen(ground, state, y, x - 2, m)) / (4.0 * cell)
            gy = (_seen(ground, state, y + 2, x, m) - _seen(ground, state, y - 2, x, m)) / (4.0 * cell)
            if math.isnan(gx) and math.isnan(gy):
                continue
            gx, gy = (0.0 if math.isnan(gx) else gx), (0.0 if math.isnan(gy) else gy)
            rise = math.sqrt(gx * gx + gy * gy)
            if not 0.3 < rise < 1.1:
                continue
            gx, gy = gx / rise, gy / rise
            rises = treads = between = 0
            level = 0.0
            tread = 0
            begun = False
            for k in range(-10, 11):
                px = (cx0 + lx + 0.5) * cell + gx * k * size
                py = (cy0 + ly + 0.5) * cell + gy * k * size
                ix, iy = int(math.floor(px / size)), int(math.floor(py / size))
                if not (0 <= ix - first[0] < n and 0 <= iy - first[1] < n):
                    continue
                z = _column_low(voxels, mask, iy % n, ix % n)
                if math.isnan(z):
                    continue
                if not begun:
                    begun, level, tread = True, z, 1
                elif abs(z - level) < 0.04:
                    tread += 1
                elif 0.09 < z - level < 0.26:
                    rises += 1
                    treads += 1 if tread >= 2 else 0
                    level, tread = z, 1
                elif abs(z - level) >= 0.26:
                    level, tread = z, 1
                else:
                    between += 1  # a slope rises here
            if rises >= 3 and treads >= rises - 1 and between < rises:
                classes[y, x] = STAIRS


@jit_ieee
def gather(ground, state, gap, slopes, excess, depths, classes, first, size, limits, voxels, mask, out, kinds):
    """Write the terrain as points with their height above the ground, float32 (N, 4), and what they are, `kinds` uint8
    (N,): the class of a cell, 0 for a voxel; returns how many.

    A cell of ground is a point in its middle: what is not crossable there (step, drop, rise over 0.8 m) stands in the place of 0. Voxels
    from `limits[0]` to `limits[1]` metres above the ground under them are points of their own. `limits[2]`: 1 when stairs are no
    obstacle; where no ground is seen, what may be ground for all that is known of it (`limits[3]` and `limits[4]` for each metre of the gap) is no obstacle.
    """
    m = ground.shape[0]
    cell = 2.0 * size
    cx0, cy0 = first[0] // 2, first[1] // 2
    ox, oy = cx0 % m, cy0 % m
    low_most, high_most, climbs, slack, tilt = limits
    count = 0
    for ly in range(m):
        for lx in range(m):
            y, x = wrapped(oy + ly, m), wrapped(ox + lx, m)
            kind = classes[y, x]
            is_stairs = kind == STAIRS and climbs > 0.5
            g = np.float64(ground[y, x])
            px, py = (cx0 + lx + 0.5) * cell, (cy0 + ly + 0.5) * cell
            if (kind != UNKNOWN) and count < out.shape[0]:
                value = 0.0
                if kind == DROP:
                    value = max(np.float64(depths[y, x]), low_most * 1.01)
                elif kind == OBSTACLE:
                    value = excess[y, x]
                elif kind == STEEP or (kind == STAIRS and not is_stairs):
                    value = low_most * 2.0
                elif is_stairs:
                    value = low_most * 0.5
                else:
                    value = min(max(0.0, np.float64(excess[y, x])), low_most * 0.99)
                out[count, 0], out[count, 1], out[count, 2] = px, py, g if not math.isnan(g) else 0.0
                out[count, 3] = value
                kinds[count] = kind
                count += 1
            if math.isnan(g):
                continue
            least = low_most if state[y, x] == 1 else low_most + slack + tilt * gap[y, x] * cell
            for q in range(4):
                iy, ix = 2 * y + (q >> 1), 2 * x + (q & 1)
                bits = mask[iy, ix]
                if bits == 0:
                    continue
                ex, ey = ((q & 1) - 0.5) * size, ((q >> 1) - 0.5) * size
                under = g + ex * slopes[0, y, x] + ey * slopes[1, y, x]
                while bits != 0:
                    b = lowest_bit(bits)
                    bits &= ~(np.uint32(1) << np.uint32(b))
                    z = np.float64(voxels[iy, ix, b, Z])
                    h = z - under
                    if (
                        h <= least
                        or h >= high_most
                        or voxels[iy, ix, b, COUNT] < (LOW_RETURNS if h < 2.0 * low_most else 2.0)
                    ):
                        continue
                    if (is_stairs and h < 0.3) or count >= out.shape[0]:
                        continue
                    out[count, 0], out[count, 1], out[count, 2], out[count, 3] = px + ex, py + ey, z, h
                    kinds[count] = UNKNOWN
                    count += 1
                    if classes[y, x] != DROP:
                        classes[y, x] = OBSTACLE
    return count


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    n = 16
    m = n // 2
    voxels, mask = np.zeros((n, n, BINS, 4), np.float32), np.zeros((n, n), np.uint32)
    mask[3, 3] = 1
    lows, ground = np.zeros((m, m), np.float32), np.empty((m, m), np.float32)
    state, gap = np.empty((m, m), np.uint8), np.empty((m, m), np.int32)
    queue, later = np.empty(2 * m * m, np.int32), np.empty(m * m, np.int32)
    first, base = np.zeros(2, np.int64), np.array([0.8, 0.8, 0.0])
    evidence, known = np.zeros((m, m), np.uint8), (lows, lows.copy(), lows.copy(), lows.copy())
    grow_ground(
        *known, evidence, evidence.copy(), base, first, 0.1, 0.3, 0.2, 0.1, 0.07, 10, ground, state, gap, queue, later
    )
    slopes, excess, depths = np.empty((2, m, m), np.float32), np.empty((m, m), np.float32), np.zeros((m, m), np.float32)
    classes = np.empty((m, m), np.uint8)
    judge_ground(
        ground,
        state,
        lows,
        lows,
        lows,
        first,
        0.1,
        0.08,
        0.4,
        np.empty((m + 8, m + 8), np.float32),
        slopes,
        excess,
        classes,
    )
    image = np.full((DIRECTIONS, ROWS), np.inf, np.float32)
    find_drops(lows, lows, ground, state, base, first, 0.1, 0, 0.1, 0.06, 1.5, image, evidence, depths)
    mark_edges(evidence, 6, excess, 0.08, classes)
    find_stairs(ground, state, first, 0.1, voxels, mask, classes)
    limits, out = np.array([0.08, 1.0, 0.0, 0.1, 0.07]), np.empty((m * m, 4), np.float32)
    gather(
        ground,
        state,
        gap,
        slopes,
        excess,
        depths,
        classes,
        first,
        0.1,
        limits,
        voxels,
        mask,
        out,
        np.empty(m * m, np.uint8),
    )
