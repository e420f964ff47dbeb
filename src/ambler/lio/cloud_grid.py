"""A plan in two dimensions out of a cloud, for robots that navigate in 2-D: the floor under the way, level or sloping, followed over the cloud; what
stands in a band above it is occupied; what was seen of the floor from the way without anything between is free.

One height per place: of several storeys the plan shows the one that the way began on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate, map_coordinates

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN, GridSpec
from ambler.kernels import cloud_grid as kernels
from ambler.lio.config import CloudGridConfig

F64 = NDArray[np.float64]

CELLS_MOST = 100_000_000


@dataclass(frozen=True, slots=True, eq=False)
class CloudGrid:
    """`occupancy` int8 (H, W): 0 free, 100 occupied, -1 unknown; `left_out` is the share of the way that leads over another storey than the plan's."""

    spec: GridSpec
    occupancy: NDArray[np.int8]
    left_out: float


def cut_plan(points: NDArray[np.floating], way: F64, config: CloudGridConfig | None = None) -> CloudGrid:
    """Cut the plan out of points (N, 3) along the way (M, 3) of the sensor, both in the map; raises BadInputError where no floor lies under the way."""
    c = config or CloudGridConfig()
    near = np.isfinite(points).all(axis=1)
    for axis in (0, 1):
        near &= (points[:, axis] > way[:, axis].min() - c.reach) & (points[:, axis] < way[:, axis].max() + c.reach)
    own = points[near].astype(np.float64)
    if len(own) == 0:
        raise BadInputError("no plan can be cut out: the cloud holds nothing near the way")
    low = np.floor(own[:, :2].min(axis=0) / c.floor_cell) * c.floor_cell
    size = np.ceil((own[:, :2].max(axis=0) - low) / c.floor_cell).astype(int) + 1
    scale = round(c.floor_cell / c.resolution)
    if int(size[0]) * int(size[1]) * scale**2 > CELLS_MOST:
        raise BadInputError(f"no plan can be cut out: {size * c.floor_cell} m are too large")
    floor = _floor(own, way, low, size, c)
    spec = GridSpec(c.resolution, int(size[0]) * scale, int(size[1]) * scale, float(low[0]), float(low[1]))
    heights = own[:, 2] - _between(floor, (own[:, :2] - low) / c.floor_cell)
    cells = np.floor((own[:, :2] - low) / c.resolution).astype(np.int64)
    shape = (spec.height, spec.width)
    standing = _count(cells[(heights > c.band_low) & (heights < c.band_high)], shape)
    # A point alone is noise; on a flat top there is one in every cell.
    around = correlate(standing, np.ones((3, 3), np.int64), mode="constant")
    occupied = (standing >= c.points_least) | ((standing > 0) & (around >= c.points_around))
    seen = _count(cells[np.abs(heights) < c.band_low], shape) > 0
    places, below = _way_over(way, floor, low, c)
    free = np.zeros(shape, np.bool_)
    eyes = (places[:, :2] - low) / c.resolution
    kernels.see(occupied, seen, np.ascontiguousarray(eyes), c.reach / c.resolution, free)
    occupancy = np.where(occupied, OCC_OCCUPIED, np.where(free, OCC_FREE, OCC_UNKNOWN)).astype(np.int8)
    return CloudGrid(spec, occupancy, 1.0 - below)


def _floor(points: F64, way: F64, low: F64, size: NDArray[np.int_], c: CloudGridConfig) -> F64:
    """Return the height of the floor in every coarse cell, float64 (h, w), NaN where it was not reached."""
    width, height = int(size[0]), int(size[1])
    ij = np.floor((points[:, :2] - low) / c.floor_cell).astype(np.int64)
    cell = ij[:, 1] * width + ij[:, 0]
    order = np.lexsort((points[:, 2], cell))
    first = np.searchsorted(cell[order], np.arange(width * height + 1)).astype(np.int64)
    heights = points[order, 2].astype(np.float32)
    floor = np.full((height, width), np.nan, np.float32)
    seed = _seed(way, low, first, heights, width, height, c)
    floor[seed[0] // width, seed[0] % width] = seed[1]
    gaps = np.zeros((height, width), np.int32)
    kernels.follow_floor(first, heights, np.array([seed[0]]), c.climb, c.gap, floor, gaps)
    return floor.astype(np.float64)


def _seed(
    way: F64,
    low: F64,
    first: NDArray[np.int64],
    heights: NDArray[np.float32],
    width: int,
    height: int,
    c: CloudGridConfig,
) -> tuple[int, float]:
    """Return the first cell that the way leads over in which a floor was seen, and its height."""
    for x, y, z in way:
        ix, iy = int((x - low[0]) / c.floor_cell), int((y - low[1]) / c.floor_cell)
        if not (0 <= ix < width and 0 <= iy < height):
            continue
        own = heights[first[iy * width + ix] : first[iy * width + ix + 1]]
        below = own[(own < z - c.sensor_least) & (own > z - c.sensor_most)]
        if len(below) >= c.points_least:
            return iy * width + ix, float(np.percentile(below, 20.0))
    raise BadInputError("no plan can be cut out: no floor was seen under the way")


def _between(floor: F64, at: F64) -> F64:
    """Return heights of the floor at places (N, 2) in cells, linearly between the middles of cells; NaN beside what was reached."""
    known = np.isfinite(floor)
    own = at - 0.5
    weight = map_coordinates(known.astype(np.float64), [own[:, 1], own[:, 0]], order=1, mode="nearest")
    total = map_coordinates(np.where(known, floor, 0.0), [own[:, 1], own[:, 0]], order=1, mode="nearest")
    ij = np.floor(at).astype(np.int64)
    is_own = known[np.clip(ij[:, 1], 0, len(floor) - 1), np.clip(ij[:, 0], 0, floor.shape[1] - 1)]
    return np.asarray(np.where(is_own & (weight > 0.2), total / np.maximum(weight, 1e-9), np.nan))


def _way_over(way: F64, floor: F64, low: F64, c: CloudGridConfig) -> tuple[F64, float]:
    """Return places of the way a step apart that lead over the plan's storey, and their share."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    _, first = np.unique(np.floor(along / c.eye_step), return_index=True)
    places = way[first]
    above = places[:, 2] - _between(floor, (places[:, :2] - low) / c.floor_cell)
    is_over = (above > c.sensor_least) & (above < c.sensor_most)
    return places[is_over], float(np.mean(is_over))


def _count(cells: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.int64]:
    flat = cells[:, 1] * shape[1] + cells[:, 0]
    return np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)
