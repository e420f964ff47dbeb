"""How high the ground lies around a base: a height band over level ground takes a slope for a wall, and misses who stands higher or lower."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.perception.terrain import Ground

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

BEYOND = 2.0  # metres from known ground within which the ground is as high as there
MOST = 512  # cells along a side


@dataclass(frozen=True, slots=True, eq=False)
class GroundBelow:
    """`heights` float32 [iy, ix] of the ground in the frame odom, NaN where it is not known, and `place` float64 (8,): the corner of the first cell, the side of
    a cell, and the base in odom (x, y, cosine and sine of its yaw, height). Without any cell the ground is level."""

    heights: F32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    place: F64 = field(default_factory=lambda: np.zeros(8))

    @classmethod
    def of_terrain(cls, points: F32, heights: F32, kinds: NDArray[np.integer], cell: float, step: float) -> GroundBelow:
        """Read a terrain cloud: points (N, 3) in odom, heights above the ground (N,), what they stand for (N,) of `Ground`, 0: a voxel. What is no
        ground stands on the nearest."""
        if not len(points) == len(heights) == len(kinds):
            raise BadInputError(f"a terrain of {len(points)} points, {len(heights)} heights and {len(kinds)} kinds")
        is_ground = (kinds > 0) & (kinds != Ground.DROP) & (heights < step)
        of_cells = np.floor(points[is_ground, :2].astype(np.float64) / cell).astype(np.int64)
        if len(of_cells) == 0:
            return cls()
        margin = math.ceil(BEYOND / cell)
        first = of_cells.min(axis=0) - margin
        nx, ny = (np.minimum(of_cells.max(axis=0) + margin - first + 1, MOST)).tolist()
        ix, iy = (of_cells - first).T
        inside = (ix < nx) & (iy < ny)
        known = np.full((ny, nx), np.nan, np.float32)
        known[iy[inside], ix[inside]] = points[is_ground, 2][inside]
        distances, (jy, jx) = ndimage.distance_transform_edt(np.isnan(known), return_indices=True)
        out = np.where(distances * cell <= BEYOND, known[jy, jx], np.float32(np.nan))
        x0, y0 = (first * cell).tolist()
        return cls(np.ascontiguousarray(out, np.float32), np.array([x0, y0, cell, 0.0, 0.0, 1.0, 0.0, 0.0]))

    def under(self, odom_from_base: SE3) -> GroundBelow:
        """Return the same ground as a base at a pose in odom has it around itself."""
        base = odom_from_base.to_se2()
        pose = (base.x, base.y, math.cos(base.yaw), math.sin(base.yaw), odom_from_base.translation[2])
        return GroundBelow(self.heights, np.array([*self.place[:3], *pose]))


LEVEL_GROUND = GroundBelow()
