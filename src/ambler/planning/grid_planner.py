"""The global planner: the least-cost path on the 8-connected grid, then shortcuts that never come closer to an obstacle.

Cost of a path = integral of (1 + factor * c / neutral) ds along it, in metres that feel like free ones: an edge of length L between
cells of cost a and b costs L * (w_a + w_b) / 2 with w = round(neutral + factor * c) / neutral. The search is exact on that graph
(kernels.graph_search); the reported cost is the graph's, before the shortcuts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import (
    BadInputError,
    GoalOutsideMapError,
    NoValidPathError,
    StartOutsideMapError,
)
from ambler.core.grid import COST_INSCRIBED, COST_UNKNOWN, GridSpec
from ambler.core.protocols import PlanResult
from ambler.core.se2 import SE2
from ambler.kernels import graph_search as kernels
from ambler.planning.escape import find_escape

Cell = tuple[int, int]
CellPath = NDArray[np.int64]
INT32_LIMIT = 2**31 - 2**22


@dataclass(frozen=True, slots=True)
class PlannerConfig:
    """`neutral` and `factor` weigh length against cost (50 and 0.8 as navfn). Cells of cost >= `lethal_from` are forbidden;
    unknown ones too, unless allowed. `goal_tolerance` (m) limits how far a substitute of an occupied or unknown goal may lie;
    `escape_radius` (m) how far a start on a forbidden cell may lie from a free one: the circumscribed radius of the robot.
    The path's points lie at most `spacing` (m) apart."""

    neutral: int = 50
    factor: float = 0.8
    lethal_from: int = COST_INSCRIBED
    is_unknown_allowed: bool = False
    goal_tolerance: float = math.inf
    escape_radius: float = 0.6
    is_smooth: bool = True
    spacing: float = 0.05
    shortcut_window: int = 400


