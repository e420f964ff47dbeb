"""Surveys: goals, gains, states and reasons on small maps; strategies on small sets; the whole mission in an ideal world."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ambler.core.errors import BadInputError, StartOccupiedError
from ambler.core.grid import OCC_ASSUMED, GridSpec
from ambler.core.messages import CostGrid, Frontier, FrontierState, OccupancyGrid
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.exploration.choice import ChoiceConfig, choose, find_again
from ambler.exploration.strategies import GreedyStrategy, NearestStrategy
from ambler.exploration.survey import FrontierSurvey, Survey, SurveyConfig
from ambler.exploration.tour import TourConfig, TourStrategy
from ambler.kernels.frontier_value import shrink_costs, visible_unknown

R = 0.1


def path_distances(costs: NDArray[np.uint8], spec: GridSpec, start: SE2) -> NDArray[np.float32]:
    """Dijkstra of SciPy over free cells: an oracle that shares nothing with the kernels."""
    free = costs < 253
    index = np.arange(costs.size).reshape(costs.shape)
    rows, columns, lengths = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = np.s_[: costs.shape[0] - dy, max(0, -dx) : costs.shape[1] - max(0, dx)]
        b = np.s_[dy:, max(0, dx) : costs.shape[1] + min(0, dx)]
        both = free[a] & free[b]
        rows.append(index[a][both])
        columns.append(index[b][both])
        lengths.append(np.full(both.sum(), spec.resolution * math.hypot(dx, dy)))
    graph = csr_array(
        (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), shape=(costs.size, costs.size)
    )
    iy, ix = spec.cell_of(start.x, start.y)
    return dijkstra(graph, directed=False, indices=index[iy, ix]).reshape(costs.shape).astype(np.float32)


def corridor() -> NDArray[np.int8]:
    """A corridor of 10 x 2 m, explored up to x = 6 m; walls around it; spec as in `grids`."""
    occupancy = np.full((40, 120), -1, np.int8)
    occupancy[10:30, 10:70] = 0
    occupancy[9, 9:70] = occupancy[30, 9:70] = 100
    occupancy[9:31, 9] = 100
    return occupancy


def grids(occupancy: NDArray[np.int8], inflate: int = 0) -> tuple[OccupancyGrid, CostGrid]:
    spec = GridSpec(R, occupancy.shape[1], occupancy.shape[0], 0.0, 0.0)
    costs = np.where(occupancy < 0, 255, np.where(occupancy > 50, 254, 0)).astype(np.uint8)
    for iy, ix in np.argwhere(occupancy > 50):
        near = costs[max(0, iy - inflate) : iy + inflate + 1, max(0, ix - inflate) : ix + inflate + 1]
        near[near < 253] = 253
    return OccupancyGrid(0, "map", spec, occupancy), CostGrid(0, "map", spec, costs)


def survey_of(occupancy: NDArray[np.int8], config: SurveyConfig | None = None, inflate: int = 0) -> Survey:
    surveyor = FrontierSurvey(config or SurveyConfig(), path_distances)
    return surveyor.update(*grids(occupancy, inflate), SE2(2.0, 2.0))


def test_the_open_end_of_a_corridor_is_the_frontier() -> None:
    survey = survey_of(corridor())
    (end,) = survey.frontiers
    assert survey.open == (0,)
    assert end.goal is not None
    x, y, yaw = end.goal
    assert (x, y) == pytest.approx((6.95, 2.0), abs=0.06)
    assert yaw == pytest.approx(0.0, abs=0.05)
    assert end.path_distance == pytest.approx(x - 2.0, abs=0.15)
    assert end.centroid == pytest.approx((6.95, 2.0))
    assert survey.known_area == pytest.approx(np.count_nonzero(corridor() >= 0) * R * R)
    assert survey.reachable_area == pytest.approx(20 * 60 * R * R)


def test_a_goal_keeps_out_of_inflated_cells_and_stays_near_its_frontier() -> None:
    occupancy = corridor()
    occupancy[12:29, 69] = 100
    survey = survey_of(occupancy, SurveyConfig(min_size=0.1, goal_reach=1.0), inflate=3)
    for frontier in survey.frontiers:
        assert frontier.goal is not None
        cell = survey.costs.spec.cell_of(frontier.goal[0], frontier.goal[1])
        assert survey.costs.data[cell] == 0
        assert np.hypot(*(frontier.cells - np.float32(frontier.goal[:2])).T).min() <= 1.0 * math.sqrt(2)


def test_what_cannot_be_reached_says_so() -> None:
    occupancy = corridor()
    occupancy[9:31, 40] = 100
    (beyond,) = survey_of(occupancy).frontiers
    assert beyond.state is FrontierState.UNREACHABLE
    assert beyond.reason == "no cell that the robot can reach within 1.0 m of it"


def test_dust_is_too_small_with_its_numbers() -> None:
    occupancy = corridor()
    occupancy[10:30, 70] = 100
    occupancy[20, 30] = -1
    (dust,) = survey_of(occupancy).frontiers
    assert dust.state is FrontierState.TOO_SMALL
    assert dust.reason == "0.40 m long, less than 0.50 m"


def test_a_long_sliver_along_a_wall_shows_too_little() -> None:
    occupancy = corridor()
    occupancy[10:30, 70] = 100
    occupancy[28:30, 20:60] = -1
    (sliver,) = survey_of(occupancy).frontiers
    assert len(sliver.cells) * R > 3.0
    assert sliver.state is FrontierState.TOO_SMALL
    assert "of unknown visible" in sliver.reason


def test_what_is_only_assumed_is_driven_through_and_still_to_be_seen() -> None:
    occupancy = corridor()
    occupancy[10:30, 70] = 100
    occupancy[10:30, 25:45] = OCC_ASSUMED
    assert survey_of(occupancy).frontiers == (), "a map that has no such cells has nothing left"
    surveyor = FrontierSurvey(SurveyConfig(assumed=OCC_ASSUMED), path_distances)
    assert surveyor.update(*grids(occupancy), SE2(2.0, 2.0)).frontiers == (), "it will see that when it drives on"
    surveyor.is_strict = True
    survey = surveyor.update(*grids(occupancy), SE2(2.0, 2.0))
    assert {round(f.centroid[0], 2) for f in survey.frontiers} == {2.45, 4.55}
    assert len(survey.open) == 2
    assert survey.reachable_area == pytest.approx(20 * 60 * R * R), "it may drive there"
    assert survey.known_area < 20 * 62 * R * R


def test_what_was_assumed_once_calls_nobody_back_until_nothing_else_is_left() -> None:
    occupancy = corridor()
    occupancy[10:30, 70] = 100
    near, away = occupancy.copy(), occupancy.copy()
    near[10:30, 25:45], away[10:30, 25:45] = OCC_ASSUMED, -1
    surveyor = FrontierSurvey(SurveyConfig(assumed=OCC_ASSUMED), path_distances)
    assert surveyor.update(*grids(near), SE2(2.0, 2.0)).frontiers == ()
    assert surveyor.update(*grids(away), SE2(6.0, 2.0)).frontiers == (), "the robot was there"
    beyond = away.copy()
    beyond[10:30, 50:60] = -1
    (new,) = (f for f in surveyor.update(*grids(beyond), SE2(4.7, 2.0)).frontiers if f.state is FrontierState.OPEN)
    assert new.centroid[0] == pytest.approx(4.95), "nothing was ever assumed there"
    surveyor.is_strict = True
    survey = surveyor.update(*grids(beyond), SE2(4.7, 2.0))
    assert {round(f.centroid[0], 2) for f in survey.frontiers if f.state is FrontierState.OPEN} >= {4.55, 4.95}


def test_what_goes_on_beyond_the_map_calls_back_at_once() -> None:
    """A landing at the top of a ramp: assumed from there, and unknown again when the robot has gone."""
    near, away = corridor(), corridor()
    near[10:30, 50:70], away[10:30, 50:70] = OCC_ASSUMED, -1
    near[10:30, 70:], away[10:30, 70:] = -1, -1
    surveyor = FrontierSurvey(SurveyConfig(assumed=OCC_ASSUMED), path_distances)
    surveyor.update(*grids(near), SE2(4.5, 2.0))
    (edge,) = (f for f in surveyor.update(*grids(away), SE2(2.0, 2.0)).frontiers if f.state is FrontierState.OPEN)
    assert edge.centroid[0] == pytest.approx(4.95)


def from_afar(
    occupancy: NDArray[np.int8],
    *,
    is_overlooked: bool = True,
    place: tuple[float, float] = (6.0, 2.0),
    pocket_most: float = 12.0,
) -> FrontierSurvey:
    """A survey for a scanner that sees the floor from 5.2 m on; what is unknown of a map was only assumed when the robot was at `place`."""
    surveyor = FrontierSurvey(
        SurveyConfig(assumed=OCC_ASSUMED, sees_floor=(5.2, 6.2), pocket_most=pocket_most), path_distances
    )
    before = np.where(occupancy < 0, OCC_ASSUMED, occupancy).astype(np.int8) if is_overlooked else occupancy
    surveyor.update(*grids(before), SE2(*place))
    surveyor.is_strict = True
    return surveyor


def bay() -> NDArray[np.int8]:
    """A hall of 11 x 8 m, known but for a bay of 2 x 2 m between two walls at its upper side, of which the first 0.5 m were seen; spec as in `grids`."""
    occupancy = np.full((100, 120), 100, np.int8)
    occupancy[5:85, 5:115] = 0
    occupancy[65:85, 5:115] = 100
    occupancy[65:85, 50:70] = -1
    occupancy[65:70, 50:70] = 0
    return occupancy


def test_a_scanner_that_does_not_see_the_floor_beside_itself_looks_from_where_it_does() -> None:
    near_goal = survey_of(bay()).frontiers[0].goal
    surveyor = from_afar(bay())
    blind = surveyor.update(*grids(bay()), SE2(0.8, 6.2))
    (frontier,) = (f for f in blind.frontiers if f.state is FrontierState.OPEN)
    assert near_goal is not None
    assert frontier.goal is not None
    x, y, yaw = frontier.goal
    assert math.hypot(near_goal[0] - 6.0, near_goal[1] - 7.0) < 1.1
    away = math.hypot(x - frontier.centroid[0], y - frontier.centroid[1])
    assert 5.1 <= away <= 6.3
    assert yaw == pytest.approx(math.atan2(frontier.centroid[1] - y, frontier.centroid[0] - x), abs=0.05)
    in_sight = 0
    for cell in frontier.cells:
        line = np.floor(np.linspace((x, y), cell, 300) / R).astype(int)
        in_sight += bool((bay()[line[:, 1], line[:, 0]] <= 0).all())
    assert in_sight >= 0.4 * len(frontier.cells)


@pytest.mark.parametrize(("depth", "nearest", "is_goal"), [(4, 5.2, True), (15, 5.2, False), (15, 0.5, True)])
def test_who_does_not_see_the_floor_beside_himself_is_not_sent_to_where_it_is_only_assumed(
    depth: int, nearest: float, *, is_goal: bool
) -> None:
    occupancy = bay()
    occupancy[15:55, 109:115] = -1  # there is something else to look at
    band = occupancy[70 - depth : 70]
    band[band == 0] = OCC_ASSUMED
    config = SurveyConfig(assumed=OCC_ASSUMED, sees_floor=(nearest, 6.2))
    surveyor = FrontierSurvey(config, path_distances)
    for _ in range(2):  # the first look at it may be from afar; from beside the bay nobody sees into it
        survey = surveyor.update(*grids(occupancy), SE2(0.8, 6.2))
        (frontier,) = (f for f in survey.frontiers if f.centroid[1] > 6.5)
        surveyor.memory.refuse(frontier, "nothing changed", grids(occupancy)[0], has_looked=True)
    assert (frontier.goal is not None) == is_goal
    if frontier.goal is not None and nearest > 1.0:
        assert occupancy[round(frontier.goal[1] / R - 0.5), round(frontier.goal[0] / R - 0.5)] == 0


def test_where_nothing_else_is_left_it_goes_on_over_ground_that_is_only_assumed() -> None:
    """As on the last metres of a ramp, from where a level LiDAR looks over the floor of the landing."""
    occupancy = bay()
    band = occupancy[55:70]
    band[band == 0] = OCC_ASSUMED
    surveyor = FrontierSurvey(SurveyConfig(assumed=OCC_ASSUMED, sees_floor=(5.2, 6.2)), path_distances)
    kinds = []
    for _ in range(2):
        (frontier,) = surveyor.update(*grids(occupancy), SE2(6.0, 2.0)).frontiers
        assert frontier.state is FrontierState.OPEN
        assert frontier.goal is not None
        kinds.append(int(occupancy[round(frontier.goal[1] / R - 0.5), round(frontier.goal[0] / R - 0.5)]))
        surveyor.memory.refuse(frontier, "nothing changed", grids(occupancy)[0], has_looked=True)
    assert kinds == [0, OCC_ASSUMED], "first from where it sees the floor"


def test_what_did_not_show_itself_from_afar_is_gone_to() -> None:
    surveyor = from_afar(bay())
    (frontier,) = (f for f in surveyor.update(*grids(bay()), SE2(6.0, 2.0)).frontiers if f.goal is not None)
    surveyor.memory.refuse(frontier, "nothing changed", grids(bay())[0], has_looked=True)
    (again,) = (f for f in surveyor.update(*grids(bay()), SE2(6.0, 2.0)).frontiers if f.goal is not None)
    assert again.state is FrontierState.OPEN
    ways = [math.hypot(f.goal[0] - f.centroid[0], f.goal[1] - f.centroid[1]) for f in (frontier, again) if f.goal]
    assert ways[0] > 5.0
    assert ways[1] < 1.1


def test_what_did_not_show_itself_from_afar_nor_from_near_is_left_alone() -> None:
    """Ground in a hollow: the robot was beside it, and looked once from where it sees the floor."""
    surveyor = from_afar(bay(), place=(6.0, 6.0))
    (frontier,) = (f for f in surveyor.update(*grids(bay()), SE2(6.0, 2.0)).frontiers if f.goal is not None)
    assert frontier.state is FrontierState.OPEN
    assert frontier.goal is not None
    assert math.hypot(frontier.goal[0] - frontier.centroid[0], frontier.goal[1] - frontier.centroid[1]) > 5.0
    surveyor.memory.refuse(frontier, "nothing changed", grids(bay())[0], has_looked=True)
    survey = surveyor.update(*grids(bay()), SE2(6.0, 2.0))
    (again,) = (f for f in survey.frontiers if f.goal is not None)
    assert again.state is FrontierState.UNREACHABLE
    assert "was near it" in again.reason
    assert survey.shut == (), "nobody stands in the way of it"


def test_what_hides_much_is_gone_to_though_the_robot_was_near() -> None:
    surveyor = from_afar(bay(), place=(6.0, 6.0), pocket_most=1.0)
    (frontier,) = (f for f in surveyor.update(*grids(bay()), SE2(6.0, 2.0)).frontiers if f.goal is not None)
    surveyor.memory.refuse(frontier, "nothing changed", grids(bay())[0], has_looked=True)
    (again,) = (f for f in surveyor.update(*grids(bay()), SE2(6.0, 2.0)).frontiers if f.goal is not None)
    assert again.state is FrontierState.OPEN


def test_where_the_robot_was_near_and_no_place_shows_the_floor_nobody_goes_again() -> None:
    occupancy = bay()
    occupancy[5:25] = 100
    occupancy[25:65, 5:45] = occupancy[25:65, 75:115] = 100
    surveyor = from_afar(occupancy, place=(6.0, 6.0))
    survey = surveyor.update(*grids(occupancy), SE2(6.0, 4.0))
    assert survey.open == ()
    assert any("was near it" in f.reason for f in survey.frontiers)
    surveyor.is_strict = False
    assert surveyor.update(*grids(occupancy), SE2(6.0, 4.0)).open == ()


def test_what_the_robot_has_not_been_near_is_gone_to() -> None:
    surveyor = from_afar(bay(), is_overlooked=False)
    (frontier,) = (f for f in surveyor.update(*grids(bay()), SE2(0.8, 6.2)).frontiers if f.goal is not None)
    assert frontier.goal is not None
    assert math.hypot(frontier.goal[0] - frontier.centroid[0], frontier.goal[1] - frontier.centroid[1]) < 1.1


def test_where_there_is_no_such_place_the_goal_is_near() -> None:
    occupancy = bay()
    occupancy[5:25] = 100  # nothing within 5 m of the bay is far enough away and in line with it
    occupancy[25:65, 5:45] = occupancy[25:65, 75:115] = 100
    surveyor = from_afar(occupancy)
    blind = surveyor.update(*grids(occupancy), SE2(6.0, 4.0))
    (frontier,) = (f for f in blind.frontiers if f.state is FrontierState.OPEN)
    assert frontier.goal is not None
    assert math.hypot(frontier.goal[0] - frontier.centroid[0], frontier.goal[1] - frontier.centroid[1]) < 1.1


def ramp_top(*, is_in_sight: bool) -> NDArray[np.int8]:
    """Seen floor with a bay that is open, and a way of which the ground is only assumed up to 6 m from (1.5, 5): straight on, or round a corner."""
    occupancy = np.full((100, 120), 100, np.int8)
    occupancy[40:64, 5:20] = 0
    occupancy[64:80, 5:20] = -1
    occupancy[40:60, 20 : 75 if is_in_sight else 40] = OCC_ASSUMED
    if is_in_sight:
        occupancy[40:60, 75:115] = -1
    else:
        occupancy[10:60, 40:60] = OCC_ASSUMED
        occupancy[10:30, 60:115] = -1
    return occupancy


@pytest.mark.parametrize("is_in_sight", [True, False])
def test_ground_that_falls_away_in_open_sight_is_gone_to_over_what_is_assumed(is_in_sight: bool) -> None:
    """At the top of a ramp the scanner looks over the landing; round a corner a kerb may hide."""
    surveyor = FrontierSurvey(SurveyConfig(assumed=OCC_ASSUMED, sees_floor=(5.2, 6.2)), path_distances)
    told, place = grids(ramp_top(is_in_sight=is_in_sight)), SE2(1.5, 5.0)
    survey = surveyor.update(*told, place)
    assert not any(survey.frontiers[k].centroid[0] > 5.5 for k in survey.open), "nobody has looked yet"
    (end,) = (f for f in survey.frontiers if f.centroid[0] > 5.5)
    surveyor.memory.refuse(end, "its ground is only assumed", told[0], has_looked=True)
    survey = surveyor.update(*told, place)
    goals = [survey.frontiers[k].goal for k in survey.open]
    assert any(goal is not None and goal[1] > 5.5 and goal[0] < 2.5 for goal in goals), "the bay is open all the time"
    assert any(goal is not None and goal[0] > 5.5 for goal in goals) == is_in_sight


def test_what_recedes_before_the_robot_is_driven_towards() -> None:
    """The edge of what it sees ahead is no place to stop five metres before."""
    occupancy = corridor()
    occupancy[10:30, 70:90] = 0
    occupancy[9, 70:90] = occupancy[30, 70:90] = 100
    surveyor = from_afar(occupancy)
    goals = {}
    for x in (2.0, 3.5, 4.5):
        (end,) = surveyor.update(*grids(occupancy), SE2(x, 2.0)).frontiers
        assert end.goal is not None
        goals[x] = end.goal[0]
    assert goals[2.0] > 8.0, "the edge is 6.9 m away"
    assert goals[3.5] > 8.0, "it has just come near enough"
    assert goals[4.5] == pytest.approx(3.7, abs=0.3), "now it is too near, and looks from where it sees the floor"


def test_a_ring_of_frontier_around_the_robot_is_gone_to() -> None:
    """A robot at its start sees a ring of floor from 5 m on; nothing within it."""
    spec = GridSpec(R, 160, 160, 0.0, 0.0)
    y, x = np.mgrid[:160, :160] + 0.5
    away = np.hypot(x - 80.0, y - 80.0)
    occupancy = np.where(away < 50.0, OCC_ASSUMED, np.where(away < 65.0, 0, 100)).astype(np.int8)
    surveyor = from_afar(occupancy)
    survey = surveyor.update(*grids(occupancy), SE2(8.0, 8.0))
    (ring,) = survey.open
    goal = survey.frontiers[ring].goal
    assert goal is not None
    assert spec.contains(goal[0], goal[1])
    assert math.hypot(goal[0] - 8.0, goal[1] - 8.0) < 6.5


def test_grids_that_do_not_fit_together_are_refused() -> None:
    occupancy, costs = grids(corridor())
    shifted = CostGrid(0, "map", GridSpec(R, 120, 40, 0.03, 0.0), costs.data)
    with pytest.raises(BadInputError, match="aligned"):
        FrontierSurvey(SurveyConfig(), path_distances).update(occupancy, shifted, SE2(2.0, 2.0))


def test_a_larger_costmap_with_another_origin_gives_the_same_goal() -> None:
    occupancy, costs = grids(corridor())
    wide = np.full((60, 150), 255, np.uint8)
    wide[10:50, 20:140] = costs.data
    wider = CostGrid(0, "map", GridSpec(R, 150, 60, -2.0, -1.0), wide)
    surveyor = FrontierSurvey(SurveyConfig(), path_distances)
    assert surveyor.update(occupancy, wider, SE2(2.0, 2.0)).frontiers[0].goal == survey_of(corridor()).frontiers[0].goal


def test_a_robot_that_stands_where_it_may_not_be_reaches_nothing() -> None:
    def nowhere(costs: NDArray[np.uint8], spec: GridSpec, start: SE2) -> NDArray[np.float32]:
        raise StartOccupiedError("inside a wall")

    survey = FrontierSurvey(SurveyConfig(), nowhere).update(*grids(corridor()), SE2(2.0, 2.0))
    assert survey.reachable_area == 0.0
    assert survey.frontiers[0].state is FrontierState.UNREACHABLE


def seen_through_a_slit() -> NDArray[np.int8]:
    """A room of 9 x 8 m, known up to x = 6 m: a frontier 8 m wide."""
    occupancy = np.full((100, 120), -1, np.int8)
    occupancy[10:90, 10:70] = 0
    occupancy[9, 9:70] = occupancy[90, 9:70] = 100
    occupancy[9:91, 9] = 100
    return occupancy


def looked_at(surveyor: FrontierSurvey, occupancy: NDArray[np.int8]) -> Frontier:
    """Survey, and look at the frontier from its goal in vain; return the frontier as it was judged."""
    (frontier,) = surveyor.update(*grids(occupancy), SE2(2.0, 2.0, 0.0)).frontiers
    assert frontier.goal is not None
    place = frontier.goal[:2]
    if frontier.state is FrontierState.OPEN:
        surveyor.memory.refuse(frontier, "nothing changed", grids(occupancy)[0], has_looked=True, place=place)
    return frontier


def test_a_wide_frontier_that_showed_nothing_is_looked_at_from_elsewhere() -> None:
    surveyor = FrontierSurvey(SurveyConfig(), path_distances)
    looks = [looked_at(surveyor, seen_through_a_slit()) for _ in range(5)]
    assert [look.state for look in looks] == [FrontierState.OPEN] * 4 + [FrontierState.UNREACHABLE]
    assert looks[0].goal == looks[1].goal  # twice from one place, as before
    places = np.array([look.goal for look in looks[1:4] if look.goal is not None])[:, :2]
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    assert np.all(apart[~np.eye(3, dtype=bool)] >= 1.5 * SurveyConfig().goal_reach)
    assert np.all(places[:, 0] > 6.0)  # and each beside the frontier, at x = 7 m


def test_a_narrow_frontier_has_no_elsewhere() -> None:
    surveyor = FrontierSurvey(SurveyConfig(), path_distances)
    looks = [looked_at(surveyor, corridor()) for _ in range(3)]
    assert [look.state for look in looks] == [FrontierState.OPEN] * 2 + [FrontierState.UNREACHABLE]
    assert looks[-1].reason == "looked at 2 times: nothing changed"


def test_a_frontier_that_failed_on_the_way_has_no_place_to_look_away_from() -> None:
    surveyor = FrontierSurvey(SurveyConfig(), path_distances)
    view = (*grids(seen_through_a_slit()), SE2(2.0, 2.0, 0.0))
    for _ in range(2):
        (frontier,) = surveyor.update(*view).frontiers
        surveyor.memory.refuse(frontier, "it closes and opens again", view[0], has_looked=True)
    assert surveyor.update(*view).frontiers[0].state is FrontierState.UNREACHABLE


def test_sizes_come_from_the_robot() -> None:
    footprint = np.array([[0.4, 0.3], [-0.4, 0.3], [-0.4, -0.3], [0.4, -0.3]])
    config = SurveyConfig.from_robot(RobotModel("r", DriveKind.DIFFERENTIAL, footprint, VelocityLimits()), 100)
    assert config.min_size == pytest.approx(0.6)


def test_visible_area_of_an_open_half_plane_is_half_a_disc() -> None:
    occupancy = np.zeros((201, 201), np.int8)
    occupancy[:, 101:] = -1
    assert seen_from_the_middle(occupancy) == pytest.approx((math.pi * 16 / 2, 0.0), rel=0.03, abs=0.02)
    occupancy[:, 100:102] = 100
    occupancy[100, 100] = 0
    assert seen_from_the_middle(occupancy)[0] == 0.0


def seen_from_the_middle(occupancy: np.ndarray) -> tuple[float, float]:
    """Return the unknown area that is visible from the middle of a map of 201 x 201 cells, and where it lies."""
    area, heading, middle = np.empty(1), np.empty(1), np.array([100 * 201 + 100])
    surfaces, sides = np.zeros((201, 201), np.uint8), np.zeros(1, np.uint8)
    visible_unknown(occupancy, surfaces, 50, 0.05, 4.0, 720, middle, sides, area, heading)
    return float(area[0]), float(heading[0])


def test_coarse_costs_are_the_least_of_each_block() -> None:
    rng = np.random.default_rng(0)
    costs = rng.integers(0, 256, (22, 31)).astype(np.uint8)
    out = np.empty((6, 8), np.uint8)
    shrink_costs(costs, 4, out)
    padded = np.full((24, 32), 255, np.uint8)
    padded[:22, :31] = costs
    assert np.array_equal(out, padded.reshape(6, 4, 8, 4).min(axis=(1, 3)))


def cross() -> NDArray[np.int8]:
    """A crossing of two corridors with four open ends: west 3 m, east 5 m, south 1.5 m, north 1.5 m from the middle."""
    occupancy = np.full((60, 110), -1, np.int8)
    occupancy[22:38, 10:90] = 0
    occupancy[21, 10:90] = occupancy[38, 10:90] = 100
    occupancy[15:45, 32:48] = 0
    occupancy[15:22, 31] = occupancy[15:22, 48] = occupancy[38:45, 31] = occupancy[38:45, 48] = 100
    return occupancy


def test_strategies_order_the_ends_of_a_crossing_as_they_promise() -> None:
    occupancy, costs = grids(cross())
    surveyor = FrontierSurvey(SurveyConfig(), path_distances)
    base = SE2(3.4, 3.0)
    survey = surveyor.update(occupancy, costs, base)
    assert len(survey.open) == 4
    distances = [survey.frontiers[i].path_distance for i in survey.open]
    assert NearestStrategy().costs(survey, base) == pytest.approx(distances)
    greedy = GreedyStrategy(1.0, 0.0).costs(survey, base)
    assert all(g <= d + R for g, d in zip(greedy, distances, strict=True))
    tour = TourStrategy(path_distances, TourConfig(coarse_cell=R, urgency=0.0, seen_from=0.0)).costs(survey, base)
    last = int(np.argmax([survey.frontiers[i].centroid[0] for i in survey.open]))
    assert int(np.argmax(tour)) == last
    assert tour.min() >= max(distances)


def test_hysteresis_and_recognition() -> None:
    occupancy, costs = grids(cross())
    survey = FrontierSurvey(SurveyConfig(), path_distances).update(occupancy, costs, SE2(3.4, 3.0))
    config = ChoiceConfig(hysteresis=0.2, min_saving=0.0)
    nearest = choose(survey, NearestStrategy(), SE2(3.4, 3.0), None, config)
    farthest = max(survey.open, key=lambda i: survey.frontiers[i].path_distance)
    assert choose(survey, NearestStrategy(), SE2(3.4, 3.0), farthest, config) == nearest
    assert choose(survey, NearestStrategy(), SE2(3.4, 3.0), nearest, config) == nearest
    for i in survey.open:
        assert find_again(survey.frontiers[i], survey, config) == i


def test_a_target_is_not_mistaken_for_a_long_neighbour_beside_it() -> None:
    """The neighbour has more cells within the matching distance of the target than the target itself."""
    x = np.arange(0.0, 0.5, R)
    target = np.stack([x, np.zeros_like(x)], axis=1).astype(np.float32)
    x = np.arange(-2.0, 2.5, R)
    neighbour = np.stack([x, np.full_like(x, 0.15)], axis=1).astype(np.float32)
    frontiers = tuple(
        Frontier(cells, (0.0, 0.0), (0.0, 0.0, 0.0), 1.0, FrontierState.OPEN) for cells in (neighbour, target)
    )
    spec = GridSpec(R, 2, 2, 0.0, 0.0)
    survey = Survey(frontiers, np.ones(2), (0, 1), 1.0, 1.0, CostGrid(0, "map", spec, np.zeros((2, 2), np.uint8)))
    assert find_again(frontiers[1], survey, ChoiceConfig()) == 1
    assert find_again(frontiers[0], survey, ChoiceConfig()) == 0
