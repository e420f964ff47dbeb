"""Slopes, steps and steep ground of the terrain around a robot: every cell of ground beside those around it.

Arrays (m, m) of cells roll with the robot as the columns of `terrain_columns` do: row and column of a cell are its numbers modulo m.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit_ieee
from ambler.kernels.terrain_columns import wrapped
from ambler.kernels.terrain_ground import GROUND, OBSTACLE, STEEP, SURE, UNKNOWN

HOLD = 0.5  # of a step above which what was one stays one: its edge is seen by few returns, and by fewer from near
SPREAD = 0.65  # of a cell's side lies between the places where a slope has the low and the high of the cell


@jit_ieee
def _lesser(a, b):
    """The smaller of two slopes of one sign, 0 for two signs; where one is not known the other."""
    a, b = b if math.isnan(a) else a, a if math.isnan(b) else b
    lesser = a if abs(a) < abs(b) else b
    return lesser if a * b > 0.0 else 0.0


@jit_ieee
def _step_down(h, beside, two_on, three_on, four_on, own_rise):
    """Return how much lower than the upper side `h` of a cell the ground lies one to three cells on, beyond what a break between the slopes of the two sides explains.

    Over three cells, because the noise of a kerb's face spreads over two; each cell more asks for a centimetre and a half more. `own_rise`
    is the rise per cell towards the lower side, of this side; NaN where it is not known.
    """
    beyond = 0.5 * (two_on - four_on)
    if math.isnan(beyond):  # the rim of what is seen, and ground that is seen with holes
        beyond = beside - two_on if math.isnan(three_on) else two_on - three_on
    if math.isnan(beyond):
        beyond = three_on - four_on
    fall = -own_rise if own_rise < 0.0 else 0.0
    fall = beyond if beyond > fall else fall
    # What is not known is NaN, and no comparison with that holds.
    one, two, three = h - beside - fall, h - two_on - 2.0 * fall - 0.015, h - three_on - 3.0 * fall - 0.03
    most = one if one > 0.0 else 0.0
    most = two if two > most else most
    return three if three > most else most


@jit_ieee
def _slopes(sure, y, x, dy, dx, h, cell):
    """Return the slope of a cell of height `h` along an axis from the cells beside it, its rise over two, and whether neither neighbour is known."""
    ahead, behind = np.float64(sure[y + dy, x + dx]), np.float64(sure[y - dy, x - dx])
    ahead2, behind2 = np.float64(sure[y + 2 * dy, x + 2 * dx]), np.float64(sure[y - 2 * dy, x - 2 * dx])
    slope, rise = _lesser(ahead - h, h - behind) / cell, _lesser(ahead2 - h, h - behind2) / (2.0 * cell)
    return slope, rise, math.isnan(ahead) and math.isnan(behind)


@jit_ieee
def _own_rise(h, behind, behind2, behind3, behind4):
    """Return the rise per cell up to a cell of height `h` from the ground behind it: over two cells, or over as many as there are to the nearest farther one that
    is known; NaN where none is. A slope that is seen with holes is no row of steps."""
    if not math.isnan(behind2):
        return 0.5 * (h - behind2)
    if not math.isnan(behind3):
        return (h - behind3) / 3.0
    if not math.isnan(behind4):
        return 0.25 * (h - behind4)
    return h - behind


@jit_ieee
def _steps_along(sure, y, x, dy, dx, top, h):
    """Return the larger of the two steps down from a cell's `top` along an axis; `h` is the height of its ground."""
    ahead, behind = np.float64(sure[y + dy, x + dx]), np.float64(sure[y - dy, x - dx])
    ahead2, behind2 = np.float64(sure[y + 2 * dy, x + 2 * dx]), np.float64(sure[y - 2 * dy, x - 2 * dx])
    ahead3, behind3 = np.float64(sure[y + 3 * dy, x + 3 * dx]), np.float64(sure[y - 3 * dy, x - 3 * dx])
    ahead4, behind4 = np.float64(sure[y + 4 * dy, x + 4 * dx]), np.float64(sure[y - 4 * dy, x - 4 * dx])
    forth = _step_down(top, ahead, ahead2, ahead3, ahead4, _own_rise(h, behind, behind2, behind3, behind4))
    back = _step_down(top, behind, behind2, behind3, behind4, _own_rise(h, ahead, ahead2, ahead3, ahead4))
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
def _is_changed(changed, y, x):
    """Return whether something came or went in a cell (modulo m) or within two of it."""
    m = changed.shape[0]
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            if changed[wrapped(y + dy, m), wrapped(x + dx, m)] != 0:
                return True
    return False


@jit_ieee
def judge_ground(ground, state, lows, highs, returns, changed, first, size, step, steep, sure, slopes, excess, classes):
    """Find slopes, steps and steep ground. `slopes` float32 (2, m, m): rise per metre along x and y; `excess` float32 (m, m): how much higher the high of a cell lies
    than the ground of one at most three away, beyond what its own and the other's slope explain; `classes` uint8 (m, m). `sure` float32
    (m + 8, m + 8) is room to work in. Where nothing `changed` uint8 (m, m), a step stays one."""
    m = ground.shape[0]
    cell = 2.0 * size
    cx0, cy0 = first[0] // 2, first[1] // 2
    ox, oy = cx0 % m, cy0 % m
    _unroll(ground, state, returns, first, sure)
    for ly in range(m):
        for lx in range(m):
            y, x = wrapped(oy + ly, m), wrapped(ox + lx, m)
            before = np.float64(excess[y, x])
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
            # Who comes too near to see a kerb still knows it: what is judged anew without being seen anew only loses.
            held = before if before > step and not _is_changed(changed, y, x) else 0.0
            if held > 0.0:
                classes[y, x] = OBSTACLE
            if not is_sure:
                excess[y, x] = held
                continue
            spread = np.float64(highs[y, x]) - np.float64(lows[y, x])
            top, most = h, held
            if returns[y, x] >= 2.0 * SURE and spread > step:
                most = max(most, spread)  # a kerb may fill a cell of which no floor is seen, nor any around it
            # A slope spreads the returns of a cell, too; where it is not known, nothing is known of the rest.
            if not is_alone_x and not is_alone_y:
                top += max(0.0, spread - SPREAD * cell * (abs(slope_x) + abs(slope_y)))
            most = max(most, _steps_along(sure, py, px, 0, 1, top, h))
            most = max(most, _steps_along(sure, py, px, 1, 0, top, h))
            if before > step and HOLD * step < most:
                most = max(most, before)
                classes[y, x] = OBSTACLE
            excess[y, x] = most
    # A step is longer than two cells: fewer are noise.
    for ly in range(1, m - 1):
        for lx in range(1, m - 1):
            y, x = wrapped(oy + ly, m), wrapped(ox + lx, m)
            if not excess[y, x] > step or classes[y, x] == OBSTACLE:
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


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    m = 8
    lows, sure = np.zeros((m, m), np.float32), np.empty((m + 8, m + 8), np.float32)
    slopes, excess, classes = np.empty((2, m, m), np.float32), np.empty((m, m), np.float32), np.empty((m, m), np.uint8)
    seen, first = (lows.copy(), np.ones((m, m), np.uint8)), np.zeros(2, np.int64)
    judge_ground(*seen, lows, lows, lows, classes.copy(), first, 0.1, 0.08, 0.4, sure, slopes, excess, classes)
