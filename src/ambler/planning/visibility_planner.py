"""The global planner on a dynamic visibility graph, for known and unknown ground alike.

The costs that it is given update the graph where they differ from the last ones. A way through unknown ground is attempted when it is worth it: a metre
of it costs more than one over known ground, above all where obstacles leave little room for a way on, and so does turning round. A way that was begun is kept while no other one is clearly better. The goal counts as unreachable only when
no unknown ground is left that the robot can get to.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError, GoalOutsideMapError, NoValidPathError, StartOutsideMapError
from ambler.core.grid import COST_INSCRIBED, COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.core.messages import VisibilityGraphView
from ambler.core.protocols import PlanResult, PlanStatus
from ambler.core.se2 import SE2
from ambler.kernels import any_angle, line_of_sight, wall_ends
from ambler.kernels import graph_search as grid_kernels
from ambler.planning.clearance_map import FORBIDDEN, FREE, UNKNOWN, ClearanceMap, UnknownPrice
from ambler.planning.escape import find_escape
from ambler.planning.graph_state import from_arrays, to_arrays, view_of
from ambler.planning.unknown import with_surroundings
from ambler.planning.visibility_graph import VisibilityGraph, VisibilityGraphConfig

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
SEEN_WALL, HIDDEN_WALL, WALL_WIDTH = (
    0.6,
    3.0,
    0.5,
)  # metres: of a wall by which its direction is told, how far it is supposed to go on, and how wide that is
NEUTRAL = 50  # the weight of a cell that costs nothing, as the grid planner's


@dataclass(frozen=True, slots=True)
class VisibilityConfig:
    """Cells of cost >= `lethal_from` are forbidden; unknown ones too, unless allowed: then they cost what `price` says, and the map is
    laid in `margin` metres of unknown ground. A way is kept while no other is cheaper by `hysteresis` of it. Inner points of a path
    move away from what is near, up to `clearance` metres beyond what is forbidden, and the path is eased to where the costs, times `factor`, are lower. `goal_tolerance` (m) limits how far a substitute of an occupied goal may
    lie, `escape_radius` (m) how far a start on a forbidden cell from a free one, `way_out` (m) how far over inscribed cells alone. A piece of unknown ground counts as attempted when
    the robot came within `attempted` metres of it. The path's points lie at most `spacing` (m) apart."""

    lethal_from: int = COST_INSCRIBED
    is_unknown_allowed: bool = False
    price: UnknownPrice = field(default_factory=lambda: UnknownPrice(0.5, 3.0, wall=10.0))
    turning: float = 0.5  # m/rad
    margin: float = 10.0
    hysteresis: float = 0.2  # of 0.1 and 0.2, in 16 drawn offices and flats: 0.2 leads there 2 % sooner
    clearance: float = 0.3
    # Of 0, 0.2 and the grid planner's 0.8, in 20 drawn places: 0.2 keeps most of the shorter ways, and the controller gets through doors
    factor: float = 0.2
    goal_tolerance: float = math.inf
    escape_radius: float = 0.6
    way_out: float = 0.0
    attempted: float = 1.0
    spacing: float = 0.05
    graph: VisibilityGraphConfig = field(default_factory=VisibilityGraphConfig)

    def __post_init__(self) -> None:
        if (
            min(self.price.unknown, self.price.doubt, self.turning) < 0.0
            or not 0.0 <= self.hysteresis < 1.0
            or self.spacing <= 0.0
        ):
            raise BadInputError(
                "visibility: prices must not be negative, hysteresis must lie in 0 ... 1, spacing be positive"
            )


