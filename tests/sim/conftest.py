"""Small worlds that the tests of the simulator share."""

import math

import pytest

from ambler.core.se2 import SE2
from ambler.sim.solids import Shape, Solid, WorldSpec


@pytest.fixture
def wall_ahead() -> WorldSpec:
    """An empty floor with one thick wall whose face stands at x = 3 m."""
    wall = Solid("wall", Shape.BOX, SE2(3.25, 0.0, 0.0), 0.5, 20.0, 0.0, 2.5)
    return WorldSpec("wall_ahead", (wall,), SE2())


@pytest.fixture
def open_floor() -> WorldSpec:
    """Nothing but a far wall, so that the robot can drive."""
    wall = Solid("far", Shape.BOX, SE2(50.0, 0.0, math.pi / 2), 0.5, 1.0, 0.0, 2.5)
    return WorldSpec("open_floor", (wall,), SE2())
