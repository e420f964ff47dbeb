"""A known map, prepared for localization: surfaces seen from free space, and for each cell the nearest of them per facing."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.kernels import surfaces as kernel

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

REACH = 1.2  # metres from a surface beyond which a point has none
SLIVER = 0.15  # metres: free floor that is narrower has been seen by nobody


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMap:
    """`cells` int8 [iy, ix] occupancy; `surfaces` float64 (N, 4): points in the map frame and unit normals towards free space;
    `nearest` int32 (4, H, W): index of the nearest surface per facing (+x, -x, +y, -y) or -1; `distance` float32 (H, W), metres, at most `REACH`."""

    spec: GridSpec
    cells: NDArray[np.int8]
    frame: F64
    surfaces: F64
    nearest: NDArray[np.int32]
    distance: F32

    @classmethod
    def from_occupancy(
        cls, cells: NDArray[np.int8], spec: GridSpec, *, occupied_from: int = 50, fit_radius: float = 0.2
    ) -> SurfaceMap:
        """Prepare a map. Cells >= `occupied_from` are occupied, lower ones free, -1 unknown; walls are fitted over +-`fit_radius` m.

        Raises BadInputError when the map has no surface that free space can see.
        """
        cells = np.array(cells, np.int8, order="C")
        if cells.shape != spec.shape:
            raise BadInputError(f"the map has {cells.shape} cells, its description says {spec.shape}")
        frame = np.array([spec.resolution, spec.origin_x, spec.origin_y])
        seen = without_slivers(cells, occupied_from, max(2, round(SLIVER / spec.resolution)))
        count = kernel.count_faces(seen, occupied_from)
        if count == 0:
            raise BadInputError("the map has no wall beside free space, nothing to localize against")
        positions, facings = np.empty((count, 2)), np.empty(count, np.int8)
        owners = np.empty((4, *spec.shape), np.int32)
        kernel.extract_faces(seen, occupied_from, frame, positions, facings, owners)
        surfaces = np.empty((count, 4))
        radius = max(2, round(fit_radius / spec.resolution))
        kernel.smooth_faces(positions, facings, owners, frame, radius, surfaces)
        flat = owners.reshape(4, -1)
        places = [np.flatnonzero(facing >= 0) for facing in flat]
        faces = [facing[there] for facing, there in zip(flat, places, strict=True)]
        del owners, flat, seen  # as large as what comes now
        nearest = np.empty((4, *spec.shape), np.int32)
        distance, squared = np.full(spec.shape, REACH, np.float32), np.empty(spec.shape, np.float32)
        for f in range(4):
            kernel.spread_nearest(places[f], faces[f], surfaces, frame, REACH, squared, nearest[f])
            kernel.lower_distance(squared, distance)
        return cls(spec, cells, frame, surfaces, nearest, distance)

    def is_free(self, pose: SE2) -> bool:
        """Tell whether a pose lies on a known free cell."""
        iy, ix = self.spec.cell_of(pose.x, pose.y)
        return self.spec.contains_cell(iy, ix) and 0 <= int(self.cells[iy, ix]) < 50


def without_slivers(cells: NDArray[np.int8], occupied_from: int, width: int) -> NDArray[np.int8]:
    """Return a map, int8 [iy, ix], in which free floor narrower than `width` cells is unknown, unless it borders on wider floor as the steps of a wall at an angle do.

    Behind a wall that a robot has mapped from one side single cells are free where its noise let a beam end late. Whoever comes into the room behind it would take the
    wall's back for its face there, and stand beside itself by the thickness of the wall.
    """
    free = ((cells >= 0) & (cells < occupied_from)).astype(np.uint8)
    wide = cv2.morphologyEx(free, cv2.MORPH_OPEN, np.ones((width, width), np.uint8))
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    for _ in range(width):
        wide = np.minimum(cv2.dilate(wide, cross), free)
    return np.where((free > 0) & (wide == 0), np.int8(-1), cells)
