"""Where a map of ground once only assumed ground: the robot was near, and its scanner sees no floor near itself."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import Frontier, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.exploration.frontier_map import FrontierGroups
from ambler.exploration.lattice import carried
from ambler.exploration.pockets import patch_areas

BESIDE = 2  # cells around what was assumed
STEP = 0.1  # metres by which it is told apart how near the robot was
MOST = 255  # such steps that are told apart, and one
SHARE = 0.5  # of a frontier's cells


class Overlooked:
    """Remembers the cells that were `assumed` (their value in the map), and how near to them the robot was then; follows the map's geometry as it grows."""

    def __init__(self, assumed: int) -> None:
        self._assumed = assumed
        self._spec: GridSpec | None = None
        # `MOST` beside the robot, less by one for each `STEP`; 0: never assumed.
        self._nearness: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)

    def add(self, occupancy: OccupancyGrid, map_from_base: SE2) -> None:
        """Take down what is only assumed now, around a robot at `map_from_base`."""
        spec = occupancy.spec
        if spec != self._spec:
            self._nearness, self._spec = carried(self._nearness, self._spec, spec), spec
        iy, ix = np.nonzero(occupancy.data == self._assumed)
        away = np.hypot(*(spec.centers_of(np.column_stack((iy, ix))) - (map_from_base.x, map_from_base.y)).T)
        now = np.clip(MOST - away / STEP, 1, MOST).astype(np.uint8)
        self._nearness[iy, ix] = np.maximum(self._nearness[iy, ix], now)

    def taken_for_known(self, occupancy: OccupancyGrid) -> OccupancyGrid:
        """Return the map that was added last with what was once assumed and is unknown again as if it were assumed still, where known cells enclose it. What
        goes on beyond the map may be a landing that is seen from the top of a ramp only: nobody should leave before it was looked at."""
        is_lost = (self._nearness > 0) & (occupancy.data < 0)
        is_lost &= np.isfinite(patch_areas(occupancy))
        return replace(occupancy, data=np.where(is_lost, np.int8(self._assumed), occupancy.data))

    def are_of(self, groups: FrontierGroups, within: float = math.inf) -> NDArray[np.bool_]:
        """Tell which groups (N,) of frontier cells of the last map border mostly on what was assumed once, when the robot was `within` metres of it."""
        if not len(groups):
            return np.zeros(0, np.bool_)
        is_near = self._nearness >= max(1.0, MOST - within / STEP)
        hits = np.add.reduceat(
            _around(is_near.astype(np.uint8)).ravel()[groups.cells].astype(np.int64), groups.starts[:-1]
        )
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
