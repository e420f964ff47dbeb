"""An ideal world for comparing strategies: a true grid, a scanner without noise, a round robot that follows paths exactly."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_FREE, COST_LETHAL, COST_UNKNOWN, OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN, GridSpec
from ambler.core.messages import CostGrid, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.exploration.survey import DistanceField
from ambler.kernels.grid_world import sense


class GridWorld:
    """`truth` int8 [iy, ix] holds free and occupied cells only. The robot sees `sensor_range` (m) far in all directions."""

    def __init__(
        self,
        spec: GridSpec,
        truth: NDArray[np.int8],
        start: SE2,
        distance_field: DistanceField,
        *,
        sensor_range: float = 5.0,
        robot_radius: float = 0.25,
        rays: int = 720,
    ) -> None:
        self.spec = spec
        self.truth = truth
        self.pose = start
        self.driven = 0.0
        self.built = np.full(spec.shape, OCC_UNKNOWN, np.int8)
        self._distance_field = distance_field
        reach = round(robot_radius / spec.resolution)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        self._body = (x * x + y * y <= reach * reach).astype(np.uint8)
        self._rays = rays
        self.reach_cells = sensor_range / spec.resolution
        self.reachable = np.isfinite(distance_field(self._inflate(truth), spec, start))
        self.sense()

    def sense(self) -> None:
        """Mark what the scanner sees from here: free cells up to the first occupied one, and that one."""
        x = (self.pose.x - self.spec.origin_x) / self.spec.resolution
        y = (self.pose.y - self.spec.origin_y) / self.spec.resolution
        sense(self.truth, OCC_OCCUPIED, x, y, self._rays, self.reach_cells, OCC_FREE, OCC_OCCUPIED, self.built)

    def map(self, stamp_ns: int) -> OccupancyGrid:
        """Return the map built so far."""
        return OccupancyGrid(stamp_ns, "map", self.spec, self.built.copy())

    def costs(self, stamp_ns: int) -> CostGrid:
        """Return costs: lethal where the round robot would touch something, unknown where nothing is known."""
        return CostGrid(stamp_ns, "map", self.spec, self._inflate(self.built))

    def coverage(self) -> float:
        """Return the share of the cells that the robot can reach that it has seen free."""
        seen = np.count_nonzero(self.reachable & (self.built == OCC_FREE))
        return seen / int(np.count_nonzero(self.reachable))

    def drive(self, map_from_goal: SE2, distance: float, step: float = 0.25) -> bool | None:
        """Follow the shortest path for a distance, sensing every `step` metres; True: arrived, None: no path, False: under way."""
        iy, ix = self.spec.cell_of(map_from_goal.x, map_from_goal.y)
        to_goal = self._distance_field(self._inflate(self.built), self.spec, map_from_goal)
        sensed = self.driven
        end = self.driven + distance
        while self.driven < end:
            cell = self.spec.cell_of(self.pose.x, self.pose.y)
            if cell == (iy, ix):
                break
            best = self.downhill(to_goal, cell)
            if best is None:
                return None
            x, y = self.spec.center_of(*best)
            self.driven += math.hypot(x - self.pose.x, y - self.pose.y)
            self.pose = SE2(x, y, 0.0)
            if self.driven - sensed >= step:
                sensed = self.driven
                self.sense()
        self.sense()
        return self.spec.cell_of(self.pose.x, self.pose.y) == (iy, ix)

    def distances_from(self, place: SE2) -> NDArray[np.float32]:
        """Return the path lengths from a place to every cell of the true grid, metres; inf: the robot cannot go there."""
        return self._distance_field(self._inflate(self.truth), self.spec, place)

    def downhill(self, to_goal: NDArray[np.float32], cell: tuple[int, int]) -> tuple[int, int] | None:
        """Return the neighbour of a cell that is nearest to the goal of a distance field, None when none is nearer."""
        best, lowest = None, float(to_goal[cell])
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                near = (cell[0] + dy, cell[1] + dx)
                if self.spec.contains_cell(*near) and to_goal[near] < lowest:
                    best, lowest = near, float(to_goal[near])
        return best

    def _inflate(self, occupancy: NDArray[np.int8]) -> NDArray[np.uint8]:
        hit = cv2.dilate((occupancy >= OCC_OCCUPIED).astype(np.uint8), self._body)
        iy, ix = self.spec.cell_of(self.pose.x, self.pose.y)
        if hit[
            iy, ix
        ]:  # the robot fits where it stands, and may leave; elsewhere it would squeeze itself into where it cannot come back from
            reach = self._body.shape[0] // 2
            around = np.s_[max(0, iy - reach) : iy + reach + 1, max(0, ix - reach) : ix + reach + 1]
            hit[around][occupancy[around] < OCC_OCCUPIED] = 0
        costs = np.where(occupancy < 0, COST_UNKNOWN, COST_FREE).astype(np.uint8)
        costs[hit > 0] = COST_LETHAL
        return costs
