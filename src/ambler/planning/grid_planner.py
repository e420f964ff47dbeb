"""The global planner: the least-cost path on the 8-connected grid, then pulled tight off the grid's directions.

Cost of a path = integral of (1 + factor * c / neutral) ds along it, in metres that feel like free ones: an edge of length L between
cells of cost a and b costs L * (w_a + w_b) / 2 with w = round(neutral + factor * c) / neutral. The search is exact on that graph
(kernels.graph_search); from it the any-angle path is found that costs least nearby (kernels.any_angle), never closer to an obstacle.
The reported cost is the integral along the path that is returned.
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
from ambler.kernels import any_angle
from ambler.kernels import graph_search as kernels
from ambler.planning.escape import find_escape
from ambler.planning.unknown import with_surroundings

Cell = tuple[int, int]
CellPath = NDArray[np.int64]
INT32_LIMIT = 2**31 - 2**22


@dataclass(frozen=True, slots=True)
class PlannerConfig:
    """`neutral` and `factor` weigh length against cost (50 and 0.8 as navfn). Cells of cost >= `lethal_from` are forbidden;
    unknown ones too, unless allowed. `goal_tolerance` (m) limits how far a substitute of an occupied or unknown goal may lie;
    `escape_radius` (m) how far a start on a forbidden cell may lie from a free one: the circumscribed radius of the robot; `way_out` (m) how far
    over inscribed cells alone.
    The path leaves the eight directions when it `is_smooth`: it gets corners `corner_cells` apart while it is pulled tight, then half as far, in at most `sweeps` over
    them; a leg replaces up to `shortcut_window` corners. The path's points lie at most `spacing` (m) apart."""

    neutral: int = 50
    factor: float = 0.8
    lethal_from: int = COST_INSCRIBED
    is_unknown_allowed: bool = False
    margin: float = 10.0  # metres of unknown ground that the map is laid in, where unknown cells are allowed
    goal_tolerance: float = math.inf
    escape_radius: float = 0.6
    way_out: float = 0.0
    spacing: float = 0.05
    is_smooth: bool = True
    # Of 4, 6, 8, 12 and 16 cells: 8 takes least time within 0.02 % of the least cost, in generated clutter and rooms
    corner_cells: int = 8
    sweeps: int = 10  # 20 gain 0.001 % more
    shortcut_window: int = 200  # corners; fewer cut long straight legs in halls, 0.2 % dearer

    def __post_init__(self) -> None:
        for name in ("corner_cells", "shortcut_window", "spacing"):
            if getattr(self, name) <= 0:
                raise BadInputError(f"planner.{name} must be positive, not {getattr(self, name):g}")


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
        on a forbidden cell, or in a pocket between such, leaves it by the cheapest way. Raises StartOutsideMapError, GoalOutsideMapError, StartOccupiedError
        (nothing free within the escape radius) or NoValidPathError.
        """
        if self.config.is_unknown_allowed and costs.shape == spec.shape:
            costs, spec = with_surroundings(costs, spec, [(start.x, start.y), (goal.x, goal.y)], self.config.margin)
        start_cell, goal_cell = self._cells(costs, spec, start, goal)
        self._weigh(costs)
        radius, reach = self.config.escape_radius / spec.resolution, self.config.way_out / spec.resolution
        escape = find_escape(costs, self._weights[1:-1, 1:-1] != 0, start_cell, radius, reach, goal_cell)
        begin = escape[-1]
        reached = self._search(begin, goal_cell)
        if reached != goal_cell:
            self._check_substitute(spec, reached, goal)
        is_exact = reached == goal_cell
        points, metres = self._points(spec, escape, reached, start, goal if is_exact else None)
        distance = 0.0 if is_exact else float(np.hypot(points[-1, 0] - goal.x, points[-1, 1] - goal.y))
        path = any_angle.to_poses(points, float(goal.yaw), self.config.spacing)
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

    def _search(self, begin: Cell, goal: Cell) -> Cell:
        """Return the cell that was reached: the goal, or its substitute."""
        iy, ix = goal
        if self._weights[iy + 1, ix + 1] == 0:
            status, cost = self._sweep(begin, (-2, -2))
            iy, ix = kernels.nearest_reached(cost, iy + 1, ix + 1)
            return int(iy) - 1, int(ix) - 1
        status, _ = self._sweep(begin, goal)
        if status != kernels.REACHED:
            raise NoValidPathError(
                "no path leads to the goal: what is known and free around the robot does not reach it"
            )
        return goal

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
    ) -> tuple[NDArray[np.float64], float]:
        """Return the corners (N, 2) of the path in metres, from the exact start to the exact goal (None: the cell's centre), and its
        cost."""
        points = kernels.path_points(self._state, reached[0] + 1, reached[1] + 1)  # in the grid with its border
        offset = np.array([spec.origin_y, spec.origin_x]) / spec.resolution - 1.0
        is_escaped = len(escape) > 1
        if not is_escaped:
            points[0] = np.array([start.y, start.x]) / spec.resolution - offset
        if goal is not None:
            last = np.array([goal.y, goal.x]) / spec.resolution - offset
            if len(points) == 1:
                points = np.vstack((points, last))
            else:
                points[-1] = last
        c = self.config
        if c.is_smooth and len(points) > 2:
            points = any_angle.any_angle(
                self._weights, points, c.neutral, float(c.corner_cells), c.sweeps, c.shortcut_window
            )
        cost = float(any_angle.path_cost(self._weights, points)) * spec.resolution / c.neutral
        metres = ((points + offset) * spec.resolution)[:, ::-1]
        if is_escaped:
            way = spec.centers_of(np.array(escape[1:-1], np.int64).reshape(-1, 2))
            metres = np.vstack(([[start.x, start.y]], way, metres))
            cost += float(np.hypot(*np.diff(np.asarray(escape), axis=0).T).sum()) * spec.resolution
        return np.ascontiguousarray(metres), cost


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
