"""Looks in passing: what the robot saw from near and stayed is no frontier any more; what it could not see still is."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import CostGrid, FrontierState, OccupancyGrid
from ambler.core.robot import DriveKind, RobotModel, SensorKind, SensorMount, VelocityLimits
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.exploration.close_looks import CloseLookConfig, CloseLooks
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.planning.distance import distance_field

R = 0.05


def room_with_a_vanished_wall() -> NDArray[np.int8]:
    """A room of 4 x 4 m; of its east wall 1 m is missing in the map, and unknown cells lie behind."""
    occupancy = np.full((120, 140), -1, np.int8)
    occupancy[20:102, 19:101] = 100
    occupancy[21:101, 20:100] = 0
    occupancy[50:70, 100] = -1
    return occupancy


def message(occupancy: NDArray[np.int8], stamp: int, crop: int = 0) -> OccupancyGrid:
    data = occupancy[crop:, crop:].copy()
    spec = GridSpec(R, data.shape[1], data.shape[0], crop * R, crop * R)
    return OccupancyGrid(stamp, "map", spec, data)


def costs_of(occupancy: OccupancyGrid) -> CostGrid:
    costs = np.where(occupancy.data < 0, 255, np.where(occupancy.data > 50, 254, 0)).astype(np.uint8)
    return CostGrid(occupancy.stamp_ns, "map", occupancy.spec, costs)


def states(places: list[SE2], occupancy: NDArray[np.int8], crops: tuple[int, ...] = (0,)) -> list[FrontierState]:
    """Return the state of the gap after each place, a new map at each."""
    survey = fresh_survey()
    out = []
    for k, place in enumerate(places):
        grid = message(occupancy, k, crops[k % len(crops)])
        (gap,) = survey.update(grid, costs_of(grid), place).frontiers
        out.append(gap.state)
    return out


OPEN, OVER = FrontierState.OPEN, FrontierState.UNREACHABLE
NEAR, FAR = SE2(4.3, 3.0), SE2(2.0, 3.0)


def test_three_looks_from_near_are_enough() -> None:
    assert states([NEAR] * 4, room_with_a_vanished_wall()) == [OPEN, OPEN, OVER, OVER]


def test_looks_from_afar_do_not_count() -> None:
    assert states([FAR] * 6, room_with_a_vanished_wall()) == [OPEN] * 6


def test_looks_are_remembered_when_the_map_grows() -> None:
    assert states([NEAR] * 3, room_with_a_vanished_wall(), (7, 3, 0))[-1] is OVER


def test_one_map_counts_once() -> None:
    survey = fresh_survey()
    grid = message(room_with_a_vanished_wall(), 5)
    for _ in range(6):
        (gap,) = survey.update(grid, costs_of(grid), NEAR).frontiers
    assert gap.state is OPEN


def gap_cells(occupancy: NDArray[np.int8]) -> NDArray[np.int64]:
    return np.flatnonzero((occupancy == 0) & (np.roll(occupancy, -1, axis=1) < 0))


def test_what_something_hides_is_not_looked_at() -> None:
    occupancy = room_with_a_vanished_wall()
    occupancy[40:80, 92] = 100
    looks = CloseLooks(CloseLookConfig(), 50)
    for stamp in range(5):
        looks.add(message(occupancy, stamp), NEAR)
    assert len(gap_cells(occupancy)) == 20
    assert not looks.are_over(message(occupancy, 0), gap_cells(occupancy)).any()


def test_a_wall_that_was_looked_at_and_vanishes_later_is_no_frontier() -> None:
    solid = room_with_a_vanished_wall()
    solid[50:70, 100] = 100
    survey = fresh_survey()
    for stamp in range(3):
        grid = message(solid, stamp)
        assert not survey.update(grid, costs_of(grid), NEAR).frontiers
    solid[50:70, 100] = 0
    grid = message(solid, 9)
    assert {f.state for f in survey.update(grid, costs_of(grid), FAR).frontiers} == {OVER}


def test_nothing_is_gained_behind_a_surface_that_the_map_lost() -> None:
    """A wall is looked at, then it vanishes and free cells reach half a metre into it: their far edge is no goal."""
    solid = room_with_a_vanished_wall()
    solid[50:70, 100] = 100
    survey = fresh_survey()
    for stamp in range(4):
        grid = message(solid, stamp)
        survey.update(grid, costs_of(grid), NEAR)
    costs = costs_of(grid)
    solid[50:70, 100:110] = 0
    grid = message(solid, 9)
    looked = survey.update(grid, costs, FAR)
    assert not looked.open
    assert any("of unknown visible" in f.reason for f in looked.frontiers)
    fresh = fresh_survey().update(grid, costs, FAR)
    assert fresh.open


def test_somebody_who_stood_there_and_left_is_no_surface() -> None:
    occupancy = room_with_a_vanished_wall()
    looks, spec = CloseLooks(CloseLookConfig(), 50), message(occupancy, 0).spec
    occupancy[55:60, 92:97] = 100
    for stamp in range(10):
        looks.add(message(occupancy, stamp), NEAR)
    assert looks.surfaces(spec)[55:60, 92].all()
    occupancy[55:60, 92:97] = 0
    for stamp in range(10, 14):
        looks.add(message(occupancy, stamp), NEAR)
    assert not looks.surfaces(spec)[55:60, 92:97].any()


def test_the_edge_of_a_shadow_stays_a_frontier() -> None:
    """The robot stands for long beside a box; what the box hides from it is still worth a drive."""
    occupancy = np.full((200, 200), -1, np.int8)
    iy, ix = np.mgrid[:200, :200]
    occupancy[1:199, 1:199] = 0
    occupancy[90:110, 100] = 100
    y, x = iy + 0.5 - 100.0, ix + 0.5 - 90.0  # from the robot, in cells
    occupancy[(np.abs(y) < x) & (ix > 100)] = -1  # hidden by the box
    looks = CloseLooks(CloseLookConfig(), 50)
    robot = SE2(90 * R, 100 * R)
    for stamp in range(20):
        looks.add(message(occupancy, stamp), robot)
    edge = np.flatnonzero((occupancy == 0) & (np.roll(occupancy, -1, axis=1) < 0) & (ix > 103) & (ix < 125))
    assert len(edge) > 30
    assert not looks.are_over(message(occupancy, 0), edge).any()


def test_a_scanner_looks_only_where_it_points() -> None:
    ahead = SensorMount("laser", SensorKind.SCAN, SE3.from_rpy((0.1, 0.0, 0.3), 0.0, 0.0, 0.5), azimuth=(-1.0, 0.6))
    square = np.array([[0.2, -0.2], [0.2, 0.2], [-0.2, 0.2], [-0.2, -0.2]])
    robot = RobotModel("r", DriveKind.DIFFERENTIAL, square, VelocityLimits(), (ahead,))
    config = CloseLookConfig.from_robot(robot)
    assert np.allclose(config.sector, (0.3, 0.8))
    for yaw, is_seen in ((0.0, True), (math.pi, False)):
        looks, occupancy = CloseLooks(config, 50), room_with_a_vanished_wall()
        cells = gap_cells(occupancy)
        for stamp in range(3):
            looks.add(message(occupancy, stamp), SE2(4.3, 3.0, yaw))
        assert looks.are_over(message(occupancy, 0), cells).any() == is_seen


def wall_with_a_ramp_behind() -> NDArray[np.int8]:
    """A room of 4 x 4 m whose east wall, four cells thick, stands below the top of a ramp that comes from the east."""
    occupancy = np.full((120, 180), -1, np.int8)
    occupancy[20:102, 19:105] = 100
    occupancy[21:101, 20:101] = 0
    return occupancy


def test_a_wall_seen_from_below_says_nothing_of_the_ramp_that_ends_above_it() -> None:
    """The robot looks at a wall; later it comes up a ramp on the other side, and takes the wall's last cells for ground: what lies on is unknown to it, and worth its drive."""
    occupancy = wall_with_a_ramp_behind()
    survey = fresh_survey()
    for stamp in range(6):
        grid = message(occupancy, stamp)
        survey.update(grid, costs_of(grid), NEAR)
    occupancy[:, :101] = -1  # another floor lies there
    occupancy[19:102, 101:161] = 100
    occupancy[20:101, 101:160] = 0
    grid = message(occupancy, 9)
    assert edge_states(survey, grid, SE2(7.5, 3.0)) == {OPEN}
    gains = [s.update(grid, costs_of(grid), SE2(7.5, 3.0)).gains.max() for s in (survey, fresh_survey())]
    assert gains[0] == pytest.approx(gains[1], rel=0.1)
    for stamp in range(10, 14):
        at_the_top = edge_states(survey, message(occupancy, stamp), SE2(5.6, 3.0))
    assert at_the_top == {OVER}


