"""Maps whose picture lies turned in their frame (a yaw in the map's origin), drawn anew along the axes: our grids have no yaw."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import OCC_UNKNOWN, GridSpec
from ambler.core.se2 import SE2

_OCCUPIED = 65  # from here on a cell is part of a wall, which must not get holes


def straightened(spec: GridSpec, occupancy: NDArray[np.int8], yaw: float) -> tuple[GridSpec, NDArray[np.int8]]:
    """Return a grid along the axes, of the same resolution, that shows what lies turned by `yaw` (rad) about the outer corner of its
    cell [0, 0]. Each cell takes the value at its centre, and that of every occupied cell whose centre lies in it."""
    resolution, map_from_picture = spec.resolution, SE2(spec.origin_x, spec.origin_y, yaw)
    ends = np.array([[0, 0], [spec.width, 0], [0, spec.height], [spec.width, spec.height]]) * resolution
    ends = np.round((map_from_picture.transform(ends) - (spec.origin_x, spec.origin_y)) / resolution, 6)  # in cells
    low, high = np.floor(ends.min(axis=0)), np.ceil(ends.max(axis=0))
    width, height = (int(n) for n in high - low)
    origin = np.array([spec.origin_x, spec.origin_y]) + low * resolution
    turned = GridSpec(resolution, width, height, float(origin[0]), float(origin[1]))
    c, s = math.cos(yaw), math.sin(yaw)
    x, y = low + 0.5
    picture_from_cells = np.array([[c, s, c * x + s * y - 0.5], [-s, c, c * y - s * x - 0.5]])
    unknown = int(np.int8(OCC_UNKNOWN).view(np.uint8))
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    drawn = cv2.warpAffine(
        np.ascontiguousarray(occupancy).view(np.uint8),
        picture_from_cells,
        (width, height),
        flags=flags,
        borderValue=unknown,
    )
    out = np.asarray(drawn, np.uint8).view(np.int8)
    walls = np.argwhere(occupancy >= _OCCUPIED)
    places = turned.cells_of(map_from_picture.transform((walls[:, ::-1] + 0.5) * resolution))
    np.maximum.at(out, (places[:, 0], places[:, 1]), occupancy[walls[:, 0], walls[:, 1]])
    return turned, out
