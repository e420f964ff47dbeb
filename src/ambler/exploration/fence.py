"""How far exploration goes: inside a polygon or a radius about the start, and only where known surfaces can tell the robot where it is.

An outer wall with a gap leads into a plain without any return. A robot that drives on there loses its map, so it keeps within reach of
surfaces that it knows, and says what it left out.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_LETHAL, OCC_OCCUPIED, GridSpec
from ambler.core.messages import CostGrid, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.kernels.frontier import spread_steps

U8 = NDArray[np.uint8]
CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
RIM = np.ones((5, 5), np.uint8)  # fine cells: a wall is so even, and a hull's rim lies partly outside of it
Boundary = tuple[tuple[float, float], ...]


class Side(enum.IntEnum):
    """Where a cell lies."""

    INSIDE = 0
    BEYOND_BOUNDARY = 1
    BEYOND_STRUCTURE = 2


@dataclass(frozen=True, slots=True)
class FenceConfig:
    """`boundary` is a polygon (x, y) in the map frame, `radius` (m) a circle about the start; empty and 0 mean none. The robot goes no farther
    than `structure_reach` (m) from surfaces that it knows, 0 meaning anywhere: three quarters of its scanner's range, so that what it
    would know its place by is seen by many beams. Nor does it go on for more than `open_reach` (m) when it has left the convex hull of all
    surfaces that it knows, through a gap or from its start: there it sees walls on one side only, along which it slides (2.4 m along the outer
    wall of a warehouse). At least `structure_least` metres of surface within 1.5 m are structure, not a lost return.
    Judged on cells of `cell` (m); whether a way leads somewhere on finer ones of `way_cell`: the narrowest door is twice as wide."""

    boundary: Boundary = ()
    radius: float = 0.0
    structure_reach: float = 15.0
    open_reach: float = 5.0
    structure_least: float = 0.2
    cell: float = 0.5
    way_cell: float = 0.1

    def __post_init__(self) -> None:
        if len(self.boundary) in (1, 2):
            raise BadInputError("a boundary needs at least three corners")
        if (
            min(self.radius, self.structure_reach, self.open_reach, self.structure_least) < 0.0
            or min(self.cell, self.way_cell) <= 0.0
        ):
            raise BadInputError("the fence's lengths must not be negative, nor its cells empty")


class Fence:
    """Judges the cells of one map; `update` with every new map and ask then. It follows nothing but the map."""

    def __init__(self, config: FenceConfig, center: tuple[float, float] | None = None) -> None:
        self.config = config
        self.center = center  # of the radius, in the map frame; the start, if it is not told
        self._start: SE2 | None = None
        self._sides: U8 | None = None
        self._spec: GridSpec | None = None
        self._stride = self._way_stride = 1

    def update(self, occupancy: OccupancyGrid, map_from_base: SE2, boundary: Boundary = ()) -> None:
        """Take a map; the first pose is the start. `boundary` goes before that of the configuration."""
        if self._start is None:
            self._start = map_from_base
        if self.center is None:
            self.center = (map_from_base.x, map_from_base.y)
        c, spec = self.config, occupancy.spec
        self._spec, self._way_stride = spec, max(1, round(c.way_cell / spec.resolution))
        self._stride = self._way_stride * max(1, round(c.cell / (self._way_stride * spec.resolution)))
        sides = np.full((-(-spec.height // self._stride), -(-spec.width // self._stride)), Side.INSIDE, np.uint8)
        if c.structure_reach > 0.0:
            sides[self._far_from_structure(occupancy.data)] = Side.BEYOND_STRUCTURE
        polygon = boundary or c.boundary
        if polygon or c.radius > 0.0:
            sides[self._beyond(polygon, sides.shape)] = Side.BEYOND_BOUNDARY
        self._sides = sides if sides.any() else None

    def sides_of(self, cells: NDArray[np.int64]) -> U8:
        """Return the `Side` of flat cells of the last map, uint8 (N,)."""
        if self._sides is None or self._spec is None:
            return np.zeros(len(cells), np.uint8)
        iy, ix = np.divmod(cells, self._spec.width)
        return np.asarray(self._sides[iy // self._stride, ix // self._stride])

    def inside(self, costs: CostGrid, map_from_base: SE2) -> CostGrid:
        """Return costs in which all that lies beyond is lethal; as they are when nothing does, or when the robot stands beyond itself."""
        if self._sides is None or self._spec is None:
            return costs
        spec = self._spec
        iy, ix = spec.cell_of(map_from_base.x, map_from_base.y)
        if spec.contains_cell(iy, ix) and self._sides[iy // self._stride, ix // self._stride]:
            return costs
        data, n = costs.data.copy(), self._stride
        beyond = np.repeat(np.repeat(self._sides > 0, n, axis=0), n, axis=1)[: spec.height, : spec.width]
        dy, dx = spec.offset_in(costs.spec)
        y0, x0 = max(0, dy), max(0, dx)
        y1, x1 = min(data.shape[0], dy + spec.height), min(data.shape[1], dx + spec.width)
        data[y0:y1, x0:x1][beyond[y0 - dy : y1 - dy, x0 - dx : x1 - dx]] = COST_LETHAL
        return CostGrid(costs.stamp_ns, costs.frame, costs.spec, data)

    def _far_from_structure(self, occupancy: NDArray[np.int8]) -> NDArray[np.bool_]:
        """Tell which coarse cells [iy, ix] lie too far from any surface, or from the hull of all."""
        assert self._spec is not None
        n, fine, c = self._stride, self._way_stride, self.config
        fine_counts = _summed(occupancy >= OCC_OCCUPIED, fine)
        is_surface, counts = fine_counts > 0, _summed(fine_counts, n // fine).astype(np.float32)
        around = cv2.boxFilter(counts, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        is_structure = (counts > 0) & (around * self._spec.resolution >= c.structure_least)
        if not is_structure.any():
            return np.ones(counts.shape, np.bool_)
        held = is_surface & _spread(is_structure, n // fine, is_surface.shape)
        hull = np.zeros(is_surface.shape, np.uint8)
        cv2.fillConvexPoly(hull, cv2.convexHull(np.argwhere(held)[:, ::-1].astype(np.int32)), 1)
        is_near = _summed(hull | self._reached_from(hull, is_surface), n // fine) > 0
        return np.asarray((_away(is_structure) * n * self._spec.resolution > c.structure_reach) | ~is_near)

    def _reached_from(self, hull: U8, is_surface: NDArray[np.bool_]) -> U8:
        """Tell which fine cells [iy, ix] lie within reach of ways around surfaces from inside the hull, or from the start."""
        assert self._spec is not None
        assert self._start is not None
        fine = self._way_stride
        passable = (~is_surface).astype(np.uint8)
        edge = np.bitwise_and(np.asarray(cv2.erode(hull, RIM), np.uint8), passable)
        iy, ix = self._spec.cell_of(self._start.x, self._start.y)
        if self._spec.contains_cell(iy, ix):
            edge[iy // fine, ix // fine] = 1
        steps = math.ceil(self.config.open_reach / (fine * self._spec.resolution))
        if steps < 1:
            return edge
        # Not diagonally: a wall may run so.
        reached = np.bitwise_and(np.asarray(cv2.dilate(edge, CROSS), np.uint8), passable)
        spread_steps(np.flatnonzero(reached > edge), reached, passable, steps - 1)
        return reached

    def _beyond(self, polygon: Boundary, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Tell which coarse cells [iy, ix] have their middle outside of the polygon or the circle."""
        assert self._spec is not None
        assert self.center is not None
        size = self._stride * self._spec.resolution
        x = self._spec.origin_x + (np.arange(shape[1]) + 0.5) * size
        y = self._spec.origin_y + (np.arange(shape[0]) + 0.5) * size
        is_beyond = np.zeros(shape, np.bool_)
        if self.config.radius > 0.0:
            is_beyond |= np.hypot(y[:, None] - self.center[1], x[None] - self.center[0]) > self.config.radius
        if polygon:
            is_beyond |= ~is_inside(polygon, x[None], y[:, None])
        return is_beyond


def _summed(cells: NDArray[Any], n: int) -> NDArray[np.uint16]:
    """Return the sums of squares of n x n cells; those at the end may be cut off."""
    rows = np.zeros((-(-cells.shape[0] // n), cells.shape[1]), np.uint16)
    sums = np.zeros((len(rows), -(-cells.shape[1] // n)), np.uint16)
    for k in range(n):
        part = cells[k::n]
        rows[: len(part)] += part
    for k in range(n):
        part = rows[:, k::n]
        sums[:, : part.shape[1]] += part
    return sums


def _spread(cells: NDArray[np.bool_], n: int, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return each cell as n x n ones, cut to a shape."""
    return np.asarray(cells.repeat(n, axis=0).repeat(n, axis=1)[: shape[0], : shape[1]])


def _away(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return each cell's distance to the nearest one of a mask, cells."""
    return np.asarray(cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5))


def is_inside(polygon: Boundary, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Tell which points lie inside a closed polygon (even-odd rule); `x` and `y` are broadcast."""
    inside = np.zeros(np.broadcast_shapes(x.shape, y.shape), np.bool_)
    for (x0, y0), (x1, y1) in zip(polygon, (*polygon[1:], polygon[0]), strict=True):
        if y0 != y1:
            inside ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
    return inside
