"""Terrain around a robot as a grid, as the map of ground takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.errors import BadInputError
from ambler.perception.terrain import Ground

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class TerrainWindow:
    """Terrain around a robot in the odom frame: `kinds` uint8 [iy, ix] of `Ground`, 0 where nothing is known, `heights` float32 [iy, ix] of the ground, and
    `tops` float32 [2 iy, 2 ix] how high (m, in odom) the voxels reach that stand on it, -inf where none does."""

    origin_x: float
    origin_y: float
    cell: float
    kinds: U8
    tops: F32
    heights: F32

    @classmethod
    def of_points(cls, points: F32, heights: F32, kinds: U8, cell: float, step: float) -> TerrainWindow:
        """Read a terrain cloud: points (N, 3) in odom, heights above the ground (N,), what they stand for (N,), 0: a voxel. Things lower than
        `step` are ground."""
        if not len(points) == len(heights) == len(kinds):
            raise BadInputError(f"a terrain of {len(points)} points, {len(heights)} heights and {len(kinds)} kinds")
        is_cell = kinds > 0
        of_cells = np.floor(points[is_cell, :2].astype(np.float64) / cell).astype(np.int64)
        if len(of_cells) == 0:
            nothing = np.zeros((0, 0), np.float32)
            return cls(0.0, 0.0, cell, np.zeros((0, 0), np.uint8), nothing, nothing)
        first, last = of_cells.min(axis=0), of_cells.max(axis=0)
        shape = (int(last[1] - first[1]) + 1, int(last[0] - first[0]) + 1)
        out = np.zeros(shape, np.uint8)
        ground = np.full(shape, np.nan, np.float32)
        iy, ix = (of_cells - first).T[::-1]
        crossed = (heights[is_cell] < step) & (kinds[is_cell] != Ground.DROP)
        out[iy, ix] = np.where(crossed, Ground.GROUND, np.maximum(kinds[is_cell], Ground.OBSTACLE))
        ground[iy, ix] = points[is_cell, 2]
        tops = np.full((2 * shape[0], 2 * shape[1]), -np.inf, np.float32)
        voxels = points[~is_cell & (heights >= step)]
        standing = np.floor(voxels[:, :2].astype(np.float64) / (0.5 * cell)).astype(np.int64) - 2 * first
        inside = ((standing >= 0) & (standing < np.array(tops.shape)[::-1])).all(axis=1)
        np.maximum.at(tops, (standing[inside, 1], standing[inside, 0]), voxels[inside, 2])
        return cls(float(first[0]) * cell, float(first[1]) * cell, cell, out, tops, _carried(out, ground))

    def around(self, x: float, y: float, reach: float) -> TerrainWindow:
        """Return a window that also holds everything within `reach` metres of a place, not known where this one ends."""
        ny, nx = self.kinds.shape
        low = np.floor((np.array([x, y]) - reach - (self.origin_x, self.origin_y)) / self.cell).astype(int)
        high = np.ceil((np.array([x, y]) + reach - (self.origin_x, self.origin_y)) / self.cell).astype(int)
        left, below = np.maximum(-low, 0).tolist()
        right, above = np.maximum(high - (nx, ny), 0).tolist()
        return TerrainWindow(
            self.origin_x - left * self.cell,
            self.origin_y - below * self.cell,
            self.cell,
            np.pad(self.kinds, ((below, above), (left, right))),
            np.pad(self.tops, ((2 * below, 2 * above), (2 * left, 2 * right)), constant_values=-np.inf),
            np.pad(self.heights, ((below, above), (left, right)), constant_values=np.nan),
        )

    @property
    def origin(self) -> F64:
        """x, y and the side of a cell, as the kernels take it."""
        return np.array([self.origin_x, self.origin_y, self.cell])

    def corners(self) -> F64:
        """Corners (4, 2)."""
        ny, nx = self.kinds.shape
        x1, y1 = self.origin_x + nx * self.cell, self.origin_y + ny * self.cell
        return np.array([[self.origin_x, self.origin_y], [x1, self.origin_y], [x1, y1], [self.origin_x, y1]])


def _carried(kinds: U8, heights: F32) -> F32:
    """Return the heights of a window with those of what is no ground replaced by that of the nearest ground."""
    is_ground = kinds == Ground.GROUND
    if not is_ground.any():
        return heights
    iy, ix = ndimage.distance_transform_edt(~is_ground, return_distances=False, return_indices=True)
    return np.where(kinds > Ground.GROUND, heights[iy, ix], heights)
