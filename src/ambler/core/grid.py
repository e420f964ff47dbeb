"""The geometry of a grid: the only place where metres become cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Costs (uint8), after costmap_2d.
COST_FREE = 0
COST_INSCRIBED = 253
COST_LETHAL = 254
COST_UNKNOWN = 255
# Occupancy (int8), after nav_msgs/OccupancyGrid.
OCC_UNKNOWN = -1
OCC_FREE = 0
OCC_ASSUMED = 25  # of a map of ground: nothing speaks against it, and nobody has seen it
OCC_OCCUPIED = 100
# In maps that grade their cells, those below it are rather free than not.
OCC_FREE_BELOW = 50


@dataclass(frozen=True, slots=True)
class GridSpec:
    """An axis-aligned grid: cells are [iy, ix], row 0 lies at the lowest y, the origin is the outer corner of cell [0, 0]."""

    resolution: float
    width: int
    height: int
    origin_x: float
    origin_y: float

    @property
    def shape(self) -> tuple[int, int]:
        """Array shape (height, width)."""
        return (self.height, self.width)

    def cell_of(self, x: float, y: float) -> tuple[int, int]:
        """Return (iy, ix) of the cell that contains the point; it may lie outside the grid."""
        return (
            math.floor((y - self.origin_y) / self.resolution),
            math.floor((x - self.origin_x) / self.resolution),
        )

    def contains_cell(self, iy: int, ix: int) -> bool:
        return 0 <= iy < self.height and 0 <= ix < self.width

    def contains(self, x: float, y: float) -> bool:
        return self.contains_cell(*self.cell_of(x, y))

    def center_of(self, iy: int, ix: int) -> tuple[float, float]:
        """Return the (x, y) of a cell's centre, metres."""
        return (
            self.origin_x + (ix + 0.5) * self.resolution,
            self.origin_y + (iy + 0.5) * self.resolution,
        )

    def cells_of(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        """Return int64 (N, 2) of (iy, ix) for points (N, 2) of (x, y)."""
        out = np.empty((len(points), 2), np.int64)
        out[:, 0] = np.floor((points[:, 1] - self.origin_y) / self.resolution)
        out[:, 1] = np.floor((points[:, 0] - self.origin_x) / self.resolution)
        return out

    def centers_of(self, cells: NDArray[np.integer]) -> NDArray[np.float64]:
        """Return float64 (N, 2) of (x, y) for cells (N, 2) of (iy, ix)."""
        out = np.empty((len(cells), 2))
        out[:, 0] = self.origin_x + (cells[:, 1] + 0.5) * self.resolution
        out[:, 1] = self.origin_y + (cells[:, 0] + 0.5) * self.resolution
        return out

    def offset_in(self, other: GridSpec) -> tuple[int, int]:
        """Return (diy, dix): where this grid's cell [0, 0] lies in `other`, which must be aligned to whole cells."""
        return (
            round((self.origin_y - other.origin_y) / self.resolution),
            round((self.origin_x - other.origin_x) / self.resolution),
        )
