"""The floor under the gate's points: slopes that can be driven are none of the obstacles, what stands on them is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.kernels.floor_walk import SECTORS, heights_over, walk_floor

SLOPE, GAP, RINGS = math.tan(math.radians(22.0)), 0.5, 70
BAND = 0.15  # metres above the floor from which on a point is an obstacle


def heights(points: np.ndarray, lean: float = 0.0) -> np.ndarray:
    out, around = np.empty(len(points)), np.zeros((SECTORS, RINGS))
    points = np.ascontiguousarray(points, np.float64)
    walk_floor(points, SLOPE, GAP, 0.38, np.array([lean, 0.0]), around)
    heights_over(points, around, out)
    return out


def floor(profile, x0: float = 0.4, x1: float = 3.0) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Points of a floor ahead whose height is a function of x, with 1 cm of noise."""
    rng = np.random.default_rng(0)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(x0, x1, 0.04), np.arange(-0.3, 0.31, 0.03)))
    return np.column_stack((x, y, np.array([profile(v) for v in x]) + rng.normal(0.0, 0.01, len(x))))


def box(x: float, low: float, high: float) -> np.ndarray:
    y, z = (a.ravel() for a in np.meshgrid(np.arange(-0.2, 0.21, 0.03), np.arange(low, high, 0.03)))
    return np.column_stack((np.full(len(y), x), y, z))


@pytest.mark.parametrize("degrees", [0.0, 9.0, 18.0])
def test_a_slope_that_begins_ahead_is_floor(degrees):
    points = floor(lambda x: max(0.0, x - 0.8) * math.tan(math.radians(degrees)))
    assert np.abs(heights(points)).max() < 0.1


def test_a_slope_under_the_robot_is_floor_too():
    points = floor(lambda x: x * math.tan(math.radians(15.0)))
    assert heights(points).max() < 0.1


def test_a_slope_on_which_the_robot_leans_is_floor_where_it_is_seen_late():
    points = floor(lambda x: x * math.tan(math.radians(9.0)), x0=1.0)
    assert heights(points, lean=math.tan(math.radians(9.0))).max() < 0.1
    assert heights(points).max() > BAND, "without the lean it may be anything"


def test_level_floor_that_is_seen_late_is_floor_and_what_stands_on_it_is_not():
    points = np.concatenate((floor(lambda x: 0.0, x0=1.6), box(2.5, 0.0, 0.5)))
    told = heights(points)
    assert (told[points[:, 2] > 0.2] > BAND).all()
    assert np.abs(told[points[:, 0] < 2.0]).max() < 0.08


def test_a_slope_that_is_too_steep_is_an_obstacle():
    points = floor(lambda x: max(0.0, x - 1.0) * math.tan(math.radians(40.0)), x1=2.0)
    high = points[:, 2] > 0.4
    assert (heights(points)[high] > BAND).mean() > 0.95


@pytest.mark.parametrize("degrees", [0.0, 12.0])
def test_what_stands_on_the_floor_counts_from_there(degrees):
    rise = math.tan(math.radians(degrees))
    ground, thing = floor(lambda x: x * rise, x1=1.5), box(1.5, 1.5 * rise, 1.5 * rise + 0.6)
    told = heights(np.concatenate((ground, thing)))[len(ground) :]
    np.testing.assert_allclose(told, thing[:, 2] - 1.5 * rise, atol=0.1)
    assert (told > BAND).sum() > 100


def test_nothing_creeps_up_a_wall_that_leans_and_is_noisy():
    rng = np.random.default_rng(1)
    wall = box(1.2, 0.0, 1.0)
    wall[:, 0] += 0.1 * wall[:, 2] + rng.normal(0.0, 0.02, len(wall))
    told = heights(np.concatenate((floor(lambda x: 0.0, x1=1.2), wall)))
    assert (told > BAND).sum() > 0.8 * (wall[:, 2] > 0.3).sum()


def test_across_ground_that_is_not_seen_a_slope_does_not_go_on():
    """A bumper 1.4 m ahead, with nothing seen before it: the line of a slope from the robot's feet would take it for floor."""
    told = heights(box(1.4, 0.3, 0.6))
    np.testing.assert_allclose(told, box(1.4, 0.3, 0.6)[:, 2], atol=1e-9)


def test_what_lies_lower_is_floor_and_what_stands_there_is_higher_than_that():
    ground, thing = floor(lambda x: -0.3 * max(0.0, x - 0.6), x1=2.0), box(2.0, -0.42, 0.0)
    told = heights(np.concatenate((ground, thing)))[len(ground) :]
    assert told.max() > 0.3


def test_a_floor_point_below_the_robot_says_no_less_than_none() -> None:
    """What lies within the robot's own reach does not begin a gap there: the slope ahead is still the one on which it leans."""
    slope = math.tan(math.radians(9.0))
    points = floor(lambda x: x * slope, x0=0.85, x1=3.0)
    below = np.array([[0.2, 0.0, 0.2 * slope]])
    assert heights(np.concatenate((below, points)), lean=slope).max() < 0.1
