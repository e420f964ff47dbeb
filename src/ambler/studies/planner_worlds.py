"""The four grids on which planners and costmaps are measured, at any size: lethal cells, then inflated as costmap_2d would."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.costmap.inflation import cost_table
from ambler.kernels.distance_transform import inflate

U8 = NDArray[np.uint8]
WORLDS = ("open", "clutter", "rooms", "serpentine")
MARGIN = 30  # the start and goal cells lie this far from their corners


def make_world(name: str, n: int, rng: np.random.Generator) -> U8:
    """Return lethal cells (254) and free ones (0), uint8 (n, n), walled in; the two corners' surroundings are free."""
    cells = np.zeros((n, n), np.uint8)
    if name == "clutter":
        _add_boxes(cells, rng)
    elif name == "rooms":
        _add_rooms(cells, rng)
    elif name == "serpentine":
        _add_serpentine(cells)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 254, 254, 254, 254
    for corner in (slice(MARGIN - 12, MARGIN + 13), slice(n - MARGIN - 13, n - MARGIN + 12)):
        cells[corner, corner] = 0
    return cells


def _add_boxes(cells: U8, rng: np.random.Generator) -> None:
    n = len(cells)
    for _ in range(n * n // 2200):
        y, x = rng.integers(0, n, 2)
        height, width = rng.integers(4, 25, 2)
        cells[y : y + height, x : x + width] = 254


def _add_rooms(cells: U8, rng: np.random.Generator) -> None:
    n, pitch, door = len(cells), 100, 20
    for at in range(pitch, n - pitch // 2, pitch):
        cells[at : at + 3] = 254
        cells[:, at : at + 3] = 254
    for at in range(pitch, n - pitch // 2, pitch):
        for room in range(0, n, pitch):
            low, high = room + 8, min(room + pitch, n) - 8 - door
            if high > low:
                a, b = rng.integers(low, high, 2)
                cells[at : at + 3, a : a + door] = 0
                cells[b : b + door, at : at + 3] = 0


def _add_serpentine(cells: U8) -> None:
    n, gap = len(cells), 40
    lanes = 7 if n < 2500 else n // 110
    for k in range(1, lanes):
        at = k * n // lanes
        cells[at : at + 3] = 254
        if k % 2:
            cells[at : at + 3, n - gap :] = 0
        else:
            cells[at : at + 3, :gap] = 0


def inflated(cells: U8, inscribed: float = 0.25, radius: float = 0.55, scaling: float = 10.0) -> U8:
    """Return the costs at 5 cm per cell."""
    resolution = 0.05
    across = round(radius / resolution)
    out = np.empty_like(cells)
    table = cost_table(across, resolution, inscribed, scaling)
    inflate(cells, 0, cells.shape[0], 0, cells.shape[1], across, table, out)
    return out
