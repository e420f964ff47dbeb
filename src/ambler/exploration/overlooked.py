"""Where a map of ground once only assumed ground: the robot was near, and its scanner sees no floor near itself."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import Frontier, OccupancyGrid
from ambler.exploration.frontier_map import FrontierGroups
from ambler.exploration.lattice import carried

BESIDE = 2  # cells around what was assumed
SHARE = 0.5  # of a frontier's cells


class Overlooked:
    """Remembers the cells that were `assumed` (their value in the map); follows the map's geometry as it grows."""

    def __init__(self, assumed: int) -> None:
        self._assumed = assumed
        self._spec: GridSpec | None = None
        self._cells: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)

    def add(self, occupancy: OccupancyGrid) -> None:
        """Take down what is only assumed now."""
        spec = occupancy.spec
        if spec != self._spec:
            self._cells, self._spec = carried(self._cells, self._spec, spec), spec
        self._cells |= occupancy.data == self._assumed

    def are_of(self, groups: FrontierGroups) -> NDArray[np.bool_]:
        """Tell which groups (N,) of frontier cells of the last map border mostly on what was assumed once."""
        if not len(groups):
            return np.zeros(0, np.bool_)
        hits = np.add.reduceat(_around(self._cells).ravel()[groups.cells].astype(np.int64), groups.starts[:-1])
        return np.asarray(hits >= SHARE * groups.sizes, np.bool_)


def is_hidden(frontier: Frontier, occupancy: OccupancyGrid, assumed: int) -> bool:
    """Tell whether a frontier borders mostly on what is assumed in this map: it may have closed only because the robot came near."""
    spec = occupancy.spec
    cells = spec.cells_of(frontier.cells)
    cells = cells[np.all((cells >= 0) & (cells < spec.shape), axis=1)]
    if len(cells) == 0:
        return False
    y0, x0 = np.maximum(cells.min(axis=0) - BESIDE, 0)
    y1, x1 = cells.max(axis=0) + BESIDE + 1
    around = _around((occupancy.data[y0:y1, x0:x1] == assumed).astype(np.uint8))
    iy, ix = (cells - (y0, x0)).T
    return int(np.count_nonzero(around[iy, ix])) >= SHARE * len(frontier.cells)


def _around(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.dilate(cells, np.ones((2 * BESIDE + 1, 2 * BESIDE + 1), np.uint8)), np.uint8)
