"""What every global planner keeps to, run over all of them: the grid planner and the one on a visibility graph."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ambler.core.errors import (
    BadInputError,
    GoalOutsideMapError,
    NoValidPathError,
    StartOccupiedError,
    StartOutsideMapError,
)
from ambler.core.grid import GridSpec
from ambler.core.protocols import GlobalPlanner
from ambler.core.se2 import SE2
from ambler.planning.distance import distance_field
from ambler.planning.grid_planner import GridPlanner, PlannerConfig
from ambler.planning.visibility_planner import VisibilityConfig, VisibilityPlanner
from ambler.studies.planner_worlds import inflated

SPEC = GridSpec(0.05, 200, 160, -3.0, -2.0)
Make = Callable[..., GlobalPlanner]


def make_grid(*, is_unknown_allowed: bool = False, goal_tolerance: float = np.inf) -> GlobalPlanner:
    config = PlannerConfig(is_unknown_allowed=is_unknown_allowed, goal_tolerance=goal_tolerance)
    return GridPlanner(config)


def make_graph(*, is_unknown_allowed: bool = False, goal_tolerance: float = np.inf) -> GlobalPlanner:
    config = VisibilityConfig(is_unknown_allowed=is_unknown_allowed, goal_tolerance=goal_tolerance)
    return VisibilityPlanner(config)


@pytest.fixture(params=[make_grid, make_graph], ids=["grid", "visibility_graph"])
def make(request: pytest.FixtureRequest) -> Make:
    made: Make = request.param
    return made


def two_rooms(door: int = 18) -> np.ndarray:
    """Return lethal cells of two rooms with a door of so many cells in the wall between them."""
    cells = np.zeros(SPEC.shape, np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 254, 254, 254, 254
    cells[:, 99:102] = 254
    if door:
        cells[80 : 80 + door, 99:102] = 0
    return cells


def clutter(seed: int) -> np.ndarray:
    """Return costs of random blocks with specks of unknown cells."""
    rng = np.random.default_rng(seed)
    cells = np.zeros(SPEC.shape, np.uint8)
    for y, x, h, w in rng.integers([0, 0, 2, 2], [160, 200, 20, 20], (25, 4)):
        cells[y : y + h, x : x + w] = 254
    cells[rng.random(SPEC.shape) < 0.002] = 255
    return inflated(cells, inscribed=0.2, radius=0.7, scaling=3.0)


def costs_under(costs: np.ndarray, spec: GridSpec, path: np.ndarray) -> np.ndarray:
    """Return the cost under every point of the path, sampled every half centimetre."""
    legs = [np.linspace(a, b, 12, endpoint=False) for a, b in zip(path[:-1, :2], path[1:, :2], strict=True)]
    cells = spec.cells_of(np.vstack([*legs, path[-1:, :2]]))
    return costs[cells[:, 0], cells[:, 1]]


@pytest.mark.parametrize("seed", range(12))
def test_paths_go_from_start_to_goal_over_allowed_cells_or_there_is_provably_none(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    costs = clutter(seed)
    free = np.argwhere(costs < 253)
    a, b = free[rng.integers(len(free), size=2)]
    start = SE2(*(SPEC.centers_of(a[None])[0] + rng.uniform(-0.02, 0.02, 2)), 0.3)
    goal = SE2(*(SPEC.centers_of(b[None])[0] + rng.uniform(-0.02, 0.02, 2)), -1.0)
    way = distance_field(costs, SPEC, start)[b[0], b[1]]
    if not np.isfinite(way):
        with pytest.raises(NoValidPathError):
            make().plan(costs, SPEC, start, goal)
        return
    result = make().plan(costs, SPEC, start, goal)
    np.testing.assert_array_equal(result.path, make().plan(costs.copy(), SPEC, start, goal).path)
    assert result.goal_distance == 0.0
    np.testing.assert_allclose(result.path[0, :2], [start.x, start.y], atol=1e-9)
    np.testing.assert_allclose(result.path[-1], [goal.x, goal.y, goal.yaw], atol=1e-9)
    steps = np.hypot(*np.diff(result.path[:, :2], axis=0).T)
    assert steps.max() <= 0.05 + 1e-9
    assert costs_under(costs, SPEC, result.path).max() < 253
    heading = np.arctan2(*np.diff(result.path[:, :2], axis=0).T[::-1])
    np.testing.assert_allclose(result.path[:-1, 2], heading, atol=1e-6)
    assert result.cost >= np.hypot(goal.x - start.x, goal.y - start.y) - 1e-9


def test_a_planner_asked_twice_gives_the_same_path(make: Make) -> None:
    costs, planner = inflated(two_rooms()), make()
    first = planner.plan(costs, SPEC, SE2(0.0, 1.0), SE2(5.0, 1.0))
    again = planner.plan(costs.copy(), SPEC, SE2(0.0, 1.0), SE2(5.0, 1.0))
    np.testing.assert_array_equal(first.path, again.path)


def test_a_door_that_closes_is_not_passed_any_more_and_passed_again_when_it_opens(make: Make) -> None:
    planner, start, goal = make(), SE2(0.0, 1.0), SE2(5.0, 1.0)
    planner.plan(inflated(two_rooms()), SPEC, start, goal)
    with pytest.raises(NoValidPathError):
        planner.plan(inflated(two_rooms(door=0)), SPEC, start, goal)
    result = planner.plan(inflated(two_rooms()), SPEC, start, goal)
    assert costs_under(inflated(two_rooms()), SPEC, result.path).max() < 253


def test_what_a_loop_closure_moves_is_followed(make: Make) -> None:
    planner, start, goal = make(), SE2(0.0, 1.0), SE2(5.0, 1.0)
    planner.plan(inflated(two_rooms()), SPEC, start, goal)
    moved = np.zeros_like(two_rooms())
    moved[3:, 4:] = two_rooms()[:-3, :-4]
    costs = inflated(moved)
    assert costs_under(costs, SPEC, planner.plan(costs, SPEC, start, goal).path).max() < 253


def test_a_map_that_grows_to_all_sides_is_followed(make: Make) -> None:
    planner, start, goal = make(), SE2(1.0, 1.0), SE2(1.5, 2.0)
    planner.plan(inflated(two_rooms()), SPEC, start, goal)
    wide = GridSpec(0.05, 300, 260, SPEC.origin_x - 2.0, SPEC.origin_y - 3.0)
    cells = np.zeros(wide.shape, np.uint8)
    cells[60:220, 40:240] = two_rooms()
    costs = inflated(cells)
    result = planner.plan(costs, wide, start, SE2(5.0, 1.0))
    assert costs_under(costs, wide, result.path).max() < 253


@pytest.mark.parametrize("cost", [254, 253])
def test_an_occupied_goal_gets_the_nearest_reachable_substitute(make: Make, cost: int) -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    costs[70:91, 90:111] = cost
    goal = SE2(SPEC.center_of(80, 100)[0] + 0.1, SPEC.center_of(80, 100)[1])
    result = make().plan(costs, SPEC, SE2(-2.0, -1.0), goal)
    end = result.path[-1, :2]
    assert np.hypot(end[0] - goal.x, end[1] - goal.y) == pytest.approx(result.goal_distance)
    assert result.goal_distance == pytest.approx(0.45, abs=0.06)
    assert costs_under(costs, SPEC, result.path).max() < 253
    with pytest.raises(NoValidPathError, match="nearest reachable"):
        make(goal_tolerance=0.2).plan(costs, SPEC, SE2(-2.0, -1.0), goal)


def test_a_start_in_the_inscribed_zone_is_left_and_one_in_a_block_is_refused(make: Make) -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    costs[60:100, 80:120] = 253
    result = make().plan(costs, SPEC, SE2(*SPEC.center_of(62, 82)), SE2(6.0, 4.0))
    assert costs_under(costs, SPEC, result.path[20:]).max() < 253
    with pytest.raises(StartOccupiedError):
        make().plan(costs, SPEC, SE2(*SPEC.center_of(80, 100)), SE2(6.0, 4.0))


def pocket(rim: int = 253) -> np.ndarray:
    """Return costs with a mark around a robot at cell (80, 100), whose own cells are free: it was there."""
    costs = np.zeros(SPEC.shape, np.uint8)
    costs[74:87, 94:107] = rim
    costs[79:82, 99:102] = 0
    return costs


def test_who_stands_free_in_the_midst_of_a_mark_gets_out_of_it(make: Make) -> None:
    start = SE2(*SPEC.center_of(80, 100))
    for goal in (SE2(6.0, 4.0), SE2(-2.5, 2.0)):
        result = make().plan(pocket(), SPEC, start, goal)
        np.testing.assert_allclose(result.path[0, :2], [start.x, start.y])
        np.testing.assert_allclose(result.path[-1, :2], [goal.x, goal.y])
    assert np.isfinite(distance_field(pocket(), SPEC, start)[150, 190])


def test_cells_that_touch_at_corners_lead_nowhere_and_are_left_all_the_same(make: Make) -> None:
    """A gap at 45° between two marks, no wider than the robot: its middle is free in a row of cells that no search passes."""
    start, costs = SE2(*SPEC.center_of(80, 100)), pocket()
    for k in range(2, 7):
        costs[80 + k, 100 + k] = 0
    for goal in (SE2(6.0, 4.0), SE2(-2.5, 2.0)):
        result = make().plan(costs, SPEC, start, goal)
        np.testing.assert_allclose(result.path[-1, :2], [goal.x, goal.y])
        assert costs_under(costs, SPEC, result.path).max() <= 253
    assert np.isfinite(distance_field(costs, SPEC, start)[150, 190])


def test_a_goal_within_a_pocket_is_gone_to_and_walls_about_one_are_not_passed(make: Make) -> None:
    start, near = SE2(*SPEC.center_of(80, 100)), SE2(*SPEC.center_of(81, 101))
    path = make().plan(pocket(), SPEC, start, near).path
    assert np.hypot(*(path[:, :2] - path[0, :2]).T).max() < 0.1
    niche = np.zeros(SPEC.shape, np.uint8)  # its walls are a cell thin
    niche[77:84, 97:104] = 254
    niche[78:83, 98:103] = np.where(pocket()[78:83, 98:103] == 0, 0, 253)
    for begin in (start, SE2(*SPEC.center_of(78, 98))):  # free, and in the inscribed zone of the walls about it
        with pytest.raises(NoValidPathError):
            make().plan(niche, SPEC, begin, SE2(6.0, 4.0))
        assert np.isinf(distance_field(niche, SPEC, begin)[150, 190])


def test_bad_requests_have_names(make: Make) -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    with pytest.raises(StartOutsideMapError):
        make().plan(costs, SPEC, SE2(-30.0, 0.0), SE2(1.0, 1.0))
    with pytest.raises(GoalOutsideMapError):
        make().plan(costs, SPEC, SE2(0.0, 0.0), SE2(100.0, 1.0))
    with pytest.raises(GoalOutsideMapError):
        make().plan(costs, SPEC, SE2(0.0, 0.0), SE2(float("nan"), 1.0))
    with pytest.raises(BadInputError):
        make().plan(costs[:-1], SPEC, SE2(0.0, 0.0), SE2(1.0, 1.0))


def test_unknown_cells_are_forbidden_unless_allowed(make: Make) -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    costs[:, 99:102] = 255
    start, goal = SE2(0.0, 1.0), SE2(5.0, 1.0)
    with pytest.raises(NoValidPathError):
        make().plan(costs, SPEC, start, goal)
    assert make(is_unknown_allowed=True).plan(costs, SPEC, start, goal).goal_distance == 0.0


def test_a_goal_beyond_the_map_is_planned_to_where_unknown_ground_is_allowed(make: Make) -> None:
    goal = SE2(SPEC.origin_x + 35.0, 1.0)
    far = make(is_unknown_allowed=True).plan(np.zeros(SPEC.shape, np.uint8), SPEC, SE2(0.0, 1.0), goal)
    np.testing.assert_allclose(far.path[-1, :2], [goal.x, goal.y])
    assert far.goal_distance == 0.0


def test_a_slanted_passage_two_cells_wide_is_found_where_it_is_the_only_way(make: Make) -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    costs[:, 80:121] = 254
    for k in range(41):
        row = 60 + k // 2
        costs[row : row + 2, 80 + k] = 0
    result = make().plan(costs, SPEC, SE2(0.0, 1.0), SE2(5.0, 1.0))
    assert result.goal_distance == 0.0
    assert costs_under(costs, SPEC, result.path).max() < 253