class GridPlanner:
    """Implements core.protocols.GlobalPlanner. Keeps its memory between calls, but no state."""

    def __init__(self, config: PlannerConfig | None = None) -> None:
        self.config = config or PlannerConfig()
        self._table = weight_table(self.config)
        self._weights: NDArray[np.uint16] = np.zeros((0, 0), np.uint16)
        self._cost: NDArray[np.int32] = np.zeros((0, 0), np.int32)
        self._state: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)

    def plan(self, costs: NDArray[np.uint8], spec: GridSpec, start: SE2, goal: SE2) -> PlanResult:
        """Return a path from start to goal in the frame of `spec`.

        A goal on a forbidden cell is replaced by the nearest reachable cell, and `goal_distance` says how far that lies. A start
        on a forbidden cell leaves it by the cheapest way. Raises StartOutsideMapError, GoalOutsideMapError, StartOccupiedError
        (nothing free within the escape radius) or NoValidPathError.
        """
        start_cell, goal_cell = self._cells(costs, spec, start, goal)
        self._weigh(costs)
        escape = find_escape(costs, self._weights, start_cell, self.config.escape_radius / spec.resolution)
        begin = escape[-1]
        reached, cost = self._search(begin, goal_cell)
        if reached != goal_cell:
            self._check_substitute(spec, reached, goal)
        is_exact = reached == goal_cell
        points = self._points(spec, escape, reached, start, goal if is_exact else None)
        distance = 0.0 if is_exact else float(np.hypot(points[-1, 0] - goal.x, points[-1, 1] - goal.y))
        escaped = len(escape) > 1
        metres = cost * spec.resolution / (2.0 * kernels.STRAIGHT * self.config.neutral)
        path = to_poses(points, goal.yaw, self.config.spacing)
        if escaped:
            metres += float(np.hypot(*np.diff(np.asarray(escape), axis=0).T).sum()) * spec.resolution
        return PlanResult(path, metres, distance)

    def _cells(self, costs: NDArray[np.uint8], spec: GridSpec, start: SE2, goal: SE2) -> tuple[Cell, Cell]:
        if costs.shape != spec.shape or max(spec.shape) > 32000:
            raise BadInputError(
                f"a cost grid of {costs.shape} cells with a geometry of {spec.shape} cannot be planned on"
            )
        if not (math.isfinite(start.x + start.y) and spec.contains(start.x, start.y)):
            raise StartOutsideMapError(f"the robot at ({start.x:.2f}, {start.y:.2f}) is outside the map")
        if not (math.isfinite(goal.x + goal.y + goal.yaw) and spec.contains(goal.x, goal.y)):
            raise GoalOutsideMapError(f"the goal ({goal.x:.2f}, {goal.y:.2f}) is outside the map")
        return spec.cell_of(start.x, start.y), spec.cell_of(goal.x, goal.y)

    def _weigh(self, costs: NDArray[np.uint8]) -> None:
        shape = (costs.shape[0] + 2, costs.shape[1] + 2)
        if self._weights.shape != shape:
            self._weights, self._state = np.zeros(shape, np.uint16), np.zeros(shape, np.uint8)
            self._cost = np.zeros(shape, np.int32)
        kernels.weigh(np.ascontiguousarray(costs), self._table, self._weights)

    def _search(self, begin: Cell, goal: Cell) -> tuple[Cell, int]:
        """Return the cell that was reached (the goal, or its substitute) and the cost in the kernel's integers."""
        iy, ix = goal
        if self._weights[iy + 1, ix + 1] == 0:
            status, cost = self._sweep(begin, (-2, -2))
            iy, ix = kernels.nearest_reached(cost, iy + 1, ix + 1)
            return (int(iy) - 1, int(ix) - 1), int(cost[iy, ix])
        status, cost = self._sweep(begin, goal)
        if status != kernels.REACHED:
            raise NoValidPathError(
                "no path leads to the goal: what is known and free around the robot does not reach it"
            )
        return goal, int(cost[iy + 1, ix + 1])

    def _sweep(self, begin: Cell, goal: Cell) -> tuple[int, NDArray[np.int32] | NDArray[np.int64]]:
        least, most = self.config.neutral, int(self._table.max())
        cells = (begin[0] + 1, begin[1] + 1, goal[0] + 1, goal[1] + 1)
        self._cost.fill(INT32_LIMIT)
        status = kernels.search(self._weights, *cells, least, most, self._cost, self._state)
        if status != kernels.OVERFLOW:
            return status, self._cost
        cost = np.full(self._state.shape, 2**60, np.int64)  # a path of more than some 700 000 cells
        return kernels.search(self._weights, *cells, least, most, cost, self._state), cost

    def _check_substitute(self, spec: GridSpec, cell: Cell, goal: SE2) -> None:
        x, y = spec.center_of(*cell)
        distance = math.hypot(x - goal.x, y - goal.y)
        if distance > self.config.goal_tolerance:
            raise NoValidPathError(
                f"the goal is not free, and the nearest reachable place lies {distance:.2f} m away"
                f" (allowed: {self.config.goal_tolerance:.2f} m)"
            )

    def _points(
        self, spec: GridSpec, escape: list[Cell], reached: Cell, start: SE2, goal: SE2 | None
    ) -> NDArray[np.float64]:
        """Return the corners (N, 2) of the path in metres, from the exact start to the exact goal (None: the cell's centre)."""
        packed = np.empty(4096, np.int32)
        n = kernels.extract_path(self._state, reached[0] + 1, reached[1] + 1, packed)
        if n > len(packed):
            packed = np.empty(n, np.int32)
            kernels.extract_path(self._state, reached[0] + 1, reached[1] + 1, packed)
        cells = packed[:n][::-1].astype(np.int64)
        points = np.column_stack((cells >> 16, cells & 0xFFFF)) + 0.5  # (y, x) in cells of the grid with its border
        offset = np.array([spec.origin_y, spec.origin_x]) / spec.resolution - 1.0
        is_escaped = len(escape) > 1
        if not is_escaped:
            points[0] = np.array([start.y, start.x]) / spec.resolution - offset
        if goal is not None:
            last = np.array([goal.y, goal.x]) / spec.resolution - offset
            points = np.vstack((points, last)) if n == 1 else np.vstack((points[:-1], last))
        if self.config.is_smooth and len(points) > 2:
            keep = np.empty(len(points), np.bool_)
            kernels.shortcut(self._weights, points, self.config.shortcut_window, keep)
            points = points[keep]
        metres = ((points + offset) * spec.resolution)[:, ::-1]
        if is_escaped:
            way = spec.centers_of(np.array(escape[1:-1], np.int64).reshape(-1, 2))
            metres = np.vstack(([[start.x, start.y]], way, metres))
        return np.ascontiguousarray(metres)


def weight_table(config: PlannerConfig) -> NDArray[np.uint16]:
    """Return the integer weight of each cost, uint16 (256,); 0 is forbidden."""
    cost = np.arange(256)
    weights = np.rint(config.neutral + config.factor * cost)
    if config.neutral < 1 or config.factor < 0 or weights.max() > 65535:
        raise BadInputError(f"planner: neutral {config.neutral} and factor {config.factor} give no usable weights")
    table = np.where(cost < config.lethal_from, weights, 0.0).astype(np.uint16)
    dearest = round(config.neutral + config.factor * (COST_INSCRIBED - 1))
    table[COST_UNKNOWN] = dearest if config.is_unknown_allowed else 0
    return table


def to_poses(points: NDArray[np.float64], last_yaw: float, spacing: float) -> NDArray[np.float64]:
    """Return poses (N, 3) along the corners (M, 2), at most `spacing` metres apart, facing forward; the last faces `last_yaw`."""
    if len(points) == 1:
        points = np.vstack((points, points))
    leg = np.diff(points, axis=0)
    length = np.hypot(leg[:, 0], leg[:, 1])
    pieces = np.maximum(1, np.ceil(length / spacing - 1e-9).astype(np.int64))
    which = np.repeat(np.arange(len(leg)), pieces)
    place = np.arange(len(which)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    poses = np.empty((len(which) + 1, 3))
    poses[:-1, :2] = points[:-1][which] + leg[which] * (place / pieces[which])[:, None]
    poses[-1, :2] = points[-1]
    poses[:-1, 2] = np.arctan2(leg[:, 1], leg[:, 0])[which]
    poses[-1, 2] = last_yaw
    if length.sum() == 0.0:
        poses[:, 2] = last_yaw
    return poses
