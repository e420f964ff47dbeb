"""Path distances in wide places: on coarse cells, and only where they are asked for, so that a look costs little however large the map is."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_INSCRIBED, GridSpec
from ambler.core.se2 import SE2
from ambler.kernels.frontier_value import drop_outside, shrink_costs, spread_distances

U8 = NDArray[np.uint8]


def shrunk(costs: U8, spec: GridSpec, cell: float) -> tuple[U8, GridSpec]:
    """Return costs uint8 on cells of about `cell` metres, each the least of the fine cells in it, and their geometry; the same when the
    cells are not smaller.

    A wall stays closed: it is inflated by the robot's inscribed radius on both sides, which is wider than a cell. A door that is a little
    too narrow opens (`join` tells).
    """
    factor = max(1, math.floor(cell / spec.resolution + 1e-6))
    if factor == 1:
        return costs, spec
    size = spec.resolution * factor
    coarse = GridSpec(
        size, math.ceil(spec.width / factor), math.ceil(spec.height / factor), spec.origin_x, spec.origin_y
    )
    out = np.empty(coarse.shape, np.uint8)
    shrink_costs(costs, factor, out)
    return out, coarse


def cropped(costs: U8, spec: GridSpec, points: NDArray[np.float64], margin: float) -> tuple[U8, GridSpec]:
    """Return the part of a grid that holds points (N, 2) with `margin` metres about them, and its geometry."""
    low = (points.min(axis=0) - margin - (spec.origin_x, spec.origin_y)) / spec.resolution
    high = (points.max(axis=0) + margin - (spec.origin_x, spec.origin_y)) / spec.resolution
    x0, y0 = (max(0, math.floor(v)) for v in low)
    x1, y1 = min(spec.width, math.ceil(high[0])), min(spec.height, math.ceil(high[1]))
    origin = spec.origin_x + x0 * spec.resolution, spec.origin_y + y0 * spec.resolution
    return np.ascontiguousarray(costs[y0:y1, x0:x1]), GridSpec(spec.resolution, x1 - x0, y1 - y0, *origin)


def spread(distance: NDArray[np.float32], factor: int, costs: U8) -> NDArray[np.float32]:
    """Return distances of coarse cells on the fine cells [iy, ix] of `costs`, inf where the robot's centre may not be."""
    out = np.empty(costs.shape, np.float32)
    spread_distances(distance, factor, costs, COST_INSCRIBED, out)
    return out


def join(distance: NDArray[np.float32], costs: U8, spec: GridSpec, base: SE2) -> None:
    """Set distances [iy, ix] that were `spread` to inf where the fine cells of `costs` do not lead to the place from which they are told:
    what lies behind a gap that only coarse cells pass. `base` is the robot in the frame of the grid."""
    least = distance.min()
    if not np.isfinite(least):
        return
    near = np.flatnonzero(distance <= least + 2.0 * spec.resolution)
    iy, ix = np.divmod(near, spec.width)
    row, column = spec.cell_of(base.x, base.y)
    begin = int(np.argmin((iy - row) ** 2 + (ix - column) ** 2))
    passable = (costs < COST_INSCRIBED).view(np.uint8)
    filled = np.zeros((spec.height + 2, spec.width + 2), np.uint8)  # OpenCV wants a border of one cell
    seed = (int(ix[begin]), int(iy[begin]))
    cv2.floodFill(passable, filled, seed, 0, flags=4 | cv2.FLOODFILL_MASK_ONLY)
    drop_outside(filled[1:-1, 1:-1], distance)
