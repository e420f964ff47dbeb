"""One look at the map: every frontier with its goal, path distance, gain and state. One distance field serves all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError, PlanningError
from ambler.core.grid import OCC_UNKNOWN, GridSpec
from ambler.core.messages import CostGrid, Frontier, FrontierState, OccupancyGrid
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.exploration.close_looks import CloseLookConfig, CloseLooks
from ambler.exploration.fence import Boundary, Fence, FenceConfig, Side
from ambler.exploration.frontier_map import Box, FrontierGroups, FrontierMap, changed_box, group
from ambler.exploration.lattice import carried
from ambler.exploration.memory import FrontierMemory, MemoryConfig
from ambler.exploration.narrow_ways import tell_narrow_ways
from ambler.exploration.overlooked import Overlooked, is_hidden
from ambler.exploration.pockets import are_in_pockets
from ambler.exploration.specks import Specks, SpecksConfig
from ambler.exploration.wide import join, shrunk, spread
from ambler.kernels.frontier import frontier_goals
from ambler.kernels.frontier_value import in_sight_from, viewpoints, visible_unknown

ELSEWHERE = (
    1.5  # goal reaches: no goal of the same cell of a frontier lies so far from another one, not even diagonally
)
ANY_COST = 255
HIDDEN = "the robot was near it, and the floor behind it shows itself from no place that it can reach"
END = 0.9  # of the distance from which on a scanner sees the floor: there ends what is assumed, where no floor is seen
DistanceField = Callable[[NDArray[np.uint8], GridSpec, SE2], NDArray[np.float32]]
"""(costs uint8 [iy, ix], spec, map_from_base) -> path distance from there in metres, float32 [iy, ix], inf where unreachable.
A PlanningError says that no path can start there."""


@dataclass(frozen=True, slots=True)
class SurveyConfig:
    """`min_size` (m of frontier cells) and `min_gain` (m² of unknown visible from the goal within `gain_range`) keep dust out;
    a goal lies at most `goal_reach` (m along free cells) away from its frontier, where the cost is at most `roomy_cost` if there
    is such a place: there the robot can turn. In grids of more than `wide_cells` cells (39 m square) distances are those of cells of
    `wide_cell` (m), so that a look costs no more than in an office. `assumed` is what a map of ground says of cells that are free and that nobody has seen: a strict look takes them for unknown (None: a map has none). A scanner that sees the floor from `sees_floor[0]` to `sees_floor[1]` metres only looks from that far away, where there is such a place, at what was only assumed when it was near; what hides less than `pocket_most` m² and shows itself neither from there nor from near is left alone."""

    min_size: float = 0.5
    min_gain: float = 0.25
    gain_range: float = 4.0
    gain_rays: int = 180
    goal_reach: float = 1.0
    free_below: int = 50
    roomy_cost: int = 252
    wide_cells: int = 600_000
    wide_cell: float = 0.2
    assumed: int | None = None
    sees_floor: tuple[float, float] = (0.0, 0.0)
    pocket_most: float = 12.0
    memory: MemoryConfig = field(default_factory=MemoryConfig)
    close: CloseLookConfig = field(default_factory=CloseLookConfig)
    fence: FenceConfig = field(default_factory=FenceConfig)
    specks: SpecksConfig = field(default_factory=SpecksConfig)

    @property
    def looks_from_afar(self) -> bool:
        """Whether ground is assumed that the scanner cannot see from a goal beside it."""
        return self.assumed is not None and self.sees_floor[0] > self.goal_reach

    @classmethod
    def from_robot(cls, robot: RobotModel, roomy_cost: int) -> SurveyConfig:
        """Take sizes from the robot: a gap that it does not fit through is no frontier, a goal is near enough to look.
        `roomy_cost` is the global costmap's at the circumscribed radius."""
        width = 2.0 * robot.inscribed_radius
        reach = max(1.0, 1.5 * robot.circumscribed_radius)
        return cls(min_size=width, goal_reach=reach, roomy_cost=roomy_cost, close=CloseLookConfig.from_robot(robot))


