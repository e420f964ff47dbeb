"""Kernels of the plan that is cut out of a cloud: the floor followed from cell to cell, and what lies open to the eye over it.

Grids are [iy, ix], row 0 at the lowest y.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit

SKIN = 0.1  # metres above the lowest point near the floor that still are floor


@jit
def follow_floor(first, heights, seeds, climb, gap, floor, gaps):
    """Spread the floor over cells as a flood does: `heights` float32 (N,) ascending within each cell, those of cell c from first[c] to first[c + 1];
    `floor` float32 (h, w) holds the heights of the cells `seeds` int64 (S,), NaN elsewhere, and is filled. From one cell to the next it climbs by at most
    `climb`, and across at most `gap` cells in which there is nothing at its height; `gaps` int32 (h, w), 0, says how many of them led to a cell."""
    rows, columns = floor.shape
    queue = np.empty(rows * columns + seeds.shape[0], np.int64)
    count = 0
    for s in seeds:
        queue[count] = s
        count += 1
    at = 0
    while at < count:
        cell = queue[at]
        at += 1
        iy, ix = cell // columns, cell % columns
        here = floor[iy, ix]
        for k in range(4):
            jy = iy + (1 if k == 0 else -1 if k == 1 else 0)
            jx = ix + (1 if k == 2 else -1 if k == 3 else 0)
            if jy < 0 or jx < 0 or jy >= rows or jx >= columns or not math.isnan(floor[jy, jx]):
                continue
            other = jy * columns + jx
            lowest, total, n = np.float64(0.0), np.float64(0.0), 0
            for p in range(first[other], first[other + 1]):
                z = np.float64(heights[p])
                if z < here - climb:
                    continue
                if n == 0:
                    if z > here + climb:
                        break
                    lowest = z
                if z > lowest + SKIN:
                    break
                total += z
                n += 1
            if n > 0:
                floor[jy, jx] = np.float32(total / n)
            elif gaps[iy, ix] < gap:
                floor[jy, jx] = here
                gaps[jy, jx] = gaps[iy, ix] + 1
            else:
                continue
            queue[count] = other
            count += 1


@jit
def see(occupied, floor_seen, eyes, reach, free):
    """Set `free` bool (h, w) along rays in all directions from `eyes` float64 (E, 2), in cells: up to the last cell whose floor was seen (`floor_seen`)
    before the first that is `occupied`, at most `reach` cells away."""
    rows, columns = occupied.shape
    rays = int(math.ceil(2.0 * math.pi * reach))
    for e in range(eyes.shape[0]):
        for r in range(rays):
            angle = 2.0 * math.pi * r / rays
            dx, dy = math.cos(angle), math.sin(angle)
            last = -1
            end = int(reach)
            for j in range(int(reach)):
                ix, iy = int(math.floor(eyes[e, 0] + j * dx)), int(math.floor(eyes[e, 1] + j * dy))
                if ix < 0 or iy < 0 or ix >= columns or iy >= rows or (occupied[iy, ix] and j > 0):
                    end = j
                    break
                if floor_seen[iy, ix]:
                    last = j
            for j in range(min(last + 1, end)):
                ix, iy = int(math.floor(eyes[e, 0] + j * dx)), int(math.floor(eyes[e, 1] + j * dy))
                free[iy, ix] = True


def warm_up() -> None:
    """Compile or load every kernel with its real argument types."""
    floor = np.full((2, 2), np.nan, np.float32)
    floor[0, 0] = 0.0
    first = np.array([0, 1, 2, 2, 2], np.int64)
    follow_floor(first, np.zeros(2, np.float32), np.zeros(1, np.int64), 0.3, 2, floor, np.zeros((2, 2), np.int32))
    no = np.zeros((2, 2), np.bool_)
    see(no, ~no, np.zeros((1, 2)), 2.0, no.copy())
