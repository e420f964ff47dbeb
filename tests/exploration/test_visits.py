"""Places that were looked at are known again, whatever shape their frontiers have."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.messages import Frontier, FrontierState, OccupancyGrid
from ambler.exploration.memory import FrontierMemory, MemoryConfig
from ambler.exploration.overlooked import is_hidden
from ambler.exploration.visits import Visits, VisitsConfig

SPEC = GridSpec(0.1, 100, 100, 0.0, 0.0)
ASSUMED = 25


def along(x0: float, y0: float, x1: float, y1: float, goal: tuple[float, float, float] | None = None) -> Frontier:
    """A frontier along a straight line."""
    n = math.ceil(math.hypot(x1 - x0, y1 - y0) / SPEC.resolution) + 1
    cells = np.stack([np.linspace(x0, x1, n), np.linspace(y0, y1, n)], axis=1).astype(np.float32)
    return Frontier(cells, (0.5 * (x0 + x1), 0.5 * (y0 + y1)), goal, math.inf, FrontierState.OPEN)


def at(seconds: float, data: np.ndarray | None = None, spec: GridSpec = SPEC) -> OccupancyGrid:
    """A map of that time."""
    return OccupancyGrid(
        round(seconds * 1e9), "map", spec, np.zeros(spec.shape, np.int8) if data is None else data.astype(np.int8)
    )


def test_another_shape_at_the_same_place_is_known_again_and_another_place_is_not() -> None:
    visits = Visits(VisitsConfig())
    visits.add(along(4.0, 5.0, 6.0, 5.0), at(0.0))
    assert visits.at(along(4.5, 4.7, 5.5, 5.4), SPEC) == 1
    assert visits.at(along(4.0, 5.7, 6.0, 5.7), SPEC) == 0
    assert visits.at(along(5.6, 5.0, 8.0, 5.0), SPEC) == 0, "most of it lies elsewhere"


def test_a_look_from_the_other_side_is_another_one() -> None:
    """The wall below the top of a ramp was looked at three times; what lies on the ramp, above it, was not."""
    visits = Visits(VisitsConfig())
    line = (5.0, 3.0, 5.0, 6.0)
    for k in range(3):
        visits.add(along(*line, goal=(8.0, 4.5, 0.0)), at(20.0 * k))
    assert visits.at(along(*line, goal=(7.5, 5.5, 0.0)), SPEC) == 3
    assert visits.at(along(*line, goal=(7.0, 2.5, 0.0)), SPEC) == 3
    assert visits.at(along(*line, goal=(2.0, 4.5, 0.0)), SPEC) == 0
    back = Visits(VisitsConfig())
    back.add(along(*line, goal=(2.0, 4.5, 0.0)), at(0.0))
    assert back.at(along(*line), SPEC) == 1, "without a goal the side that was looked at from most"
    visits.add(along(*line), at(90.0))
    assert visits.at(along(*line, goal=(2.0, 4.5, 0.0)), SPEC) == 1, "without a goal from everywhere"


def test_what_is_looked_at_without_a_break_is_looked_at_once() -> None:
    visits = Visits(VisitsConfig(apart=10.0))
    for second in range(10):
        visits.add(along(4.0, 5.0, 6.0, 5.0), at(100.0 + second))
    assert visits.at(along(4.0, 5.0, 6.0, 5.0), SPEC) == 1
    visits.add(along(4.0, 5.0, 6.0, 5.0), at(110.5))
    assert visits.at(along(4.0, 5.0, 6.0, 5.0), SPEC) == 2


def test_a_frontier_that_recedes_before_the_robot_is_a_new_place() -> None:
    visits = Visits(VisitsConfig())
    for k in range(60):
        visits.add(along(1.0 + 0.1 * k, 2.0, 1.0 + 0.1 * k, 4.0), at(2.0 * k))
        assert visits.at(along(1.1 + 0.1 * k, 2.0, 1.1 + 0.1 * k, 4.0), SPEC) <= 2


def test_looks_move_with_a_map_that_grows() -> None:
    visits = Visits(VisitsConfig())
    visits.add(along(4.0, 5.0, 6.0, 5.0), at(0.0))
    larger = GridSpec(0.1, 150, 130, -3.0, -2.0)
    visits.add(along(4.0, 5.0, 6.0, 5.0), at(20.0, spec=larger))
    assert visits.at(along(4.0, 5.0, 6.0, 5.0), larger) == 2
    assert visits.at(along(-1.0, 5.0, 1.0, 5.0), larger) == 0
    assert visits.at(along(30.0, 5.0, 32.0, 5.0), larger) == 0, "outside of the map nobody has looked"


@pytest.mark.parametrize("assumed", [None, ASSUMED])
def test_only_where_ground_is_assumed_a_place_is_given_up_whatever_its_shape(assumed: int | None) -> None:
    memory = FrontierMemory(MemoryConfig(), 50, assumed)
    shapes = [along(4.0, 5.0, 6.0, 5.0), along(5.0, 4.0, 5.0, 6.0), along(4.3, 4.6, 5.7, 5.4)]
    for k, shape in enumerate(shapes):
        assert "closes and opens again" not in memory.reason_against(shape, at(20.0 * k))
        memory.refuse(shape, "-", at(20.0 * k), has_looked=True)
    cross = along(4.7, 5.4, 5.3, 4.6)
    assert ("closes and opens again" in memory.reason_against(cross, at(60.0))) == (assumed is not None)
    memory.pardon()
    assert ("closes and opens again" in memory.reason_against(cross, at(60.0))) == (assumed is not None)


def test_drives_that_fail_are_no_looks() -> None:
    memory = FrontierMemory(MemoryConfig(), 50, ASSUMED)
    for k, x in enumerate((4.0, 4.3, 4.6, 4.9)):
        memory.refuse(along(x, 5.0 + 0.3 * (k % 2), x + 0.6, 5.0), "-", at(20.0 * k), has_looked=False)
    assert "closes and opens again" not in memory.reason_against(along(4.7, 5.4, 5.3, 4.6), at(90.0))


def test_ground_that_is_assumed_and_unknown_in_turns_is_no_change() -> None:
    memory = FrontierMemory(MemoryConfig(max_looks=1), 50, ASSUMED)
    place, data = along(4.0, 5.0, 6.0, 5.0), np.zeros(SPEC.shape)
    data[50:] = -1
    memory.refuse(place, "nothing changed", at(0.0, data), has_looked=True)
    data[50:60] = ASSUMED
    assert memory.reason_against(place, at(1.0, data)) != ""
    data[50:60] = 0
    assert memory.reason_against(place, at(2.0, data)) == "", "now it was seen"


def test_a_frontier_is_hidden_by_ground_that_is_assumed_beside_most_of_it() -> None:
    place, data = along(4.0, 5.0, 6.0, 5.0), np.zeros(SPEC.shape)
    assert not is_hidden(place, at(0.0, data), ASSUMED)
    data[51:60, 55:] = ASSUMED
    assert not is_hidden(place, at(0.0, data), ASSUMED), "a quarter of it"
    data[51:60, 42:] = ASSUMED
    assert is_hidden(place, at(0.0, data), ASSUMED)
    assert not is_hidden(along(40.0, 5.0, 42.0, 5.0), at(0.0, data), ASSUMED), "outside of the map"
    edge = along(9.8, 5.0, 9.99, 5.0)
    assert is_hidden(edge, at(0.0, data), ASSUMED)


@pytest.mark.parametrize("day", [0.0, 1.8e9])
def test_a_look_counts_once_in_its_time_whatever_the_clock_says(day: float) -> None:
    visits = Visits(VisitsConfig())
    for seconds in (0.0, 4.0, 15.0, 30.0):
        visits.add(along(4.0, 5.0, 6.0, 5.0), at(day + seconds))
    assert visits.at(along(4.0, 5.0, 6.0, 5.0), SPEC) == 3
