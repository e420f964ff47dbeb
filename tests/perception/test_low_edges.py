"""Kerbs that are seen from afar go on where nothing is seen; walls, heaps and what ends in sight do not."""

import math

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.kernels.ground_map import ASSUMED, STOOD, UNKNOWN
from ambler.perception.ground_level import Level
from ambler.perception.low_edges import RIM, beyond_low_edges

R = 0.1


def around_a_start(slope: float = 0.0) -> Level:
    """Ground of 24 x 24 m around a robot in the middle, that within 5 m is only assumed."""
    level = Level.empty(GridSpec(R, 240, 240, -12.0, -12.0))
    x, y = places(level)
    level.evidence[:] = np.where(np.hypot(x, y) < 5.0, ASSUMED, 4)
    level.heights[:] = slope * x
    return level


def places(level: Level) -> tuple[np.ndarray, np.ndarray]:
    iy, ix = np.mgrid[: level.spec.height, : level.spec.width]
    return -12.0 + (ix + 0.5) * R, -12.0 + (iy + 0.5) * R


def put(level: Level, angle: float, beside: float, top: float, reach: tuple[float, float] = (0.0, 11.0)) -> None:
    """Put a straight thing 0.2 m wide, in a direction and beside the robot; where ground is assumed it was not seen."""
    x, y = places(level)
    along, across = x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle)
    there = (np.abs(across - beside) < 0.1) & (along > reach[0]) & (along < reach[1]) & (level.evidence != ASSUMED)
    level.evidence[there], level.reaches[there] = -6, level.heights[there] + top


def doubted(level: Level, angle: float, beside: float, along: float) -> bool:
    x, y = (f(angle) * along + g * beside for f, g in ((math.cos, -math.sin(angle)), (math.sin, math.cos(angle))))
    return bool(beyond_low_edges(level)[level.spec.cell_of(x, y)])


@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0, 4.0, -1.2])
@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_a_kerb_goes_on_beside_the_robot_as_far_as_it_was_seen(angle: float, slope: float) -> None:
    level = around_a_start(slope)
    put(level, angle, 2.0, 0.12)
    for along in (4.0, 2.0, 0.0):
        assert doubted(level, angle, 2.0, along)
        assert not doubted(level, angle, 0.5, along), "the robot's own way stays open"
    assert not doubted(level, angle, 2.0, -3.2), "six metres were seen"
    x, y = places(level)
    found = beyond_low_edges(level)
    assert (np.hypot(x, y)[found] < 5.0 + math.sqrt(2.0) * RIM).all(), (
        "where floor is seen before them, things show themselves"
    )


def test_a_short_piece_goes_on_for_as_short_a_way() -> None:
    level = around_a_start()
    put(level, 0.0, 0.0, 0.12, (5.0, 7.0))
    assert doubted(level, 0.0, 0.0, 4.0)
    assert not doubted(level, 0.0, 0.0, 2.5)


@pytest.mark.parametrize("top", [0.5, 2.0])
def test_what_shows_itself_from_near_does_not_go_on(top: float) -> None:
    level = around_a_start()
    put(level, 0.0, 2.0, top)
    assert not beyond_low_edges(level).any()


def test_a_wall_beside_the_robot_leaves_its_doorway_open() -> None:
    """It stands where no floor is seen, so that nothing tells how high it is over the ground."""
    level = around_a_start()
    x, y = places(level)
    wall = (np.abs(y - 3.0) < 0.1) & (np.abs(x) < 3.5) & (np.abs(x) > 0.5)
    level.evidence[wall], level.reaches[wall] = -6, 2.5
    assert not beyond_low_edges(level).any()


def test_heaps_and_stones_do_not_go_on() -> None:
    level = around_a_start()
    x, y = places(level)
    for a, b, size in ((6.3, 0.0, 1.5), (-5.0, 1.0, 0.3)):
        heap = (np.abs(x - a) < size) & (np.abs(y - b) < 0.6 * size) & (level.evidence != ASSUMED)
        level.evidence[heap], level.reaches[heap] = -6, 0.2
    assert not beyond_low_edges(level).any()


def test_a_kerb_that_ends_in_sight_does_not_go_on() -> None:
    level = around_a_start()
    put(level, 0.0, 2.0, 0.12, (7.5, 11.0))
    assert not beyond_low_edges(level).any()


def test_nothing_assumed_nothing_doubted() -> None:
    level = around_a_start()
    put(level, 0.0, 2.0, 0.12)
    level.evidence[level.evidence == ASSUMED] = UNKNOWN
    assert not beyond_low_edges(level).any()


def test_a_ring_of_returns_on_a_kerb_is_no_ground_beside_what_is_assumed() -> None:
    """It lies 0.3 m before the end of what is seen of the kerb; there is no floor before it. Ground before which floor is seen stays, and where the robot has stood."""
    level = around_a_start()
    put(level, 0.0, 2.0, 0.12)
    x, y = places(level)
    ring = (np.abs(y - 2.0) < 0.2) & (x > 4.2) & (x < 4.6)
    level.evidence[ring], level.firm[ring] = 4, 1
    assert doubted(level, 0.0, 2.0, 4.4)
    level.firm[ring] = STOOD
    assert not doubted(level, 0.0, 2.0, 4.4)
    level.firm[ring] = 0
    level.evidence[(x > 3.4) & (x < 5.0) & (y > 0.0)] = 4
    assert not doubted(level, 0.0, 2.0, 4.4), "floor is seen all about it"
