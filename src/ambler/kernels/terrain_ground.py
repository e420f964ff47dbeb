"""Ground out of the lows of cells: what is joined to the place where the robot stands; and the terrain as points.

Arrays (m, m) of cells roll with the robot as the columns of `terrain_columns` do: row and column of a cell are its numbers modulo m.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit_ieee
from ambler.kernels.terrain_columns import BINS, COUNT, Z, lowest_bit, wrapped

UNKNOWN, GROUND, OBSTACLE, DROP, STEEP, STAIRS = 0, 1, 2, 3, 4, 5
SURE = 7.0  # returns from which on the height of a cell is sure to some centimetres
REMEMBERED = 6.5  # "returns" of ground that is remembered, not seen: it tells of drops behind it, but its height is of another time, so where it ends is no step
UNDER = 1.2  # metres below the robot from which on remembered ground may lie under a deck that it has not seen yet
LOW_RETURNS = 5.0  # that make a low obstacle: beams between two surfaces lie near the floor


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

    Where too little is seen now, `memory` (m, m) of ground that is known to be firm, NaN elsewhere, stands for it where it continues the ground, and the `evidence` for a drop is void, unless it lies `UNDER` the robot; `touched` uint8 (m, m)
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
            if known < base[2] - UNDER:
                known = np.nan
            if not math.isnan(known):
                joined = climb if state[py, px] == 1 else slack + tilt * (wide + 1) * cell
                is_poor = math.isnan(low) or (returns[qy, qx] < SURE and abs(low - known) <= climb)
                if is_poor and abs(known - z) <= joined:
                    low = lows[qy, qx] = highs[qy, qx] = known
                    returns[qy, qx] = REMEMBERED
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
                    value = max(np.float64(excess[y, x]), low_most * 1.01)
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
                    z = np.float64(voxels[b, iy, ix, Z])
                    h = z - under
                    if (
                        h <= least
                        or h >= high_most
                        or voxels[b, iy, ix, COUNT] < (LOW_RETURNS if h < 2.0 * low_most else 2.0)
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
    voxels, mask = np.zeros((BINS, n, n, 4), np.float32), np.zeros((n, n), np.uint32)
    mask[3, 3] = 1
    lows, ground = np.zeros((m, m), np.float32), np.empty((m, m), np.float32)
    state, gap = np.empty((m, m), np.uint8), np.empty((m, m), np.int32)
    queue, later = np.empty(2 * m * m, np.int32), np.empty(m * m, np.int32)
    first, base = np.zeros(2, np.int64), np.array([0.8, 0.8, 0.0])
    evidence, known = np.zeros((m, m), np.uint8), (lows, lows.copy(), lows.copy(), lows.copy())
    touched = evidence.copy()
    grow_ground(*known, evidence, touched, base, first, 0.1, 0.3, 0.2, 0.1, 0.07, 10, ground, state, gap, queue, later)
    slopes, excess, depths = np.zeros((2, m, m), np.float32), np.zeros((m, m), np.float32), np.zeros((m, m), np.float32)
    classes, kinds = np.ones((m, m), np.uint8), np.empty(m * m, np.uint8)
    limits, out = np.array([0.08, 1.0, 0.0, 0.1, 0.07]), np.empty((m * m, 4), np.float32)
    judged = (ground, state, gap, slopes, excess, depths, classes)
    gather(*judged, first, 0.1, limits, voxels, mask, out, kinds)
