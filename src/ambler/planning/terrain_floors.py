"""Floors seen by a robot in three dimensions: what terrain clouds and local grids say of each cell, collected over time, floor by floor.

A point of a terrain cloud is (x, y, z, height above the local ground). In each update a cell that holds an obstacle is hit, one that holds only ground
is passed; hits and passes are counted up and down between two limits. So one hit makes an obstacle at once, and one that left goes
after some passes. Floors are told apart by the height of the ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import OCC_OCCUPIED, GridSpec
from ambler.kernels.distance_transform import LETHAL, inflate
from ambler.planning.clearance_map import FORBIDDEN, FREE, UNKNOWN, Box
from ambler.planning.visibility_graph import Updated, VisibilityGraph

U8 = NDArray[np.uint8]
BLOCK = 64  # cells by which a floor grows


@dataclass(frozen=True, slots=True)
class TerrainConfig:
    """Cells of `resolution` m. Points higher than `free_height` above the ground are obstacles; cells within `radius` of one are forbidden (the
    robot's, with what it keeps). Ground within half of `floor_height` of the robot's belongs to its floor. A hit counts `hit`, a pass -1, up to `limit` and down to
    where one hit is enough; from `occupied` on a cell is an obstacle."""

    resolution: float = 0.1
    free_height: float = 0.15
    radius: float = 0.35
    floor_height: float = 2.0
    hit: int = 3
    occupied: int = 2
    limit: int = 6

    @property
    def radius_cells(self) -> int:
        return math.ceil(self.radius / self.resolution - 1e-9)


class Floor:
    """One floor: `height` of its ground (m), counts and what they mean for the robot's centre, in a grid that grows."""

    def __init__(self, config: TerrainConfig, height: float) -> None:
        self.config = config
        self.height = height
        self.spec = GridSpec(config.resolution, 0, 0, 0.0, 0.0)
        self.counts = np.zeros((0, 0), np.int8)
        self.is_seen = np.zeros((0, 0), np.bool_)
        n = config.radius_cells
        self._table = np.zeros(n * n + 2, np.uint8)
        reach = (config.radius / config.resolution + 1e-9) ** 2
        self._table[: n * n + 1] = np.where(np.arange(n * n + 1) <= reach, 253, 0)

    def observe(self, hits: NDArray[np.floating], passes: NDArray[np.floating]) -> Box | None:
        """Take points (N, 2) on obstacles and on free ground; returns the box of the cells that may mean something else now."""
        points = np.vstack((hits[:, :2], passes[:, :2]))
        if len(points) == 0:
            return None
        self._hold(points)
        cells = self.spec.cells_of(points)
        y0, x0 = cells.min(axis=0)
        y1, x1 = cells.max(axis=0) + 1
        shape = (y1 - y0, x1 - x0)
        is_hit, is_passed = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
        own = cells - [y0, x0]
        is_hit[own[: len(hits), 0], own[: len(hits), 1]] = True
        is_passed[own[len(hits) :, 0], own[len(hits) :, 1]] = True
        c, part = self.config, self.counts[y0:y1, x0:x1]
        change = np.where(is_hit, c.hit, np.where(is_passed, -1, 0))
        part[:] = np.clip(part + change, c.occupied - c.hit, c.limit)
        self.is_seen[y0:y1, x0:x1] |= is_hit | is_passed
        r = c.radius_cells
        return (
            *(max(0, int(y0) - r), min(self.spec.height, int(y1) + r)),
            *(max(0, int(x0) - r), min(self.spec.width, int(x1) + r)),
        )

    def cells(self, box: Box) -> U8:
        """Return what a box of cells means for the robot's centre: UNKNOWN, FREE or FORBIDDEN."""
        r = self.config.radius_cells
        y0, y1, x0, x1 = box
        wide = (
            slice(max(0, y0 - r), min(self.spec.height, y1 + r)),
            slice(max(0, x0 - r), min(self.spec.width, x1 + r)),
        )
        source = np.where(self.counts[wide] >= self.config.occupied, LETHAL, 0).astype(np.uint8)
        out = np.empty_like(source)
        inflate(source, 0, source.shape[0], 0, source.shape[1], r, self._table, out)
        oy, ox = wide[0].start, wide[1].start
        near = out[y0 - oy : y1 - oy, x0 - ox : x1 - ox]
        known = np.where(self.is_seen[y0:y1, x0:x1], FREE, UNKNOWN)
        return np.where(near >= 253, FORBIDDEN, known).astype(np.uint8)

    def _hold(self, points: NDArray[np.floating]) -> None:
        """Grow by whole blocks until all points lie inside."""
        step = BLOCK * self.config.resolution
        low, high = points.min(axis=0) - step, points.max(axis=0) + step
        old = self.spec
        if old.width:
            origin = np.array([old.origin_x, old.origin_y])
            end = origin + np.array([old.width, old.height]) * old.resolution
            if (points.min(axis=0) >= origin).all() and (points.max(axis=0) < end).all():
                return
            low, high = np.minimum(low, origin), np.maximum(high, end)
        first, last = np.floor(low / step + 1e-9).astype(int), np.ceil(high / step - 1e-9).astype(int)
        width, height = ((last - first) * BLOCK).tolist()
        spec = GridSpec(self.config.resolution, width, height, *(first * step).tolist())
        counts, is_seen = np.zeros(spec.shape, np.int8), np.zeros(spec.shape, np.bool_)
        if old.width:
            dy, dx = old.offset_in(spec)
            part = (slice(dy, dy + old.height), slice(dx, dx + old.width))
            counts[part], is_seen[part] = self.counts, self.is_seen
        self.spec, self.counts, self.is_seen = spec, counts, is_seen


class TerrainFloors:
    """Feeds a visibility graph from terrain clouds or local grids, floor by floor."""

    def __init__(self, graph: VisibilityGraph, config: TerrainConfig | None = None) -> None:
        self.config = config or TerrainConfig()
        self.graph = graph
        self.floors: list[Floor] = []

    def floor_at(self, height: float) -> int:
        """Return the number of the floor whose ground lies nearest to a height, a new one where none is near."""
        away = [abs(floor.height - height) for floor in self.floors]
        if away and min(away) <= 0.5 * self.config.floor_height:
            return int(np.argmin(away))
        self.floors.append(Floor(self.config, height))
        return len(self.floors) - 1

    def observe_cloud(self, points_map: NDArray[np.floating], robot: tuple[float, float, float]) -> Updated:
        """Take a terrain cloud (N, 4) of (x, y, z, height above the local ground) in the map frame, seen by a robot that stands at (x, y, z of its
        ground)."""
        c, number = self.config, self.floor_at(robot[2])
        ground = points_map[:, 2] - points_map[:, 3]
        mine = points_map[np.abs(ground - robot[2]) <= 0.5 * c.floor_height]
        is_obstacle = mine[:, 3] >= c.free_height
        return self._observed(number, robot, mine[is_obstacle, :2], mine[~is_obstacle, :2])

    def observe_grid(self, spec: GridSpec, occupancy: NDArray[np.int8], robot: tuple[float, float, float]) -> Updated:
        """Take a local occupancy grid int8 [iy, ix] (-1 unknown, 0 free, 100 occupied) in the map frame, seen by a robot that stands there."""
        hits = spec.centers_of(np.argwhere(occupancy >= OCC_OCCUPIED))
        passes = spec.centers_of(np.argwhere((occupancy >= 0) & (occupancy < OCC_OCCUPIED)))
        return self._observed(self.floor_at(robot[2]), robot, hits, passes)

    def _observed(
        self,
        number: int,
        robot: tuple[float, float, float],
        hits: NDArray[np.floating],
        passes: NDArray[np.floating],
    ) -> Updated:
        floor = self.floors[number]
        box = floor.observe(hits, passes)
        updated = Updated()
        if box is not None:
            updated = self.graph.update_box(floor.spec, floor.cells(box), box, number, floor.height)
        self.graph.drive(robot[0], robot[1], number, robot[2])
        return updated
