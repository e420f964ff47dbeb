"""Flights of stairs in the terrain around a robot.

Arrays (m, m) of cells roll with the robot as the columns of `terrain_columns` do: row and column of a cell are its numbers modulo m.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit_ieee
from ambler.kernels.terrain_columns import BINS, Z, lowest_bit, wrapped
from ambler.kernels.terrain_ground import OBSTACLE, STAIRS, STEEP


@jit_ieee
def _seen(ground, state, qy, qx, m):
    """Return the height of seen ground at a cell (modulo m), else NaN."""
    y, x = wrapped(qy, m), wrapped(qx, m)
    return np.float64(ground[y, x]) if state[y, x] == 1 else np.nan


@jit_ieee
def _column_low(voxels, mask, iy, ix):
    """Return the height of a column's lowest voxel, NaN when it has none."""
    low = np.inf
    m = mask[iy, ix]
    while m != 0:
        b = lowest_bit(m)
        m &= ~(np.uint32(1) << np.uint32(b))
        low = min(low, voxels[b, iy, ix, Z])
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


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    n = 16
    m = n // 2
    voxels, mask = np.zeros((BINS, n, n, 4), np.float32), np.zeros((n, n), np.uint32)
    ground, state, classes = np.zeros((m, m), np.float32), np.ones((m, m), np.uint8), np.ones((m, m), np.uint8)
    find_stairs(ground, state, np.zeros(2, np.int64), 0.1, voxels, mask, classes)
