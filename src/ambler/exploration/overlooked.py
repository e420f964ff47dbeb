"""Where a map of ground once only assumed ground: the robot was near, and its scanner sees no floor near itself."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid
from ambler.exploration.close_looks import moved_grid
from ambler.exploration.frontier_map import FrontierGroups

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
            old, self._spec = self._spec, spec
            if old is None or old.resolution != spec.resolution:
                self._cells = np.zeros(spec.shape, np.uint8)
            else:
                self._cells = moved_grid(self._cells, spec.shape, *old.offset_in(spec))
        self._cells |= occupancy.data == self._assumed

    def are_of(self, groups: FrontierGroups) -> NDArray[np.bool_]:
        """Tell which groups (N,) of frontier cells of the last map border mostly on what was assumed once."""
        if not len(groups):
            return np.zeros(0, np.bool_)
        around = cv2.dilate(self._cells, np.ones((2 * BESIDE + 1, 2 * BESIDE + 1), np.uint8))
        hits = np.add.reduceat(around.ravel()[groups.cells].astype(np.int64), groups.starts[:-1])
        return np.asarray(hits >= SHARE * groups.sizes, np.bool_)