@dataclass(frozen=True, slots=True)
class Survey:
    """All frontiers of one map: `gains` float64 (N,) in m², `open` the indices that may be driven to, the areas (m²) of the
    known map and of the cells that the robot can reach, and the cost grid that all was made with. `left_out` (m) is the length of the
    frontiers beyond the fence; `shut` are the indices of those to which no way leads, or no drive got, and that were not looked at often enough."""

    frontiers: tuple[Frontier, ...]
    gains: NDArray[np.float64]
    open: tuple[int, ...]
    known_area: float
    reachable_area: float
    costs: CostGrid
    left_out: float = 0.0
    shut: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What frontiers are judged by: the map as it was `seen`, and as it is `drivable`, with what is assumed to be free; groups (N,) of frontier cells; costs, and the path distance (m) to each of their
    cells; and where the robot is."""

    seen: OccupancyGrid
    drivable: OccupancyGrid
    groups: FrontierGroups
    costs: CostGrid
    distance: NDArray[np.float32]
    map_from_base: SE2


class FrontierSurvey:
    """Finds the frontiers of a map that changes, and judges them. What is only assumed to be free lies around the robot and mostly shows itself when it moves on; `is_strict` for who wants to
    know what is left."""

    def __init__(self, config: SurveyConfig, distance_field: DistanceField) -> None:
        self.config = config
        self.memory = FrontierMemory(config.memory, config.free_below, config.assumed)
        self._close = CloseLooks(config.close, config.free_below)
        self._fence = Fence(config.fence)
        self._specks = Specks(config.specks, 0.5 * config.min_size)
        self._overlooked = None if config.assumed is None else Overlooked(config.assumed)
        self._distance_field = distance_field
        self._frontier_map = FrontierMap(config.free_below)
        self._last: OccupancyGrid | None = None
        self.is_strict = False

    def another(self) -> FrontierSurvey:
        """Return a survey of another level by the same rules, within the same circle."""
        other = FrontierSurvey(self.config, self._distance_field)
        other._fence = Fence(self.config.fence, self._fence.center)
        return other

    def reset(self) -> None:
        """Forget the map and every refusal."""
        self.memory = FrontierMemory(self.config.memory, self.config.free_below, self.config.assumed)
        self._close = CloseLooks(self.config.close, self.config.free_below)
        self._fence = Fence(self.config.fence)
        self._specks = Specks(self.config.specks, 0.5 * self.config.min_size)
        self._overlooked = None if self.config.assumed is None else Overlooked(self.config.assumed)
        self.is_strict = False
        self.forget_map()

    def forget_map(self) -> None:
        """Search the whole map at the next update."""
        self._last = None

    def update(self, occupancy: OccupancyGrid, costs: CostGrid, map_from_base: SE2, boundary: Boundary = ()) -> Survey:
        """Return every frontier of the map, judged for a robot at `map_from_base`; `boundary` goes before that of the configuration.

        Both grids must be aligned to whole cells of one resolution; raises BadInputError otherwise.
        """
        self._close.add(occupancy, map_from_base)
        if self._overlooked is not None:
            self._overlooked.add(occupancy, map_from_base)
        drivable, occupancy = occupancy, self._seen(occupancy)
        found = self._search(occupancy)
        self._fence.update(occupancy, map_from_base, boundary)
        costs = self._fence.inside(costs, map_from_base)
        is_over = self._close.are_over(occupancy, found.cells)
        sides = self._fence.sides_of(found.cells)
        is_inside = sides == Side.INSIDE
        groups, over = (group(found.spec, np.sort(found.cells[k & is_inside])) for k in (~is_over, is_over))
        self._specks.pass_by(costs, (map_from_base.x, map_from_base.y))
        distance = self._distances(costs, map_from_base)
        view = _View(occupancy, drivable, groups, costs, distance, map_from_base)
        frontiers, gains = self._judged(view)
        if self.config.looks_from_afar and not any(each.state is FrontierState.OPEN for each in frontiers):
            frontiers, gains = self._judged(view, is_last_resort=True)
        shut = tuple(k for k, f in enumerate(frontiers) if self._is_shut(f))
        frontiers += self._judge_over(over)
        frontiers += self._left_out(found, sides)
        gains = np.concatenate([gains, np.zeros(len(frontiers) - len(groups))])
        is_open = tuple(i for i, f in enumerate(frontiers) if f.state is FrontierState.OPEN)
        cell_area = occupancy.spec.resolution**2
        known = float(np.count_nonzero(occupancy.data >= 0)) * cell_area
        reachable = float(np.count_nonzero(np.isfinite(distance))) * cell_area
        left_out = float(np.count_nonzero(sides)) * occupancy.spec.resolution
        return Survey(tuple(frontiers), gains, is_open, known, reachable, costs, left_out, shut)

    def _judged(self, view: _View, *, is_last_resort: bool = False) -> tuple[list[Frontier], NDArray[np.float64]]:
        """Return the frontiers of the groups with their goals, judged, and what their goals let see."""
        seen, groups = view.seen, view.groups
        goals = self._goals(view, is_last_resort=is_last_resort)
        elsewhere = self._look_from_elsewhere(view, goals)
        gains, headings = self._gains(seen, groups, goals)
        goes_on = self._go_on(view, goals, gains)
        if goes_on.any():
            gains, headings = self._gains(seen, groups, goals)
        no_use = self._step_back(view, goals, headings, goes_on)
        elsewhere |= goes_on
        diy, dix = seen.spec.offset_in(view.costs.spec)
        too_small = self._too_small(seen.spec.resolution)
        frontiers = []
        for g, (cells, centroid) in enumerate(groups.parts):
            goal, path_distance = None, math.inf
            if goals[g] >= 0:
                iy, ix = divmod(int(goals[g]), seen.spec.width)
                goal = (*seen.spec.center_of(iy, ix), float(headings[g]))
                path_distance = float(view.distance[iy + diy, ix + dix])
            if no_use[g]:
                state, reason = FrontierState.UNREACHABLE, HIDDEN
            elif reason := too_small(len(cells)):
                state = FrontierState.TOO_SMALL
            else:
                frontier = Frontier(cells, centroid, goal, path_distance, FrontierState.OPEN)
                state, reason = self._judge(frontier, float(gains[g]), seen, is_elsewhere=bool(elsewhere[g]))
            frontiers.append(Frontier(cells, centroid, goal, path_distance, state, reason))
        return frontiers, gains

    def _look_from_elsewhere(self, view: _View, goals: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Give groups that were looked at in vain goals away from the places of those looks, where there are such; return which groups. A wide
        frontier may be seen through a slit, from where nothing more can be seen, and lie open at its other end."""
        spec, groups, moved = view.seen.spec, view.groups, np.zeros(len(view.groups), np.bool_)
        if len(self.memory) == 0 or self.config.assumed is not None:
            return moved
        is_worth_it = (goals >= 0) & self._are_long(groups)
        for g, (cells, centroid) in enumerate(groups.parts):
            if not is_worth_it[g]:
                continue
            places = self.memory.places_in_vain(Frontier(cells, centroid, None, math.inf, FrontierState.OPEN))
            if not places:
                continue
            one = FrontierGroups(spec, groups.cells[groups.starts[g] : groups.starts[g + 1]], np.array([0, len(cells)]))
            away = _without_discs(view.distance, view.costs.spec, places, ELSEWHERE * self.config.goal_reach)
            goal = int(self._goals(replace(view, groups=one, distance=away), is_last_resort=True)[0])
            if goal >= 0:
                goals[g], moved[g] = goal, True
        return moved

    def hides(self, frontier: Frontier, occupancy: OccupancyGrid) -> bool:
        """Tell whether a frontier that is gone may have closed only because the map assumes ground there now."""
        return self.config.assumed is not None and is_hidden(frontier, occupancy, self.config.assumed)

    def explained(self, survey: Survey, occupancy: OccupancyGrid, map_from_base: SE2) -> Survey:
        """Return the survey with what keeps the robot from frontiers that it cannot come near, should that be a way less than twice as wide as the robot."""
        c, is_reached = self.config, np.isfinite(self._distances(survey.costs, map_from_base))
        reached = carried(is_reached, survey.costs.spec, occupancy.spec)
        near, width = 0.5 * c.goal_reach, c.min_size
        told = tell_narrow_ways(survey.frontiers, occupancy, c.free_below, reached, near=near, width=width)
        return replace(survey, frontiers=told)

    def look_at_speck(self, survey: Survey, map_from_base: SE2) -> SE2 | None:
        """Return from where to look at a small thing that alone shuts the way to a frontier of `survey`; None where there is none, or it was looked at often enough."""
        shut = [survey.frontiers[k].cells for k in survey.shut if survey.frontiers[k].goal is None]
        if not shut:
            return None
        opened, specks = self._specks.opened(survey.costs)
        if not specks.any():
            return None
        reached, could = (np.isfinite(self._distances(costs, map_from_base)) for costs in (survey.costs, opened))
        wanted = np.concatenate(shut)
        robot = (map_from_base.x, map_from_base.y)
        return self._specks.look(survey.costs, specks, reached, could & ~reached, wanted, self.config.goal_reach, robot)

    def _seen(self, occupancy: OccupancyGrid) -> OccupancyGrid:
        """Return the map: for a strict look one in which nothing is assumed; for any other one in which what was assumed once and is enclosed stays so. Else frontiers around ground that shows
        itself from no place nearby close when the robot comes, open when it leaves, and call it back."""
        if self._overlooked is None:
            return occupancy
        if not self.is_strict:
            return self._overlooked.taken_for_known(occupancy)
        data = np.where(occupancy.data == self.config.assumed, np.int8(OCC_UNKNOWN), occupancy.data)
        return replace(occupancy, data=data)

    def _step_back(
        self, view: _View, goals: NDArray[np.int64], headings: NDArray[np.float64], goes_on: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Move the goals of a scanner that does not see the floor beside itself to where it sees what lies behind the frontier: once, then it goes near, as one must
        where ground falls away behind a crest. Returns which groups (N,) are of no more use: the robot was near, no place is left to look from, and what they hide is small. Groups that
        the robot `goes_on` to keep their goals."""
        seen, drivable, groups, costs, c = view.seen, view.drivable, view.groups, view.costs, self.config
        spec, resolution = seen.spec, seen.spec.resolution
        near, far = (round(reach / resolution) for reach in c.sees_floor)
        if not c.looks_from_afar or self._overlooked is None:
            return np.zeros(len(groups), np.bool_)
        shift, base = _cell_shift(spec, costs.spec), spec.cell_of(view.map_from_base.x, view.map_from_base.y)
        is_long = self._are_long(groups)
        was_near = is_long & self._overlooked.are_of(groups, ELSEWHERE * c.goal_reach)
        is_small = are_in_pockets(groups, seen, c.pocket_most) if self.is_strict else np.zeros(len(groups), np.bool_)
        worth_it = is_long & self._overlooked.are_of(groups) & ~goes_on
        for g in np.flatnonzero(worth_it):
            worth_it[g] = self.memory.find(Frontier(*groups.parts[g], None, math.inf, FrontierState.OPEN)) is None
        roomy = np.where(costs.data <= c.roomy_cost, view.distance, np.float32(np.inf))
        before = goals.copy()
        viewpoints(
            seen.data,
            drivable.data,
            c.free_below,
            roomy,
            *shift,
            groups.cells,
            groups.starts,
            worth_it,
            ~(was_near & is_small),
            base,
            (near, far),
            goals,
            headings,
        )
        return np.asarray(was_near & is_small & (goals == before) & (goals >= 0), np.bool_)

    def _go_on(self, view: _View, goals: NDArray[np.int64], gains: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Give groups that were looked at in vain, and that nobody would go to now, goals at the end of ground that is only assumed, where that lies in open sight as far away as the scanner would
        see a level floor behind it, and sees none: the landing at the top of a ramp, which shows itself to who stands on it. Returns which groups (N,) those are."""
        seen, groups, c = view.seen, view.groups, self.config
        goes_on = np.zeros(len(groups), np.bool_)
        if not c.looks_from_afar or self.is_strict or len(groups) == 0:
            return goes_on
        is_end = np.empty(len(groups.cells), np.bool_)
        base = seen.spec.cell_of(view.map_from_base.x, view.map_from_base.y)
        near = END * c.sees_floor[0] / seen.spec.resolution
        in_sight_from(seen.data, view.drivable.data, c.free_below, groups.cells, base, round(near), is_end)
        is_end &= seen.data.ravel()[groups.cells] == c.assumed
        for g, (places, centroid) in enumerate(groups.parts):
            of_group = slice(groups.starts[g], groups.starts[g + 1])
            cells = groups.cells[of_group][is_end[of_group]]
            frontier = Frontier(places, centroid, None, math.inf, FrontierState.OPEN)
            if len(cells) * seen.spec.resolution < c.min_size or self.memory.find(frontier) is None:
                continue
            if goals[g] < 0 or gains[g] < c.min_gain or self.memory.reason_against(frontier, seen):
                end = FrontierGroups(seen.spec, cells, np.array([0, len(cells)]))
                goal = int(self._goals(replace(view, groups=end), is_last_resort=True)[0])
                if goal >= 0:
                    goals[g], goes_on[g] = goal, True
        return goes_on

    def _left_out(self, found: FrontierGroups, sides: NDArray[np.uint8]) -> list[Frontier]:
        """The frontiers beyond the fence, each with its reason."""
        fence = self.config.fence
        reasons = {
            Side.BEYOND_BOUNDARY: "outside the boundary",
            Side.BEYOND_STRUCTURE: f"no known surface within {fence.structure_reach:.0f} m, or only on one side "
            f"and more than {fence.open_reach:.0f} m outside of all: the robot could not tell where it is",
        }
        out = []
        for side, reason in reasons.items():
            for cells, centroid in group(found.spec, np.sort(found.cells[sides == side])).parts:
                out.append(Frontier(cells, centroid, None, math.inf, FrontierState.OUTSIDE_BOUNDARY, reason))
        return out

    def _distances(self, costs: CostGrid, map_from_base: SE2) -> NDArray[np.float32]:
        data, spec = costs.data, costs.spec
        try:
            if data.size <= self.config.wide_cells:
                return self._distance_field(data, spec, map_from_base)
            coarse, coarse_spec = shrunk(data, spec, self.config.wide_cell)
            factor = round(coarse_spec.resolution / spec.resolution)
            distance = spread(self._distance_field(coarse, coarse_spec, map_from_base), factor, data)
            join(distance, data, spec, map_from_base)
            return distance
        except PlanningError:  # the robot stands where it may not be: nothing can be reached now
            return np.full(costs.spec.shape, np.inf, np.float32)

    def _search(self, occupancy: OccupancyGrid) -> FrontierGroups:
        last, self._last = self._last, occupancy
        if last is None or last.spec != occupancy.spec:
            return self._frontier_map.update(occupancy.spec, occupancy.data)
        changed = changed_box(last.data, occupancy.data) or Box(0, 0, 0, 0)
        return self._frontier_map.update(occupancy.spec, occupancy.data, changed)

    def _goals(self, view: _View, *, is_last_resort: bool) -> NDArray[np.int64]:
        """Return the goal of each group that is more than dust, a flat index or -1: where the robot can turn, or else anywhere that it can reach. A scanner that does not see the floor beside itself is led
        to ground that was seen: what is only assumed is passed over on the way to it, and no goal, because a kerb may hide there; unless nothing else is left to look at (`is_last_resort`): on the last metres of a ramp it looks over the landing's floor."""
        occupancy, groups, costs, distance = view.drivable, view.groups, view.costs, view.distance
        shift = _cell_shift(occupancy.spec, costs.spec)
        if self.config.looks_from_afar and not is_last_resort:
            iy, ix = np.nonzero(occupancy.data == self.config.assumed) + np.array(shift)[:, None]
            is_inside = (iy >= 0) & (iy < distance.shape[0]) & (ix >= 0) & (ix < distance.shape[1])
            distance = distance.copy()
            distance[iy[is_inside], ix[is_inside]] = np.inf
        spec, cells, starts = occupancy.spec, groups.cells, groups.starts
        steps, wanted = round(self.config.goal_reach / spec.resolution), self._are_long(groups)
        visited = np.zeros(spec.width * spec.height, np.int32)
        queue, goals = np.empty(visited.size, np.int64), np.full(len(groups), -1)
        grids = (occupancy.data, self.config.free_below, distance, costs.data)
        for turn, most in enumerate((self.config.roomy_cost, ANY_COST)):
            stamp = 1 + 2 * turn * len(groups)
            frontier_goals(*grids, most, *shift, cells, starts, wanted, steps, visited, stamp, queue, goals)
            wanted &= goals < 0
        return goals

    def _are_long(self, groups: FrontierGroups) -> NDArray[np.bool_]:
        """Tell which groups (N,) are more than dust."""
        return np.asarray(groups.sizes * groups.spec.resolution >= self.config.min_size)

    def _gains(
        self, occupancy: OccupancyGrid, groups: FrontierGroups, goals: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the visible unknown area from each goal and the heading to it; both 0 for groups below the minimum size. Surfaces that
        the robot saw from near, and from the side of the group's free ground, are opaque, should the map have lost them."""
        c, resolution = self.config, occupancy.spec.resolution
        worth_it = np.where(self._are_long(groups), goals, -1)
        gains, headings = np.empty(len(groups)), np.empty(len(groups))
        surfaces, sides = self._close.surfaces(occupancy.spec), self._close.free_sides(occupancy, groups)
        rays = (c.free_below, resolution, c.gain_range, c.gain_rays)
        visible_unknown(occupancy.data, surfaces, *rays, worth_it, sides, gains, headings)
        return gains, headings

    def _judge(
        self, frontier: Frontier, gain: float, occupancy: OccupancyGrid, *, is_elsewhere: bool
    ) -> tuple[FrontierState, str]:
        """Return the state of a frontier that is long enough, and why it is not open."""
        c = self.config
        if frontier.goal is None:
            return FrontierState.UNREACHABLE, f"no cell that the robot can reach within {c.goal_reach:.1f} m of it"
        if gain < c.min_gain:
            return (
                FrontierState.TOO_SMALL,
                f"only {gain:.2f} m² of unknown visible, less than {c.min_gain:.2f} m²",
            )
        reason = self.memory.reason_against(frontier, occupancy, is_elsewhere=is_elsewhere)
        return FrontierState.UNREACHABLE if reason else FrontierState.OPEN, reason

    def _is_shut(self, frontier: Frontier) -> bool:
        if frontier.state is not FrontierState.UNREACHABLE or frontier.reason == HIDDEN:
            return False
        refusal = self.memory.find(frontier)
        return refusal is None or refusal.looks < self.config.memory.max_looks

    def _judge_over(self, over: FrontierGroups) -> list[Frontier]:
        """Return what the robot has looked at from near."""
        too_small = self._too_small(over.spec.resolution)
        seen = f"looked at from within {self.config.close.farthest:.1f} m: nothing can be seen behind it"
        out = []
        for cells, centroid in over.parts:
            small = too_small(len(cells))
            state = FrontierState.TOO_SMALL if small else FrontierState.UNREACHABLE
            out.append(Frontier(cells, centroid, None, math.inf, state, small or seen))
        return out

    def _too_small(self, resolution: float) -> Callable[[int], str]:
        """Return what says why so many cells are too few to be a frontier, an empty text of enough; thousands are dust, of few sizes."""
        least = self.config.min_size

        @cache
        def reason(cells: int) -> str:
            size = cells * resolution
            return f"{size:.2f} m long, less than {least:.2f} m" if size < least else ""

        return reason


def _cell_shift(spec: GridSpec, cost_spec: GridSpec) -> tuple[int, int]:
    """Return the rows and columns from the map to the cost grid; raises BadInputError if the two do not share one lattice."""
    shift_x = (spec.origin_x - cost_spec.origin_x) / spec.resolution
    shift_y = (spec.origin_y - cost_spec.origin_y) / spec.resolution
    off_grid = max(abs(shift_x - round(shift_x)), abs(shift_y - round(shift_y)))
    if not math.isclose(spec.resolution, cost_spec.resolution, rel_tol=1e-6) or off_grid > 1e-3:
        raise BadInputError("the map and the global costmap are not aligned to whole cells of one size")
    return spec.offset_in(cost_spec)


def _without_discs(
    distance: NDArray[np.float32], spec: GridSpec, places: tuple[tuple[float, float], ...], radius: float
) -> NDArray[np.float32]:
    """Return path distances with inf within `radius` (m) of places."""
    y = spec.origin_y + (np.arange(spec.height) + 0.5) * spec.resolution
    x = spec.origin_x + (np.arange(spec.width) + 0.5) * spec.resolution
    away = distance.copy()
    for px, py in places:
        rows, columns = np.abs(y - py) <= radius, np.abs(x - px) <= radius
        is_near = np.hypot(y[rows, None] - py, x[None, columns] - px) <= radius
        away[np.ix_(rows, columns)] = np.where(is_near, np.float32(np.inf), away[np.ix_(rows, columns)])
    return away
