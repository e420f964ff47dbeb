"""One local cost grid, prepared for footprint checks: row sums and the exact distance field of its lethal cells."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.kernels.footprint import LethalCells, Outline, footprint_edges, lethal_distance, lethal_row_sums
from ambler.kernels.rollout import covered_at_start, free_slide, free_turn

F64 = NDArray[np.float64]


def covering_circles(normals: F64, offsets: F64) -> F64:
    """Return circles (M, 3) of (x, y, r) that together cover a convex polygon given by its edges: a row along its length."""
    following, reach = np.roll(normals, -1, axis=0), np.roll(offsets, -1)
    corners = np.linalg.solve(np.stack((normals, following), axis=1), np.stack((offsets, reach), axis=1)[..., None])[
        ..., 0
    ]
    low, high = corners.min(axis=0), corners.max(axis=0)
    length, width = float(high[0] - low[0]), float(high[1] - low[1])
    count = max(1, math.ceil(length / width))
    radius = math.hypot(length / count / 2.0, width / 2.0)
    x = low[0] + (np.arange(count) + 0.5) * length / count
    return np.stack((x, np.full(count, (low[1] + high[1]) / 2.0), np.full(count, radius)), axis=1)


class LocalWindow:
    """Answers where the filled, padded footprint is free. Only lethal cells collide; unknown and outside count as free, because
    a local window sees no farther (the velocity gate watches what it does not show)."""

    def __init__(self, robot: RobotModel, padding: float) -> None:
        edges = footprint_edges(robot.footprint, padding)
        self.outline = Outline(*edges, covering_circles(*edges))
        self.inscribed_radius = robot.inscribed_radius
        self.radius = robot.circumscribed_radius + padding
        self.spec = GridSpec(0.05, 0, 0, 0.0, 0.0)
        self._costs: NDArray[np.uint8] | None = None
        self.cells = LethalCells(np.zeros((0, 1), np.int32), np.zeros((0, 0)), 0.05)

    @property
    def distance(self) -> F64:
        """The distance of each cell's centre to the nearest lethal one, float64 [iy, ix], metres."""
        return self.cells.distance

    @property
    def costs(self) -> NDArray[np.uint8]:
        """The cost grid of now, uint8 [iy, ix]."""
        return self._costs if self._costs is not None else np.zeros((0, 0), np.uint8)

    def update(self, costs: NDArray[np.uint8], spec: GridSpec) -> None:
        """Take a cost grid uint8 [iy, ix] that nobody writes to any more; one that it has already costs nothing."""
        if costs is self._costs and spec == self.spec:
            return
        self._costs = costs
        row_sums, distance, _ = self.cells
        if spec.shape != distance.shape:
            row_sums, distance = np.zeros((spec.height, spec.width + 1), np.int32), np.zeros(spec.shape)
        self.spec, self.cells = spec, LethalCells(row_sums, distance, float(spec.resolution))
        lethal_row_sums(costs, COST_LETHAL, row_sums)
        lethal_distance(row_sums, spec.resolution, distance)

    def placed(self, odom_from_base: SE2) -> F64:
        """Return (x, y, yaw) measured from the corner of the grid."""
        return np.array(
            [odom_from_base.x - self.spec.origin_x, odom_from_base.y - self.spec.origin_y, odom_from_base.yaw]
        )

    def lethal_cells(self, odom_from_base: SE2) -> int:
        """Count the lethal cells under the footprint."""
        return int(covered_at_start(self.placed(odom_from_base), self.cells, self.outline))

    def free_turn(self, odom_from_base: SE2, angle: float) -> float:
        """Return how far the robot can turn in place, signed radians, at most `angle`."""
        return float(free_turn(self.placed(odom_from_base), angle, self.cells, self.outline))

    def free_slide(self, odom_from_base: SE2, heading: float, length: float) -> float:
        """Return how far the robot can move along a direction of the odom frame without turning, at most `length` metres."""
        return float(free_slide(self.placed(odom_from_base), heading, length, self.cells, self.outline))
