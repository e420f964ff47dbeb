"""Whole explorations in an ideal world: every strategy sees everything, comes home and proves that it is done."""

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.exploration.grid_world import GridWorld
from ambler.exploration.strategies import STRATEGIES, strategy_named
from ambler.planning.distance import distance_field
from ambler.studies.bench_exploration import explore


def flat() -> tuple[GridSpec, NDArray[np.int8]]:
    """Four rooms around a corridor, 16 x 10 m at 10 cm."""
    grid = np.full((100, 160), 100, np.int8)
    grid[44:58, 5:155] = 0
    for x0, x1 in ((5, 70), (80, 155)):
        grid[5:42, x0:x1] = 0
        grid[60:95, x0:x1] = 0
        door = (x0 + x1) // 2
        grid[42:44, door : door + 10] = 0
        grid[58:60, door - 20 : door - 10] = 0
    grid[75:80, 100:120] = 100
    return GridSpec(0.1, 160, 100, -2.0, -3.0), grid


def world() -> GridWorld:
    spec, truth = flat()
    return GridWorld(spec, truth, SE2(*spec.center_of(50, 20)), distance_field, sensor_range=4.0, rays=360)


@pytest.mark.parametrize("name", STRATEGIES)
def test_every_strategy_explores_everything_and_comes_home(name: str) -> None:
    flat_world = world()
    home = flat_world.pose
    result = explore(flat_world, strategy_named(name, distance_field))
    assert result.code == "SUCCEEDED"
    assert result.coverage > 0.99
    assert flat_world.pose.distance_to(home) < 0.2
    assert result.total < 200.0


def test_explorations_repeat_exactly() -> None:
    first, second = (explore(world(), strategy_named("tour", distance_field)) for _ in range(2))
    assert first == second


def test_the_scanner_sees_no_farther_than_walls_and_its_range() -> None:
    flat_world = world()
    seen = np.argwhere(flat_world.built == 0)
    centers = flat_world.spec.centers_of(seen)
    assert np.hypot(centers[:, 0] - flat_world.pose.x, centers[:, 1] - flat_world.pose.y).max() < 4.1
    assert (flat_world.truth[flat_world.built == 0] == 0).all()
    assert (flat_world.truth[flat_world.built == 100] == 100).all()
