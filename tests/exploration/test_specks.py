"""Small things that shut a way: which are looked at, from where, and how often."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.grid import COST_INSCRIBED
from ambler.core.se2 import SE2
from ambler.exploration.specks import Specks
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.planning.distance import distance_field
from tests.exploration.test_survey import R, corridor, grids, path_distances

HERE = SE2(1.4, 2.0)  # farther from the door than a look that counts
CONFIG = SurveyConfig(min_size=0.6)  # of a robot with a radius of 0.3 m
RADIUS_CELLS = 3


def with_door(thing: NDArray[np.int8] | None = None, door: slice = slice(14, 27)) -> NDArray[np.int8]:
    """A corridor parted by a wall at x = 4.5 m with a door; a thing (h, w) stands in the middle of the door."""
    occupancy = corridor()
    occupancy[10:30, 45] = 100
    occupancy[door, 45] = 0
    if thing is not None:
        h, w = thing.shape
        occupancy[20 : 20 + h, 45 : 45 + w] = thing
    return occupancy


SPECK = np.full((1, 1), 100, np.int8)


def looks(occupancy: NDArray[np.int8], config: SurveyConfig = CONFIG, robot: SE2 = HERE) -> list[SE2]:
    """Return the looks that are wanted in a map that does not change, five at most."""
    surveyor = FrontierSurvey(config, path_distances)
    survey = surveyor.update(*grids(occupancy, RADIUS_CELLS), robot)
    found: list[SE2] = []
    while len(found) < 5 and (place := surveyor.look_at_speck(survey, robot)) is not None:
        found.append(place)
    return found


def test_a_speck_that_alone_shuts_a_door_is_looked_at_twice_from_two_places() -> None:
    first, second = looks(with_door(SPECK))
    speck = (4.55, 2.05)
    for place in (first, second):
        away = math.dist((place.x, place.y), speck)
        assert CONFIG.specks.nearest <= away <= CONFIG.specks.farthest
        assert place.x < 4.5 - 0.3  # where the robot can be
        assert place.yaw == pytest.approx(math.atan2(speck[1] - place.y, speck[0] - place.x))
    assert math.dist((first.x, first.y), speck) == pytest.approx(CONFIG.specks.distance, abs=R)
    assert first.distance_to(second) > CONFIG.specks.nearest


@pytest.mark.parametrize(("robot", "nearer"), [(SE2(1.4, 1.5), 16), (SE2(1.4, 2.5), 23)])
def test_a_look_is_at_all_that_is_seen_from_there_and_the_nearest_comes_first(robot: SE2, nearer: int) -> None:
    occupancy = with_door()
    occupancy[[16, 23], 45] = 100
    first, _ = looks(occupancy, robot=robot)
    y = (nearer + 0.5) * R
    assert first.yaw == pytest.approx(math.atan2(y - first.y, 4.55 - first.x), abs=1e-3)


@pytest.mark.parametrize(
    "occupancy",
    [
        pytest.param(with_door(), id="nothing shuts it"),
        pytest.param(with_door(np.full((2, 3), 100, np.int8)), id="what stands there is larger"),
        pytest.param(with_door(SPECK, slice(18, 23)), id="too narrow without it"),
        pytest.param(with_door(door=slice(0, 0)), id="a wall"),
    ],
)
def test_nothing_else_is_looked_at(occupancy: NDArray[np.int8]) -> None:
    assert looks(occupancy) == []


@pytest.mark.parametrize("wider", [0, 1])
def test_only_what_lies_near_a_speck_opens(wider: int) -> None:
    """Costs that end a cell farther from walls than the radius leave a rim along all of them; opened, it joined every post of a building to one frontier."""
    occupancy = with_door(SPECK)
    _, costs = grids(occupancy, RADIUS_CELLS + wider)
    opened, specks = Specks(CONFIG.specks, 0.5 * CONFIG.min_size).opened(costs)
    assert specks.sum() == 1
    iy, ix = np.nonzero(opened.data != costs.data)
    away = np.hypot(iy - 20, ix - 45)
    assert away.max() <= RADIUS_CELLS + 2
    assert (opened.data[20, 42:49] < COST_INSCRIBED).all()
    assert len(looks(occupancy)) == 2


def test_a_speck_behind_which_nothing_is_to_be_seen_is_left_alone() -> None:
    occupancy = with_door(SPECK)
    occupancy[10:30, 70] = 100  # the corridor ends, and all of it was seen
    assert looks(occupancy) == []


def test_a_nook_is_not_worth_the_way() -> None:
    occupancy = with_door(SPECK)
    occupancy[10:30, 54:] = -1  # what was seen behind the speck leaves the robot's middle 1.4 m²
    assert looks(occupancy)
    assert looks(occupancy, replace(CONFIG, specks=replace(CONFIG.specks, least_area=1.6))) == []


def test_a_speck_beside_the_way_is_left_alone() -> None:
    occupancy = with_door()
    occupancy[12, 30] = 100
    assert looks(occupancy) == []


def test_it_is_not_looked_at_through_a_wall() -> None:
    occupancy = with_door(SPECK)
    occupancy[10:22, 32] = 100  # a screen before the door, from the right wall to y = 2.2 m
    places = looks(occupancy)
    assert places
    for place in places:
        if place.x < 3.2:
            assert place.y + (3.25 - place.x) * math.tan(place.yaw) > 2.2


A, B = (2.2, 1.4), (2.2, 2.3)


@pytest.mark.parametrize(
    ("passes", "wanted"),
    [
        pytest.param([], 2, id="never passed"),
        pytest.param([(0, A)], 1, id="once"),
        pytest.param([(0, A), (5, B)], 1, id="a moment later again"),
        pytest.param([(0, A), (30, A)], 1, id="from the same place again"),
        pytest.param([(0, A), (30, B)], 0, id="later from elsewhere"),
        pytest.param([(0, A), (5, B), (30, B)], 0, id="both"),
    ],
)
def test_what_still_stood_when_the_robot_came_past_again_was_looked_at(
    passes: list[tuple[int, tuple[float, float]]], wanted: int
) -> None:
    surveyor = FrontierSurvey(CONFIG, path_distances)
    occupancy, costs = grids(with_door(SPECK), RADIUS_CELLS)
    for second, beside in passes:
        surveyor.update(occupancy, replace(costs, stamp_ns=second * 1_000_000_000), SE2(*beside))
    survey = surveyor.update(occupancy, replace(costs, stamp_ns=200_000_000_000), HERE)
    assert sum(surveyor.look_at_speck(survey, HERE) is not None for _ in range(3)) == wanted


def test_forgotten_with_the_map() -> None:
    surveyor = FrontierSurvey(CONFIG, path_distances)
    for _ in range(2):
        survey = surveyor.update(*grids(with_door(SPECK), RADIUS_CELLS), HERE)
        assert sum(surveyor.look_at_speck(survey, HERE) is not None for _ in range(3)) == 2
        surveyor.reset()


@pytest.mark.parametrize("beside", [(-0.3, 2.0), (2.0, -0.3), (12.3, 2.0), (2.0, 4.3)])
def test_a_robot_beside_the_map_looks_at_nothing(beside: tuple[float, float]) -> None:
    """A correction of its pose may lead there until the next map comes."""
    surveyor = FrontierSurvey(CONFIG, distance_field)
    assert surveyor.update(*grids(with_door(SPECK), RADIUS_CELLS), SE2(*beside)).reachable_area == 0.0
