"""The trail of a robot says from where to watch what shuts its way back."""

import itertools
import math

import numpy as np
import pytest

from ambler.core.grid import COST_INSCRIBED, COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.core.messages import CostGrid
from ambler.core.se2 import SE2
from ambler.missions.trail import LOOK_FROM, Trail

SPEC = GridSpec(0.05, 200, 200, 0.0, 0.0)  # 10 x 10 m


def costs(*shut: float, value: int = COST_LETHAL, wide: int = 1) -> CostGrid:
    """Free space with walls of `wide` cells across the site at each x of `shut`."""
    data = np.zeros(SPEC.shape, np.uint8)
    for x in shut:
        ix = SPEC.cell_of(x, 0.0)[1]
        data[:, ix : ix + wide] = value
    return CostGrid(0, "map", SPEC, data)


def walked(*points: tuple[float, float]) -> Trail:
    trail = Trail()
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        for share in np.linspace(0.0, 1.0, 40):
            trail.add(SE2(x0 + share * (x1 - x0), y0 + share * (y1 - y0)))
    return trail


def test_it_watches_a_door_from_before_it_on_the_side_where_the_robot_is() -> None:
    trail = walked((1.0, 5.0), (8.0, 5.0), (8.0, 9.0))
    place = trail.lookout(costs(4.0), SE2(8.0, 9.0))
    assert place is not None
    assert place.x == pytest.approx(4.0 + LOOK_FROM, abs=0.1)
    assert place.y == pytest.approx(5.0, abs=0.05)
    assert abs(place.yaw) == pytest.approx(math.pi, abs=0.1), "it looks at the door"


def test_it_stands_where_the_robot_can_stand() -> None:
    data = costs(4.0).data | costs(5.0, value=COST_INSCRIBED, wide=10).data  # 5.0 … 5.5 m, where it would stand
    grid = CostGrid(0, "map", SPEC, data)
    place = walked((1.0, 5.0), (8.0, 5.0), (8.0, 9.0)).lookout(grid, SE2(8.0, 9.0))
    assert place is not None
    assert place.x > 5.5


def test_the_nearest_of_two_shut_doors_counts() -> None:
    place = walked((1.0, 5.0), (9.0, 5.0)).lookout(costs(3.0, 6.0), SE2(9.0, 5.0))
    assert place is not None
    assert place.x > 6.0


def test_an_open_way_an_unknown_one_and_the_lookout_itself_ask_for_nothing() -> None:
    trail = walked((1.0, 5.0), (8.0, 5.0))
    assert trail.lookout(costs(), SE2(8.0, 5.0)) is None
    unknown = costs(0.0, value=COST_UNKNOWN, wide=200)
    assert trail.lookout(unknown, SE2(8.0, 5.0)) is None
    assert trail.lookout(costs(4.0), SE2(4.0 + LOOK_FROM, 5.1)) is None
    assert walked((5.0, 5.0), (5.0, 5.1)).lookout(costs(4.0), SE2(5.0, 5.0)) is None
    assert Trail().lookout(costs(), SE2(5.0, 5.0)) is None


def test_places_outside_of_the_map_are_no_obstacles() -> None:
    assert walked((-3.0, 5.0), (8.0, 5.0)).lookout(costs(), SE2(8.0, 5.0)) is None


def test_away_is_where_the_robot_was_last_so_far_from_here_however_much_it_went_to_and_fro() -> None:
    trail = Trail()
    for x in (0.0, 1.0, 2.0, 3.0, 4.0, 3.6, 4.0, 3.6, 4.0, 3.6, 4.0):
        trail.add(SE2(x, 0.0))
    place = trail.away(SE2(4.0, 0.0), 2.0)
    assert place is not None
    assert (place.x, place.y) == (2.0, 0.0)
    assert abs(place.yaw) < 1e-9, "it looks back to where it was"
    assert trail.away(SE2(4.0, 0.0), 5.0) is None
