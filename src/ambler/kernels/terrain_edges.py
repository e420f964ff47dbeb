"""Edges of the terrain around a robot: where ground ends above something lower, and what belongs to one edge.

Arrays (m, m) of cells roll with the robot as the columns of `terrain_columns` do: row and column of a cell are its numbers modulo m.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit_ieee
from ambler.kernels.terrain_columns import DIRECTIONS, QUARTER, ROW, ROW_LOW, ROWS, wrapped
from ambler.kernels.terrain_ground import DROP, GROUND, OBSTACLE, REMEMBERED, SURE, UNKNOWN

JOINED_DROP, JOINED_STEP = 8, 9  # only within `mark_edges`
LEVEL, UNEVEN, UNSEEN, CLOSED_NOW = 16, 17, 18, 19  # only within `_close_holes`
CLOSED = 6  # cells of a hole in an edge that are closed: no robot is as narrow as that
EVIDENCE_MOST = 12
RUN = 0.8  # metres over which seen ground tells its slope; after shorter runs it may go on by 0.1 lower for each metre
RAMP = 0.45  # the steepest fall behind an edge that may be a ramp
SEAM = 0.08  # metres that ground beside remembered ground may lie lower: what odometry drifts between two visits
BRIDGE = 0.9  # metres behind an edge that are hidden where rays pass above what follows: beyond, it is a drop


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
    x0, y0, inverse = origin[0] - cx0 * cell, origin[1] - cy0 * cell, 1.0 / cell
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
        is_hidden = is_through = is_old = False
        through = below = 0
        first_off = first_z = first_r = 0.0
        r = 2.0 * cell
        while r < reach:
            r += step_out
            lx, ly = int(math.floor((x0 + ux * r) * inverse)), int(math.floor((y0 + uy * r) * inverse))
            if lx < 0 or ly < 0 or lx >= m or ly >= m:
                break
            if ly == last_y and lx == last_x:
                continue
            last_y, last_x = ly, lx
            y, x = wrapped(oy + ly, m), wrapped(ox + lx, m)
            low = np.float64(lows[y, x])
            least = depth + SEAM if is_old or returns[y, x] == REMEMBERED else depth
            rise, unsure = 0.0, 0.015 if near_r > run_r + RUN else 0.1
            if known >= 3 and near_r > run_r + 0.3:
                rise = min(0.0, (near_z - run_z) / (near_r - run_r))  # what rises may level off behind a crest
            expected = near_z + rise * (r - near_r)
            is_below = known >= 3 and low < expected - least - unsure * (r - near_r)
            if returns[y, x] < 0.6 * SURE and not is_below and not math.isnan(low):
                if known == 0 and state[y, x] == 1:  # too little is known of it to go by, enough to begin with
                    known, run_z, run_r, mid_z, mid_r, near_z, near_r = 1, low, r, low, r, low, r
                    is_old = False
                continue
            if state[y, x] == 1 and not is_below:
                if is_hidden:
                    if abs(low - expected) >= least:
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
                near_z, near_r, is_old = low, r, returns[y, x] == REMEMBERED
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
                is_lower = off > least + unsure * (r - near_r) and r - near_r <= hidden_most + cell
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
                nearest = image[d, row, 0]
                if nearest < np.inf and nearest > r + 1.0 + 0.2 * r:
                    through += 1
                    is_through = through >= 2


@jit_ieee
def _count_drop(evidence, depths, y, x, depth):
    """Count a march that shows a drop of `depth` (m) at a cell."""
    evidence[y, x] = min(EVIDENCE_MOST, evidence[y, x] + 2)
    depths[y, x] = depth


@jit_ieee
def _laid_out(cells, cx0, cy0):
    """Return the cells in the order of their places, the window's first one first."""
    m = cells.shape[0]
    out = np.empty_like(cells)
    for y in range(m):
        row = wrapped(y + cy0, m)
        out[y, : m - cx0], out[y, m - cx0 :] = cells[row, cx0:], cells[row, :cx0]
    return out


@jit_ieee
def mark_edges(rolled_evidence, wanted, rolled_excess, step, first, rolled_classes):
    """Mark the cells for whose drop there is enough evidence, and join what belongs to marked edges: beside a drop a third of the evidence is
    enough, beside a step a third of its height. An edge that is marked with holes in it is none for a planner. What is joined keeps its own
    `excess`: taken for a step, it would stay one and join what lies beside it the next time. `first` int64 (2,) is the window's first voxel, of which two
    are a cell: cells at opposite ends of the window are not beside each other, although they may be so in the rolled arrays."""
    m = rolled_classes.shape[0]
    cx0, cy0 = (first[0] // 2) % m, (first[1] // 2) % m
    evidence, excess = _laid_out(rolled_evidence, cx0, cy0), _laid_out(rolled_excess, cx0, cy0)
    classes = _laid_out(rolled_classes, cx0, cy0)
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
        for y in range(m):
            for x in range(m):
                if classes[y, x] == JOINED_DROP:
                    classes[y, x] = DROP
                elif classes[y, x] == JOINED_STEP:
                    classes[y, x] = OBSTACLE
    _close_holes(evidence, excess, step, classes)
    rolled_classes[:] = _laid_out(classes, (m - cx0) % m, (m - cy0) % m)


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


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    m = 8
    lows, state = np.zeros((m, m), np.float32), np.ones((m, m), np.uint8)
    evidence, depths, excess = np.zeros((m, m), np.uint8), np.zeros((m, m), np.float32), np.zeros((m, m), np.float32)
    first, origin = np.zeros(2, np.int64), np.array([0.8, 0.8, 0.0])
    image = np.full((DIRECTIONS, ROWS, 2), np.inf, np.float32)
    seen = (lows, lows, lows.copy(), state)
    find_drops(*seen, origin, first, 0.1, 0, 0.1, 0.06, 1.5, image, evidence, depths)
    mark_edges(evidence, 6, excess, 0.08, first, state)