def fresh_survey() -> FrontierSurvey:
    return FrontierSurvey(SurveyConfig(), distance_field)


def edge_states(survey: FrontierSurvey, grid: OccupancyGrid, place: SE2) -> set[FrontierState]:
    found = survey.update(grid, costs_of(grid), place).frontiers
    return {f.state for f in found if abs(f.cells[:, 1] - 3.0).min() < 0.5 and f.centroid[0] < 5.2}


@pytest.mark.parametrize("angle", np.linspace(0.0, 2.0 * math.pi, 9)[:-1])
def test_a_look_counts_within_sixty_degrees_of_where_free_ground_lies(angle: float) -> None:
    """Whoever stands before a straight edge of what is known has looked at it, wherever it faces."""
    iy, ix = np.mgrid[:160, :160]
    ahead = (ix - 79.5) * math.cos(angle) + (iy - 79.5) * math.sin(angle)
    occupancy = np.where(ahead < 0.0, 0, -1).astype(np.int8)
    cells = np.flatnonzero((occupancy == 0) & (ahead > -1.5) & (np.hypot(iy - 80, ix - 80) < 7))
    for turn in (-1.0, 0.0, 1.0):
        looks = CloseLooks(CloseLookConfig(), 50)
        x, y = (80 * R - 1.3 * f(angle + turn) for f in (math.cos, math.sin))
        for stamp in range(3):
            looks.add(message(occupancy, stamp), SE2(x, y))
        assert looks.are_over(message(occupancy, 0), cells).mean() > 0.8
    behind = np.where(ahead < 0.0, -1, 0).astype(np.int8)
    cells = np.flatnonzero((behind == 0) & (ahead < 1.5) & (np.hypot(iy - 80, ix - 80) < 7))
    assert not looks.are_over(message(behind, 9), cells).any()
