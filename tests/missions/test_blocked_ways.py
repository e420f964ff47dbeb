"""Marks where the controller failed three times: where they lie, that they end, and that the planner goes around them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.errors import BadInputError, PlanningError
from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.messages import CostGrid, Path
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.costmap.blocked_layer import BlockedLayer
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.missions.blocked_ways import BlockedWays, BlockedWaysConfig, reachable_share
from ambler.planning.grid_planner import GridPlanner, PlannerConfig

S = 1_000_000_000
HERE = SE2(2.0, 0.0)


def straight(y: float = 0.0) -> Path:
    xs = np.arange(0.0, 8.0, 0.1)
    return Path(0, "map", np.stack((xs, np.full_like(xs, y), np.zeros_like(xs)), axis=1))


def test_the_third_failure_at_one_place_marks_the_way_ahead() -> None:
    ways = BlockedWays()
    assert [ways.fail(straight(), HERE, k * S) for k in range(3)] == [False, False, True]
    points = ways.points(3 * S)
    assert points[:, 0].min() == pytest.approx(2.6, abs=0.02)
    assert points[:, 0].max() == pytest.approx(3.2, abs=0.06)
    assert (points[:, 1].min(), points[:, 1].max()) == pytest.approx((-0.25, 0.25))


def test_what_holds_the_robot_is_marked_at_once_before_its_body_and_to_both_sides() -> None:
    ways = BlockedWays(BlockedWaysConfig(front=0.4))
    turned = SE2(2.0, 0.0, 2.0)
    assert ways.hold(straight(), turned, 0)
    points = ways.points(S)
    assert (points[:, 0].min(), points[:, 0].max()) == pytest.approx((2.48, 3.08), abs=0.03)
    assert (points[:, 1].min(), points[:, 1].max()) == pytest.approx((-0.5, 0.5))
    assert len(ways.points(239 * S)) > 0
    assert len(ways.points(241 * S)) == 0, "whoever held it may have left"


def test_a_kerb_that_is_met_twice_goes_on_to_both_sides() -> None:
    """It runs at 45 degrees to the way: its line is known from where the robot was held."""
    ways = BlockedWays(BlockedWaysConfig(front=0.3, beyond=2.5))
    ways.hold(straight(), SE2(2.0, 0.0), 0)
    ways.hold(straight(1.5), SE2(3.5, 1.5), S)
    points, along = ways.points(2 * S), np.arange(-1.7, 3.2, 0.1)
    kerb = np.column_stack((2.38 + along, along))
    away = np.hypot(*(points[:, None] - kerb[None]).transpose(2, 0, 1))
    assert away.min(axis=0).max() < 0.05, "all of it is marked"
    assert away.min(axis=1).max() < 0.8, "and what is beside it is not"
    assert len(ways.points(3000 * S)) > 0, "a kerb does not walk away"
    ways.fail(straight(), HERE, 2 * S)
    assert not ways.fail(straight(), HERE, 3 * S), "a way that fails takes three of them, as ever"


def test_who_holds_the_robot_twice_among_people_is_no_kerb() -> None:
    ways = BlockedWays(BlockedWaysConfig(front=0.3))
    ways.hold(straight(), SE2(2.0, 0.0), 0, is_in_company=True)
    assert len(ways.points(9 * S)) > 0
    assert len(ways.points(11 * S)) == 0
    ways.hold(straight(1.5), SE2(3.5, 1.5), 12 * S, is_in_company=True)
    points = ways.points(13 * S)
    assert np.ptp(points, axis=0).max() < 1.1, "what lies between the two places is free"
    assert len(ways.points(31 * S)) > 0, "twice as long the second time"
    assert len(ways.points(33 * S)) == 0


def test_two_things_far_apart_are_two() -> None:
    ways = BlockedWays(BlockedWaysConfig(front=0.3))
    ways.hold(straight(), SE2(1.0, 0.0), 0)
    ways.hold(straight(), SE2(6.0, 0.0), S)
    points = ways.points(2 * S)
    assert not ((points[:, 0] > 2.1) & (points[:, 0] < 6.2)).any()


def test_what_would_shut_the_robot_in_is_not_marked() -> None:
    data = np.full((40, 200), COST_LETHAL, np.uint8)
    data[8:32, 10:190] = 0
    costs = CostGrid(0, "map", GridSpec(0.05, 200, 40, 0.0, -1.0), data)
    ways = BlockedWays(BlockedWaysConfig(front=0.3))
    assert not ways.hold(straight(), SE2(1.5, 0.0), 0, costs)
    assert len(ways.points(S)) == 0
    assert ways.hold(straight(), SE2(7.5, 0.0), 0, costs)


def test_what_holds_a_robot_at_the_end_of_its_path_is_marked_ahead_of_it() -> None:
    ways = BlockedWays(BlockedWaysConfig(front=0.3))
    assert ways.hold(straight(), SE2(7.7, 0.0), 0)
    points = ways.points(S)
    assert points[:, 0].min() == pytest.approx(8.08, abs=0.02)
    assert np.ptp(points[:, 1]) == pytest.approx(1.0)


def test_failures_apart_in_place_or_time_do_not_add_up() -> None:
    ways = BlockedWays()
    places = (2.0, 4.0, 0.5)
    assert not any(ways.fail(straight(), SE2(x, 0.0), k * S) for k, x in enumerate(places))
    ways = BlockedWays(BlockedWaysConfig(memory=100.0))
    assert not any(ways.fail(straight(), HERE, k * 60 * S) for k in range(5))


def test_a_mark_ends_and_comes_back_for_twice_as_long() -> None:
    ways = BlockedWays(BlockedWaysConfig(keep=60.0))

    def mark(at_s: int) -> None:
        assert [ways.fail(straight(), HERE, (at_s + k) * S) for k in range(3)][-1]

    mark(0)
    assert len(ways.points(61 * S)) > 0
    assert len(ways.points(63 * S)) == 0
    mark(100)
    assert len(ways.points(220 * S)) > 0
    assert len(ways.points(223 * S)) == 0


def test_a_mark_among_people_ends_soon_and_one_that_comes_back_holds_longer() -> None:
    ways = BlockedWays(BlockedWaysConfig(keep=60.0, keep_company=10.0))
    for begin_s, end_s in ((0, 12), (20, 42)):
        assert [ways.fail(straight(), HERE, (begin_s + k) * S, is_in_company=True) for k in range(3)][-1]
        assert len(ways.points((end_s - 1) * S)) > 0
        assert len(ways.points((end_s + 1) * S)) == 0


def test_one_of_several_marks_comes_back_and_the_others_stay() -> None:
    ways = BlockedWays(BlockedWaysConfig(keep=60.0))
    for begin, y in ((0, 0.0), (10, 3.0), (20, 3.0), (30, 0.0)):
        for k in range(3):
            ways.fail(straight(y), SE2(2.0, y), (begin + k) * S)
    assert len(ways.points(40 * S)) == 2 * len(ways.points(40 * S)[ways.points(40 * S)[:, 1] > 1.5])
    assert len(ways.points(145 * S)) > 0, "both came back, and hold for two minutes"
    assert len(ways.points(160 * S)) == 0


def test_near_the_end_of_a_path_its_last_point_is_marked() -> None:
    ways = BlockedWays()
    for k in range(3):
        ways.fail(straight(), SE2(7.6, 0.0), k * S)
    assert ways.points(3 * S) == pytest.approx(np.array([[7.9, 0.0]]))


def test_the_planner_goes_around_a_marked_gap_and_names_it_when_there_is_no_other() -> None:
    robot = RobotModel(
        "r", DriveKind.DIFFERENTIAL, 0.2 * np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]]), VelocityLimits()
    )
    spec = GridSpec(0.05, 160, 120, 0.0, -3.0)
    cells = np.zeros(spec.shape, np.int8)
    wall = spec.cell_of(4.0, 0.0)[1]
    cells[:, wall] = 100
    near, far = spec.cell_of(4.0, 0.0)[0], spec.cell_of(4.0, 2.2)[0]
    for gap in (near, far):
        cells[gap - 9 : gap + 10, wall] = 0
    costmap = GlobalCostmap(GlobalCostmapConfig(), robot)
    costmap.set_map(spec, cells)
    planner = GridPlanner(PlannerConfig())

    def highest() -> float:
        found = planner.plan(costmap.costs, spec, SE2(3.0, 0.0), SE2(5.5, 0.0)).path
        return float(np.abs(found[:, 1]).max())

    assert highest() < 0.5
    ways = BlockedWays()
    path = planner.plan(costmap.costs, spec, SE2(3.0, 0.0), SE2(5.5, 0.0)).path
    for k in range(3):
        ways.fail(Path(0, "map", path), SE2(3.3, 0.0), k * S)
    costmap.layer(BlockedLayer).set_points(ways.points(3 * S))
    costmap.update()
    assert highest() > 1.5
    costmap.clear()
    assert highest() > 1.5, "no sensor saw it, so none takes it back"
    cells[far - 9 : far + 10, wall] = 100
    costmap.set_map(spec, cells)
    with pytest.raises(PlanningError):
        planner.plan(costmap.costs, spec, SE2(3.0, 0.0), SE2(5.5, 0.0))
    costmap.layer(BlockedLayer).set_points(ways.points(100 * S))
    costmap.update()
    assert highest() < 0.5


@pytest.mark.parametrize(
    ("gaps", "robot_x", "least", "most"), [(1, 5.0, 0.15, 0.35), (1, 3.0, 0.6, 0.9), (2, 5.0, 0.9, 1.0)]
)
def test_how_much_a_mark_leaves_of_what_can_be_reached(gaps: int, robot_x: float, least: float, most: float) -> None:
    spec = GridSpec(0.05, 120, 80, 0.0, -2.0)
    data = np.zeros(spec.shape, np.uint8)
    wall = spec.cell_of(4.5, 0.0)[1]
    data[:, wall] = COST_LETHAL
    for y in (-1.0, 1.5)[:gaps]:
        row = spec.cell_of(0.0, y)[0]
        data[row - 6 : row + 7, wall] = 0
    mark = np.array([[4.4, -1.0], [4.6, -1.0]])
    share = reachable_share(CostGrid(0, "map", spec, data), SE2(robot_x, -1.0), mark, 0.4)
    assert least < share < most
    assert reachable_share(CostGrid(0, "map", spec, data), SE2(robot_x, -1.0), mark[:0], 0.4) == 1.0
    data = np.full_like(data, COST_LETHAL)
    assert reachable_share(CostGrid(0, "map", spec, data), SE2(robot_x, -1.0), mark, 0.4) == 0.0


@pytest.mark.parametrize(("width", "is_marked"), [(1.0, False), (6.0, True)])
def test_the_only_way_out_is_not_marked(width: float, is_marked: bool) -> None:
    spec = GridSpec(0.05, 400, 160, -2.0, -4.0)
    data = np.full(spec.shape, COST_LETHAL)
    (low, left), (high, _) = spec.cell_of(0.0, -0.5 * width), spec.cell_of(0.0, 0.5 * width)
    data[low:high, left:] = 0  # a way along x
    ways, costs = BlockedWays(), CostGrid(0, "map", spec, data)
    assert [ways.fail(straight(), HERE, k * S, costs) for k in range(3)] == [False, False, is_marked]
    assert (len(ways.points(3 * S)) > 0) is is_marked


def test_points_outside_the_grid_are_no_trouble() -> None:
    layer, spec = BlockedLayer(), GridSpec(0.1, 10, 10, 0.0, 0.0)
    layer.set_points(np.array([[-5.0, 0.0], [0.55, 0.55], [50.0, math.pi]]))
    from ambler.costmap.layer import Moment

    layer.update(spec, Moment(costmap_from_map=SE2()))
    master = np.zeros(spec.shape, np.uint8)
    layer.draw_into(master, spec, (0, 10, 0, 10))
    assert np.argwhere(master == COST_LETHAL).tolist() == [[5, 5]]


def test_nonsense_is_refused() -> None:
    with pytest.raises(BadInputError):
        BlockedWaysConfig(failures=0)
