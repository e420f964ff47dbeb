"""Branch-and-bound matching of a scan against a finished grid over a large window, for loop closure and relocalization."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels import branch_bound
from ambler.kernels.submap import EVEN
from ambler.registration.cell_grid import CellGrid
from ambler.registration.correlative import Window, angular_step, correlate

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class BranchBoundResult:
    """Best pose of the window, its score (mean probability), how many candidates were scored, and by which angles (rad) they differ."""

    grid_from_base: SE2
    score: float
    scored: int
    angular_step: float


class BranchBoundMatcher:
    """Searches one finished grid; holds its stack of maxima, about `depth` bytes per cell.

    With a `coarseness` above 1 its cells are as many times wider, and each counts as the best of those below it: scores are upper bounds. With `only_walls` cells
    that are more likely free count as unknown ones: a scan of which much lies where the grid knows nothing would else be drawn to where it knows anything.
    """

    def __init__(self, grid: CellGrid, depth: int = 7, coarseness: int = 1, *, only_walls: bool = False) -> None:
        cells = _pooled(grid.cells, coarseness)
        if only_walls:
            cells = np.where(cells > EVEN, cells, np.uint16(0))
        h, w = cells.shape
        pad = (1 << (depth - 1)) - 1
        self.frame = grid.frame * np.array([coarseness, 1.0, 1.0])
        self.depth = depth
        self.stack = np.empty((depth, h + pad, w + pad), np.uint8)
        branch_bound.build_stack(cells, self.stack)

    def match(self, points: F32, center: SE2, window: Window, min_score: float) -> BranchBoundResult | None:
        """Return the best pose (grid_from_base) whose mean probability exceeds `min_score`, or None; points (N, 2) in the base frame."""
        resolution = float(self.frame[0])
        step = angular_step(points, resolution, 0.8)
        half = math.ceil(window.linear / resolution)
        top = min(self.depth - 1, max(0, half.bit_length() - 2))
        search = np.array([half, math.ceil(window.angular / step), step, top])
        min_sum = math.floor((min_score - 0.1) / 0.8 * 255.0 * len(points))
        best = np.empty(4)
        scored = int(branch_bound.search(self.stack, self.frame, points, center.as_array(), search, min_sum, best))
        if best[3] < 0.0:
            return None
        score = 0.1 + 0.8 * float(best[3]) / (255.0 * len(points))
        return BranchBoundResult(SE2.from_array(best[:3]), score, scored, step)


def search_coarse_to_fine(
    matcher: BranchBoundMatcher, grid: CellGrid, points: F32, center: SE2, window: Window, min_score: float
) -> SE2 | None:
    """Search a wide window on a matcher's coarse cells, which promise too much, never too little, then the best of them on the cells of `grid`; None where
    nothing fits better than `min_score`."""
    coarse = matcher.match(points, center, window, min_score)
    if coarse is None:
        return None
    near = Window(1.5 * float(matcher.frame[0]), coarse.angular_step)
    fine = correlate(grid, points, coarse.grid_from_base, near)
    return fine.grid_from_base if fine.score > min_score else None


def _pooled(cells: NDArray[np.uint16], size: int) -> NDArray[np.uint16]:
    """Return the largest value of every square of `size` cells; the grid is filled up with unknown cells."""
    if size == 1:
        return cells
    h, w = (-(-n // size) for n in cells.shape)
    padded = np.zeros((h * size, w * size), np.uint16)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    # Along rows in memory first: both axes at once take several times as long.
    rows = padded.reshape(h, size, w * size).max(axis=1)
    return np.ascontiguousarray(np.maximum.reduce([rows[:, k::size] for k in range(size)]))
