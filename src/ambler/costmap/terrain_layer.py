"""The terrain layer: the floor is where the terrain analysis saw ground, and what rises or drops too much there is lethal.

It is drawn over what a height band of a cloud says: a slope that such a band takes for a wall is free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_FREE, COST_LETHAL, GridSpec
from ambler.costmap.layer import Box, Moment, box_around, union, whole
from ambler.kernels.costmap import fill_squares

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]
F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class TerrainLayerConfig:
    """What is `step` metres or more above the ground, or below it, is lethal; lower things cost up to `rough`, in proportion from a third of a
    step on. A point that stands for a voxel covers `voxel` metres, one that stands for a cell of ground `cell`."""

    step: float = 0.08
    rough: int = 90
    voxel: float = 0.1
    cell: float = 0.2


class TerrainLayer:
    """A `Layer` of the newest terrain; its memory is the terrain analysis', so every terrain replaces the last."""

    def __init__(self, config: TerrainLayerConfig | None = None) -> None:
        self.config = config if config is not None else TerrainLayerConfig()
        self._points: F64 = np.zeros((0, 2))
        self._heights: F32 = np.zeros(0, np.float32)
        self._is_cell: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._drawn: F64 = np.zeros((0, 2))
        self._spec: GridSpec | None = None
        self._is_new = False

    def set_terrain(self, points: F64, heights: F32, is_cell: NDArray[np.bool_]) -> None:
        """Take points (N, 2) in the costmap's frame, their heights above the ground (N,) and which stand for cells of ground (N,)."""
        if not len(points) == len(heights) == len(is_cell):
            raise BadInputError(f"a terrain of {len(points)} points, {len(heights)} heights and {len(is_cell)} kinds")
        self._points, self._heights, self._is_cell, self._is_new = points, heights, is_cell, True

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Return the box of the last terrain and this one."""
        is_moved, is_new = spec != self._spec, self._is_new
        last, self._drawn, self._spec, self._is_new = self._drawn, self._points, spec, False
        if is_moved:
            return whole(spec)
        return union(box_around(last, spec), box_around(self._drawn, spec)) if is_new else None

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Free the cells of ground, charge what is rough, and mark what cannot be crossed, in this order."""
        c, r = self.config, spec.resolution
        share = self._heights / c.step
        ground = self._is_cell & (share < 1.0)
        cost = np.where(share > 1.0 / 3.0, share * c.rough, COST_FREE).astype(np.uint8)
        self._fill(master, spec, self._points[ground], cost[ground], round(c.cell / r))
        for kind, size in ((self._is_cell, c.cell), (~self._is_cell, c.voxel)):
            marked = self._points[kind & (share >= 1.0)]
            lethal = np.full(len(marked), COST_LETHAL, np.uint8)
            self._fill(master, spec, marked, lethal, max(1, round(size / r)))

    def clear(self) -> None:
        """Forget the terrain; the next one comes soon."""
        self.set_terrain(np.zeros((0, 2)), np.zeros(0, np.float32), np.zeros(0, np.bool_))

    def clear_within(self, x: float, y: float, radius: float) -> None:
        """Forget the terrain there until the next one."""
        far = np.hypot(self._points[:, 0] - x, self._points[:, 1] - y) > radius
        self.set_terrain(self._points[far], self._heights[far], self._is_cell[far])

    @staticmethod
    def _fill(master: U8, spec: GridSpec, points: F64, values: U8, across: int) -> None:
        """Write values into squares of `across` cells around points."""
        fill_squares(master, spec.origin_x, spec.origin_y, spec.resolution, points, values, across)
