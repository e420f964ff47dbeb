"""Scan insertion in plain Python and exact fractions, the twin of the kernel."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ambler.grids.probability_grid import InsertionConfig, ProbabilityGrid

Cell = tuple[int, int]


def in_cells(points: NDArray[np.floating], frame: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return float64 (N, 2) coordinates (x, y) in cells, in the kernel's own order of operations."""
    return np.asarray((points.astype(np.float64) - frame[1:]) * (1.0 / frame[0]))


def cells_of_segment(start: NDArray[np.float64], end: NDArray[np.float64]) -> list[Cell]:
    """Return the cells (iy, ix) that a segment in cell coordinates crosses, its end cell excluded, by exact arithmetic.

    Through a corner of the lattice the way leads by the cell above or below.
    """
    x0, y0, x1, y1 = (Fraction(float(v)) for v in (*start, *end))
    ix, iy, ex, ey = (math.floor(v) for v in (x0, y0, x1, y1))
    crossings: list[tuple[Fraction, int, Cell]] = []
    for axis, (a, b, ia, ib) in enumerate(((y0, y1, iy, ey), (x0, x1, ix, ex))):
        sign = 1 if ib > ia else -1
        borders = range(ia + 1, ib + 1) if sign > 0 else range(ia, ib, -1)
        step = (sign, 0) if axis == 0 else (0, sign)
        crossings += [((border - a) / (b - a), axis, step) for border in borders]
    cells = [(iy, ix)]
    for _, _, step in sorted(crossings):
        cells.append((cells[-1][0] + step[0], cells[-1][1] + step[1]))
    assert cells[-1] == (ey, ex)
    return cells[:-1]


def clipped_length(start: NDArray[np.float64], end: NDArray[np.float64], cell: Cell, grow: float) -> float:
    """Return which share of a segment lies inside a cell enlarged by `grow` cells on each side; negative when it misses it."""
    low, high = 0.0, 1.0
    for a, b, i in ((start[0], end[0], cell[1]), (start[1], end[1], cell[0])):
        near, far = i - grow, i + 1 + grow
        if a == b:
            if not near <= a <= far:
                return -1.0
            continue
        t0, t1 = sorted(((near - a) / (b - a), (far - a) / (b - a)))
        low, high = max(low, t0), min(high, t1)
    return high - low


def observe(p: float, value: int) -> int:
    """Return the new value of a cell that is observed with probability `p`."""
    if value == 0:
        new = p
    else:
        old = 0.1 + 0.8 * (value - 1) / 32766
        odds = p / (1 - p) * old / (1 - old)
        new = odds / (1 + odds)
    return round((min(max(new, 0.1), 0.9) - 0.1) / 0.8 * 32766) + 1


def insert_slowly(
    grid: ProbabilityGrid,
    config: InsertionConfig,
    origin: NDArray[np.float64],
    points: NDArray[np.float32],
    free_points: NDArray[np.float32],
) -> set[Cell]:
    """Insert a scan into a grid that is large enough: hits first, then misses, once per cell; returns the changed cells."""
    start = in_cells(origin[None], grid.frame)[0]
    ends = in_cells(points, grid.frame)
    done: set[Cell] = set()
    for x, y in ends:
        _update(grid, config.p_hit, (math.floor(y), math.floor(x)), done)
    for end in (*ends, *in_cells(free_points, grid.frame)):
        for cell in cells_of_segment(start, end):
            _update(grid, config.p_miss, cell, done)
    return done


def _update(grid: ProbabilityGrid, p: float, cell: Cell, done: set[Cell]) -> None:
    if cell not in done:
        done.add(cell)
        grid.cells[cell] = observe(p, int(grid.cells[cell]))
