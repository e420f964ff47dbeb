"""The global planner as its users see it: conformance, doorways, substitutes, escapes, named failures."""

import math

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
from ambler.core.se2 import SE2
from ambler.kernels.any_angle import path_cost
from ambler.kernels.graph_search import weigh
from ambler.planning.distance import distance_field
from ambler.planning.grid_planner import GridPlanner, PlannerConfig, weight_table
from ambler.planning.oracle import gradient_path, scipy_costs
from ambler.studies.planner_worlds import inflated

SPEC = GridSpec(0.05, 200, 160, -3.0, -2.0)


def two_rooms(door: int = 18) -> np.ndarray:
    """Return lethal cells of two rooms with a door in the wall between them, uint8 (160, 200)."""
    cells = np.zeros(SPEC.shape, np.uint8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 254, 254, 254, 254
    cells[:, 99:102] = 254
    if door:
        cells[80 : 80 + door, 99:102] = 0
    return cells


def random_world(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    cells = np.zeros(SPEC.shape, np.uint8)
    for y, x, h, w in rng.integers([0, 0, 2, 2], [160, 200, 20, 20], (25, 4)):
        cells[y : y + h, x : x + w] = 254
    cells[rng.random(SPEC.shape) < 0.002] = 255
    return inflated(cells, inscribed=0.2, radius=0.7, scaling=3.0)


def clearance_costs(costs: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return the cost under every point of the path, sampled every half centimetre."""
    legs = [np.linspace(a, b, 12, endpoint=False) for a, b in zip(path[:-1, :2], path[1:, :2], strict=True)]
    cells = SPEC.cells_of(np.vstack([*legs, path[-1:, :2]]))
    return costs[cells[:, 0], cells[:, 1]]


def sampled_cost(costs: np.ndarray, path: np.ndarray) -> float:
    """Return the integral of the weights along the path in metres, as the mean over points a few millimetres apart."""
    weights = weight_table(PlannerConfig())[costs] / PlannerConfig().neutral
    legs = np.diff(path[:, :2], axis=0)
    shares = (np.arange(16) + 0.5) / 16
    cells = SPEC.cells_of((path[:-1, None, :2] + legs[:, None] * shares[:, None]).reshape(-1, 2))
    return float((np.hypot(*legs.T) * weights[cells[:, 0], cells[:, 1]].reshape(-1, 16).mean(axis=1)).sum())


@pytest.mark.parametrize("seed", range(15))
def test_paths_are_optimal_smooth_and_never_closer_than_allowed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    costs = random_world(seed)
    free = np.argwhere(costs < 253)
    a, b = free[rng.integers(len(free), size=2)]
    start = SE2(*(SPEC.centers_of(a[None])[0] + rng.uniform(-0.02, 0.02, 2)), 0.3)
    goal = SE2(*(SPEC.centers_of(b[None])[0] + rng.uniform(-0.02, 0.02, 2)), -1.0)
    config = PlannerConfig()
    oracle = scipy_costs(weight_table(config)[costs], (a[0], a[1]))[b[0], b[1]]
    planner = GridPlanner(config)
    if not np.isfinite(oracle):
        with pytest.raises(NoValidPathError):
            planner.plan(costs, SPEC, start, goal)
        return
    result = planner.plan(costs, SPEC, start, goal)
    again = GridPlanner(config).plan(costs.copy(), SPEC, start, goal)
    np.testing.assert_array_equal(result.path, again.path)
    assert result.cost == pytest.approx(sampled_cost(costs, result.path), rel=2e-3)
    assert result.goal_distance == 0.0
    np.testing.assert_allclose(result.path[0, :2], [start.x, start.y], atol=1e-9)
    np.testing.assert_allclose(result.path[-1], [goal.x, goal.y, goal.yaw], atol=1e-9)
    steps = np.hypot(*np.diff(result.path[:, :2], axis=0).T)
    assert steps.max() <= config.spacing + 1e-9
    assert clearance_costs(costs, result.path).max() < 253
    raw = GridPlanner(PlannerConfig(is_smooth=False)).plan(costs, SPEC, start, goal)
    assert result.cost <= raw.cost + 1e-9
    assert clearance_costs(costs, result.path).max() <= clearance_costs(costs, raw.path).max()
    heading = np.arctan2(*np.diff(result.path[:, :2], axis=0).T[::-1])
    np.testing.assert_allclose(result.path[:-1, 2], heading, atol=1e-6)


def test_paths_cost_less_than_down_the_gradient_of_a_full_potential() -> None:
    ratios = []
    for seed in range(20):
        costs = random_world(100 + seed)
        free = np.argwhere(costs < 200)
        a, b = free[np.random.default_rng(seed).integers(len(free), size=2)]
        weights = np.zeros((costs.shape[0] + 2, costs.shape[1] + 2), np.uint16)
        weigh(costs, weight_table(PlannerConfig()), weights)
        peer = gradient_path(weights, (a[0] + 1, a[1] + 1), (b[0] + 1, b[1] + 1))
        if peer is None or not np.isfinite(path_cost(weights, peer)):
            continue
        result = GridPlanner().plan(costs, SPEC, SE2(*SPEC.center_of(*a)), SE2(*SPEC.center_of(*b)))
        ours = path_cost(weights, (result.path[:, 1::-1] - [SPEC.origin_y, SPEC.origin_x]) / SPEC.resolution + 1.0)
        assert ours * SPEC.resolution / PlannerConfig().neutral == pytest.approx(result.cost, rel=1e-6)
        ratios.append(ours / path_cost(weights, peer))
    assert len(ratios) > 12
    assert np.median(ratios) < 0.998
    assert np.mean(np.array(ratios) <= 1.0) >= 0.85  # the rest passes an obstacle on the other side


def test_a_path_over_free_floor_is_a_straight_line_in_any_direction() -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    for degrees in range(0, 90, 7):
        goal = SE2(-2.9 + 4.0 * np.cos(np.radians(degrees)), -1.9 + 4.0 * np.sin(np.radians(degrees)))
        result = GridPlanner().plan(costs, SPEC, SE2(-2.9, -1.9), goal)
        assert result.cost == pytest.approx(4.0, abs=1e-9)
        np.testing.assert_allclose(result.path[:-1, 2], np.radians(degrees), atol=1e-6)


def test_a_path_keeps_to_the_middle_of_a_doorway() -> None:
    costs = inflated(two_rooms(), inscribed=0.2, radius=1.0, scaling=3.0)
    path = GridPlanner().plan(costs, SPEC, SE2(-2.0, 0.0), SE2(6.0, 4.0)).path
    in_door = np.abs(path[:, 0] - 2.025) < 0.08
    middle = SPEC.origin_y + 89 * 0.05
    assert in_door.any()
    np.testing.assert_allclose(path[in_door, 1], middle, atol=0.08)


def test_a_closed_door_is_a_named_failure() -> None:
    with pytest.raises(NoValidPathError, match="no path"):
        GridPlanner().plan(inflated(two_rooms(0)), SPEC, SE2(-2.0, 0.0), SE2(6.0, 4.0))


def test_corners_are_not_cut() -> None:
    costs = np.zeros((4, 4), np.uint8)
    costs[:2, 2:] = costs[2:, :2] = 254
    spec = GridSpec(1.0, 4, 4, 0.0, 0.0)
    with pytest.raises(NoValidPathError):
        GridPlanner().plan(costs, spec, SE2(0.5, 0.5), SE2(3.5, 3.5))


@pytest.mark.parametrize("value", [253, 254, 255])
def test_a_goal_that_is_not_free_is_replaced_by_the_nearest_reachable_cell(value: int) -> None:
    costs = inflated(two_rooms(0))
    costs[100:120, 40:60] = value
    goal = SE2(*SPEC.center_of(110, 45), 1.0)
    start = SE2(-2.5, -1.0)
    result = GridPlanner().plan(costs, SPEC, start, goal)
    reach = np.argwhere(np.isfinite(scipy_costs(weight_table(PlannerConfig())[costs], SPEC.cell_of(start.x, start.y))))
    best = np.hypot(*(SPEC.centers_of(reach) - [goal.x, goal.y]).T).min()
    assert result.goal_distance == pytest.approx(best)
    assert np.hypot(*(result.path[-1, :2] - [goal.x, goal.y])) == pytest.approx(best)
    assert result.path[-1, 2] == 1.0
    strict = GridPlanner(PlannerConfig(goal_tolerance=best - 0.01))
    with pytest.raises(NoValidPathError, match="nearest reachable"):
        strict.plan(costs, SPEC, start, goal)


def test_unknown_is_forbidden_unless_allowed() -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    costs[:, 100:110] = 255
    start, goal = SE2(-2.0, 0.0), SE2(6.0, 0.0)
    with pytest.raises(NoValidPathError):
        GridPlanner().plan(costs, SPEC, start, goal)
    path = GridPlanner(PlannerConfig(is_unknown_allowed=True)).plan(costs, SPEC, start, goal).path
    np.testing.assert_allclose(path[-1, :2], [6.0, 0.0])


@pytest.mark.parametrize("column", [96, 98, 99])
def test_a_start_in_the_inflation_or_in_a_wall_leaves_on_its_nearer_side(column: int) -> None:
    cells = two_rooms(0)
    costs = inflated(cells)
    start = SE2(*SPEC.center_of(40, column), 0.0)
    goal = SE2(-2.0, 0.0)
    result = GridPlanner().plan(costs, SPEC, start, goal)
    np.testing.assert_allclose(result.path[0, :2], [start.x, start.y])
    np.testing.assert_allclose(result.path[-1, :2], [goal.x, goal.y])
    if column == 96:
        assert clearance_costs(costs, result.path).max() == 253
    assert result.cost > np.hypot(goal.x - start.x, goal.y - start.y) - 0.05


def test_a_start_deep_in_an_obstacle_is_a_named_failure() -> None:
    cells = two_rooms()
    cells[20:80, 20:80] = 254
    with pytest.raises(StartOccupiedError):
        GridPlanner().plan(inflated(cells), SPEC, SE2(*SPEC.center_of(50, 50)), SE2(6.0, 0.0))


def test_places_outside_of_the_map_are_named_failures() -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    for wrong in (SE2(100.0, 0.0), SE2(math.nan, 0.0), SE2(0.0, -2.01)):
        with pytest.raises(StartOutsideMapError):
            GridPlanner().plan(costs, SPEC, wrong, SE2())
        with pytest.raises(GoalOutsideMapError):
            GridPlanner().plan(costs, SPEC, SE2(), wrong)
    with pytest.raises(BadInputError):
        GridPlanner().plan(costs[:10], SPEC, SE2(), SE2(1.0, 1.0))


def test_start_and_goal_in_one_cell() -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    result = GridPlanner().plan(costs, SPEC, SE2(0.01, 0.01), SE2(0.02, 0.03, 2.0))
    np.testing.assert_allclose(result.path[0, :2], [0.01, 0.01])
    np.testing.assert_allclose(result.path[-1], [0.02, 0.03, 2.0])
    same = GridPlanner().plan(costs, SPEC, SE2(0.01, 0.01), SE2(0.01, 0.01, 2.0))
    assert np.isfinite(same.path).all()
    assert same.path[0, 2] == 2.0


def test_the_input_stays_untouched_and_may_be_read_only() -> None:
    costs = random_world(1)
    costs[:10] = 0
    before = costs.copy()
    costs.flags.writeable = False
    GridPlanner().plan(costs, SPEC, SE2(-2.9, -1.9), SE2(6.9, -1.7))
    np.testing.assert_array_equal(costs, before)


def test_distance_field_agrees_with_planned_lengths() -> None:
    costs = inflated(two_rooms())
    field = distance_field(costs, SPEC, SE2(-2.0, 0.0))
    raw = GridPlanner(PlannerConfig(factor=0.0, is_smooth=False)).plan(costs, SPEC, SE2(-2.0, 0.0), SE2(6.0, 4.0))
    assert field[SPEC.cell_of(6.0, 4.0)] == pytest.approx(raw.cost, abs=0.05)
    assert field[SPEC.cell_of(-2.0, 0.0)] == 0.0
    assert np.isinf(field[costs >= 253]).all()
    with pytest.raises(StartOutsideMapError):
        distance_field(costs, SPEC, SE2(99.0, 0.0))


def gap(shut: bool = False) -> np.ndarray:
    """Return a blind gap, 0.7 m wide and 3 m long, that opens into a room; the robot's radius makes all of it inscribed."""
    cells = np.zeros(SPEC.shape, np.uint8)
    cells[:, 140:] = 254
    cells[73:87, 80:140] = 253
    cells[:73, 80:140], cells[87:, 80:140] = 254, 254
    if shut:
        cells[:, 90:92] = 254
    return cells


def test_a_robot_leaves_a_gap_in_which_it_cannot_turn_along_the_gap():
    start, goal = SE2(*SPEC.center_of(80, 130)), SE2(*SPEC.center_of(20, 20))
    with pytest.raises(StartOccupiedError):
        GridPlanner(PlannerConfig(escape_radius=0.5)).plan(gap(), SPEC, start, goal)
    way = GridPlanner(PlannerConfig(escape_radius=0.5, way_out=4.0)).plan(gap(), SPEC, start, goal).path
    costs = gap()[tuple(SPEC.cells_of(way[:, :2]).T)]
    assert costs.max() < 254
    assert np.isfinite(distance_field(gap(), SPEC, start, escape_radius=0.5, way_out=4.0)[20, 20])


def test_it_does_not_leave_it_through_what_shuts_it():
    start, goal = SE2(*SPEC.center_of(80, 130)), SE2(*SPEC.center_of(20, 20))
    with pytest.raises(StartOccupiedError):
        GridPlanner(PlannerConfig(escape_radius=0.5, way_out=4.0)).plan(gap(shut=True), SPEC, start, goal)


@pytest.mark.parametrize("far", [2e3, 1e5, 5e5, 1e12])
def test_a_goal_that_is_out_of_reach_of_any_grid_is_outside(far: float) -> None:
    """One of another frame, say, must not fill the memory with unknown ground."""
    planner = GridPlanner(PlannerConfig(is_unknown_allowed=True))
    with pytest.raises(GoalOutsideMapError, match="too far"):
        planner.plan(np.zeros(SPEC.shape, np.uint8), SPEC, SE2(0.0, 0.0), SE2(far, far))


@pytest.mark.parametrize("name", ["corner_cells", "shortcut_window", "spacing"])
def test_corners_lie_somewhere_apart(name: str) -> None:
    with pytest.raises(BadInputError, match=f"planner.{name} must be positive"):
        PlannerConfig(**{name: 0})