class VisibilityPlanner:
    """Implements core.protocols.GraphPlanner. It remembers its graph, the way it is on and what it attempted; `status` tells of the last plan."""

    def __init__(self, config: VisibilityConfig | None = None, saved: Mapping[str, NDArray[Any]] | None = None) -> None:
        """`saved`: what `to_arrays` of another one told, whose graph this one goes on with; raises BadInputError when it is none."""
        self.config = config or VisibilityConfig()
        price = self.config.price if self.config.is_unknown_allowed else None
        if saved is None:
            self.graph = VisibilityGraph(self.config.graph, price)
        else:
            self.graph = from_arrays(saved, self.config.graph, price)
        self.status = PlanStatus.PLANNING
        self._level = 0
        self._table = self._table_of(self.config)
        self._goal: SE2 | None = None
        self._way: F64 = np.zeros((0, 2))
        self._heading = 0.0
        self._target: tuple[float, float] | None = None
        self._attempted: list[tuple[float, float]] = []

    def enter_level(self, level: int) -> None:
        """Take that the costs of the next plans are those of this level of the place: its graph is another one, and so is the way there."""
        if level != self._level:
            self._level, self._goal = level, None

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the graphs of all levels without loss."""
        return to_arrays(self.graph)

    def plan(self, costs: U8, spec: GridSpec, start: SE2, goal: SE2) -> PlanResult:
        """Return a path from start to goal in the frame of `spec`.

        A goal on a forbidden cell is replaced by the nearest reachable cell, and `goal_distance` says how far that lies; so is a goal that what is
        known shuts off, by unknown ground that was not attempted yet. Raises StartOutsideMapError, GoalOutsideMapError, StartOccupiedError or
        NoValidPathError.
        """
        c = self.config
        self.status = PlanStatus.PLANNING
        if c.is_unknown_allowed:
            check_request(costs, spec, start, goal, must_hold=False)
            costs, spec = with_surroundings(costs, spec, [(start.x, start.y), (goal.x, goal.y)], c.margin)
        check_request(costs, spec, start, goal)
        self._begin(goal)
        cells = classes_of(costs, c.lethal_from, is_unknown_allowed=c.is_unknown_allowed)
        self.graph.update(spec, cells, self._level, self._hidden(costs, spec))
        escape = self._escape(costs, cells, spec, start, goal)
        begin = escape[-1] if escape else (start.x, start.y)
        self.graph.drive(*begin, self._level)
        end = (goal.x, goal.y)
        is_goal_free = cells[spec.cell_of(*end)] != FORBIDDEN
        self._heading = float(start.yaw)
        way = self._to_goal(spec, begin, end) if is_goal_free else None
        if way is None:
            end, way = self._to_substitute(spec, begin, goal, is_goal_free=is_goal_free)
        self._way = way
        dark = self._dark(spec, way)
        self.status = PlanStatus.ATTEMPTING if dark > 1e-6 or way is None else PlanStatus.FREE_PATH
        drawn = self._eased(costs, spec, self._extended(spec, way))
        points = np.vstack((escape[:-1], drawn)) if escape else drawn
        cost = self._cost(spec, way)
        away = math.hypot(end[0] - goal.x, end[1] - goal.y)
        return PlanResult(any_angle.to_poses(np.ascontiguousarray(points), float(goal.yaw), c.spacing), cost, away)

    def view(self, stamp_ns: int, frame: str) -> VisibilityGraphView:
        """Return the graph of the level as people are shown it."""
        return view_of(self.graph, stamp_ns, frame, self._level)

    def _hidden(self, costs: U8, spec: GridSpec) -> U8 | None:
        """Return where walls are supposed to go on in unknown ground, uint8; None where it costs nothing."""
        c = self.config
        if not c.is_unknown_allowed or c.price.wall == 0.0:
            return None
        radius, reach, width = (max(1, round(v / spec.resolution)) for v in (SEEN_WALL, HIDDEN_WALL, WALL_WIDTH))
        lines = np.zeros(spec.shape, np.uint8)
        wall_ends.continue_walls(costs, COST_LETHAL, COST_INSCRIBED, COST_UNKNOWN, radius, reach, lines)
        return np.asarray(cv2.dilate(lines, np.ones((width, width), np.uint8)), np.uint8)

    # A goal and the way to it

    @property
    def _ground(self) -> ClearanceMap:
        """What is known of the level."""
        return self.graph.floor(self._level)

    def _begin(self, goal: SE2) -> None:
        """Forget what belonged to another goal."""
        if self._goal is not None and math.hypot(self._goal.x - goal.x, self._goal.y - goal.y) < 1e-6:
            return
        self._goal, self._way, self._target, self._attempted = goal, np.zeros((0, 2)), None, []

    def _to_goal(self, spec: GridSpec, begin: tuple[float, float], end: tuple[float, float]) -> F64 | None:
        """Return the corners of the way to a free goal, None when what is known shuts it off."""
        heading, turning = self._heading, self.config.turning
        found = self.graph.search(begin, end, heading=heading, turning=turning, floor=self._level)
        if found is None:
            found = self.graph.search(
                begin, end, heading=heading, turning=turning, needs_votes=False, floor=self._level
            )
        if found is None:
            found = self._cell_by_cell(spec, begin, end)
        if found is None:
            return None
        kept = self._kept(spec, begin, end)
        if kept is not None and found[1] > kept[1] * (1.0 - self.config.hysteresis):
            return kept[0]
        return found[0]

    def _kept(self, spec: GridSpec, begin: tuple[float, float], end: tuple[float, float]) -> tuple[F64, float] | None:
        """Return what is left of the last way, pulled tight from where the robot is, and its cost; None when it is blocked or led elsewhere."""
        way = self._way
        if len(way) < 2 or math.hypot(way[-1, 0] - end[0], way[-1, 1] - end[1]) > 1e-6:
            return None
        costs = [self._leg(spec, a, b) for a, b in itertools.pairwise(way)]
        first = next((k for k in range(len(way) - 1, 0, -1) if math.isfinite(self._leg(spec, begin, way[k]))), None)
        if first is None or not all(math.isfinite(cost) for cost in costs[first:]):
            return None
        left = np.vstack(([begin], way[first:]))
        return left, self._cost(spec, left)

    def _cost(self, spec: GridSpec, way: F64) -> float:
        """Return what the search says that a way costs (m): its length, what is unknown along it, and the turn with which it begins."""
        step = way[1] - way[0]
        turn = line_of_sight.turned(self._heading, float(step[1]), float(step[0]))
        return sum(self._leg(spec, a, b) for a, b in itertools.pairwise(way)) + self.config.turning * float(turn)

    def _leg(self, spec: GridSpec, a: F64 | tuple[float, float], b: F64 | tuple[float, float]) -> float:
        ground, r = self._ground, spec.resolution
        y0, x0 = (a[1] - spec.origin_y) / r - 0.5, (a[0] - spec.origin_x) / r - 0.5
        y1, x1 = (b[1] - spec.origin_y) / r - 0.5, (b[0] - spec.origin_x) / r - 0.5
        return float(line_of_sight.leg_cost(ground.field, ground.price, y0, x0, y1, x1, r))

    def _cell_by_cell(
        self, spec: GridSpec, begin: tuple[float, float], end: tuple[float, float]
    ) -> tuple[F64, float] | None:
        """Search the cells themselves, for ways too narrow for contours; what is found joins the graph. None proves that there is no way."""
        cells = self._ground.cells
        weights = np.zeros((cells.shape[0] + 2, cells.shape[1] + 2), np.uint16)
        price = 50 + (50 * self._ground.price.astype(np.uint16)) // 16
        weights[1:-1, 1:-1] = np.where(cells == FORBIDDEN, 0, price)
        state, cost = np.zeros(weights.shape, np.uint8), np.full(weights.shape, 2**60, np.int64)
        (sy, sx), (gy, gx) = spec.cell_of(*begin), spec.cell_of(*end)
        found = grid_kernels.search(weights, sy + 1, sx + 1, gy + 1, gx + 1, 50, int(price.max()), cost, state)
        if found != grid_kernels.REACHED:
            return None
        points = grid_kernels.path_points(state, gy + 1, gx + 1)
        offset = np.array([spec.origin_y, spec.origin_x]) / spec.resolution - 1.0
        points = points if len(points) > 1 else np.vstack((points, points))
        points[0], points[-1] = (np.array(p[::-1]) / spec.resolution - offset for p in (begin, end))
        points = any_angle.any_angle(weights, points, 50, 8.0, 10, 200)
        metres = ((points + offset) * spec.resolution)[:, ::-1]
        if len(metres) > 2:
            self.graph.add_way(metres[1:-1], self._level)
        return metres, self._cost(spec, metres)

    # When there is no way

    def _to_substitute(
        self, spec: GridSpec, begin: tuple[float, float], goal: SE2, *, is_goal_free: bool
    ) -> tuple[tuple[float, float], F64]:
        """Return the place to go to instead and the way there: unknown ground that was not attempted yet, or the nearest cell to an occupied goal."""
        ground = self._ground
        reached = np.zeros(spec.shape, np.uint8)
        dark = line_of_sight.flood(ground.field, ground.known, *spec.cell_of(*begin), reached)
        if dark and is_goal_free:
            end = self._frontier(spec, reached, begin, goal)
            if end is not None:
                way = self._to_goal(spec, begin, end)
                if way is not None:
                    self._target = end
                    return end, way
        if is_goal_free:
            self.status = PlanStatus.UNREACHABLE
            raise NoValidPathError(
                "no path leads to the goal: what is known and free around the robot does not reach it"
            )
        end = self._nearest(spec, reached, goal)
        way = self._to_goal(spec, begin, end)
        if way is None:
            raise NoValidPathError("no path leads to the place nearest to the goal")
        return end, way

    def _nearest(self, spec: GridSpec, reached: U8, goal: SE2) -> tuple[float, float]:
        cells = np.argwhere(reached)
        places = spec.centers_of(cells)
        away = np.hypot(places[:, 0] - goal.x, places[:, 1] - goal.y)
        k = int(np.argmin(away))
        if away[k] > self.config.goal_tolerance:
            raise NoValidPathError(
                f"the goal is not free, and the nearest reachable place lies {away[k]:.2f} m away"
                f" (allowed: {self.config.goal_tolerance:.2f} m)"
            )
        return float(places[k, 0]), float(places[k, 1])

    def _frontier(
        self, spec: GridSpec, reached: U8, begin: tuple[float, float], goal: SE2
    ) -> tuple[float, float] | None:
        """Return known ground beside unknown ground that was not attempted: the one with the shortest way over it to the goal, as the crow flies;
        the last choice stands while it is left."""
        is_edge = frontier_cells(reached)
        places = spec.centers_of(np.argwhere(is_edge))
        for x, y in [begin] if len(places) else []:
            near = np.hypot(places[:, 0] - x, places[:, 1] - y) <= self.config.attempted
            self._attempted += [(float(px), float(py)) for px, py in places[near][:1]]
        for x, y in self._attempted:
            if len(places):
                places = places[np.hypot(places[:, 0] - x, places[:, 1] - y) > self.config.attempted]
        if len(places) == 0:
            return None
        if self._target is not None:
            off = np.hypot(places[:, 0] - self._target[0], places[:, 1] - self._target[1])
            if off.min() <= 0.5:
                return tuple(places[int(np.argmin(off))].tolist())
        on = np.hypot(places[:, 0] - begin[0], places[:, 1] - begin[1])
        left = np.hypot(places[:, 0] - goal.x, places[:, 1] - goal.y)
        return tuple(places[int(np.argmin(on + left))].tolist())

    # Paths

    def _escape(self, costs: U8, cells: U8, spec: GridSpec, start: SE2, goal: SE2) -> list[tuple[float, float]]:
        """Return the way (x, y) out of forbidden cells, or of a pocket between such, the exact start first; empty when the start is in neither."""
        cell = spec.cell_of(start.x, start.y)
        radius, reach = self.config.escape_radius / spec.resolution, self.config.way_out / spec.resolution
        way = find_escape(costs, cells != FORBIDDEN, cell, radius, reach, spec.cell_of(goal.x, goal.y))
        return [(start.x, start.y), *(spec.center_of(*c) for c in way[1:])] if len(way) > 1 else []

    def _extended(self, spec: GridSpec, way: F64) -> F64:
        """Return the way with its inner points away from what is near."""
        if len(way) < 3 or self.config.clearance <= 0.0:
            return way
        origin = np.array([spec.origin_x, spec.origin_y])
        cells = np.ascontiguousarray(((way - origin) / spec.resolution - 0.5)[:, ::-1])
        wanted = min(15.0, self.config.clearance / spec.resolution)
        line_of_sight.extend(self._ground.field, cells, self.config.graph.least, wanted, 12, 1.0)
        out = (cells[:, ::-1] + 0.5) * spec.resolution + origin
        out[0], out[-1] = way[0], way[-1]
        return np.asarray(out, np.float64)

    def _eased(self, costs: U8, spec: GridSpec, way: F64) -> F64:
        """Return the way as it is driven: moved to where costs are lower, through doors in their middle. It passes everything on the same side."""
        if self.config.factor == 0.0 or len(way) < 2:
            return way
        weights = np.zeros((spec.height + 2, spec.width + 2), np.uint16)
        grid_kernels.weigh(np.ascontiguousarray(costs), self._table, weights)
        offset = np.array([spec.origin_y, spec.origin_x]) / spec.resolution - 1.0
        points = any_angle.divided(np.ascontiguousarray(way[:, ::-1] / spec.resolution - offset), 1.0)
        if len(points) < 3:
            return way
        points = any_angle.any_angle(weights, points, NEUTRAL, 8.0, 10, 200)
        out = ((points + offset) * spec.resolution)[:, ::-1]
        out[0], out[-1] = way[0], way[-1]
        return np.asarray(out, np.float64)

    def _table_of(self, config: VisibilityConfig) -> NDArray[np.uint16]:
        """Return the weight of each cost, uint16 (256,), 0 for those that are forbidden."""
        weights = np.rint(NEUTRAL + config.factor * np.arange(256))
        weights[config.lethal_from :] = 0
        weights[COST_UNKNOWN] = NEUTRAL if config.is_unknown_allowed else 0
        return np.asarray(weights, np.uint16)

    def _dark(self, spec: GridSpec, way: F64) -> float:
        """Return how many metres of a way lie in unknown cells."""
        ground, r = self._ground, spec.resolution
        cells = ((way - [spec.origin_x, spec.origin_y]) / r - 0.5)[:, ::-1]
        return sum(
            (float(np.hypot(*(b - a))) - float(line_of_sight.sum_along(ground.known, *a, *b))) * r
            for a, b in itertools.pairwise(cells)
        )


def check_request(costs: U8, spec: GridSpec, start: SE2, goal: SE2, *, must_hold: bool = True) -> None:
    """Raise what is wrong with a request: BadInputError, StartOutsideMapError or GoalOutsideMapError (only if the grid `must_hold` them)."""
    if costs.shape != spec.shape or max(spec.shape) > 32000:
        raise BadInputError(f"a cost grid of {costs.shape} cells with a geometry of {spec.shape} cannot be planned on")
    if not (math.isfinite(start.x + start.y) and (not must_hold or spec.contains(start.x, start.y))):
        raise StartOutsideMapError(f"the robot at ({start.x:.2f}, {start.y:.2f}) is outside the map")
    if not (math.isfinite(goal.x + goal.y + goal.yaw) and (not must_hold or spec.contains(goal.x, goal.y))):
        raise GoalOutsideMapError(f"the goal ({goal.x:.2f}, {goal.y:.2f}) is outside the map")


def classes_of(costs: U8, lethal_from: int, *, is_unknown_allowed: bool) -> U8:
    """Return the classes of clearance_map for costs uint8 [iy, ix]; unknown cells are forbidden unless allowed."""
    table = np.where(np.arange(256) < lethal_from, FREE, FORBIDDEN).astype(np.uint8)
    table[COST_UNKNOWN] = UNKNOWN if is_unknown_allowed else FORBIDDEN
    return np.asarray(table[costs], np.uint8)


def frontier_cells(reached: U8) -> NDArray[np.bool_]:
    """Return which reached known cells (1) have a reached unknown cell (2) beside them, bool [iy, ix]."""
    dark = np.pad(reached == 2, 1)
    beside = dark[:-2, 1:-1] | dark[2:, 1:-1] | dark[1:-1, :-2] | dark[1:-1, 2:]
    return np.asarray((reached == 1) & beside)
