"""Pursuit of a route: a base that does what it is told stays beside it by centimetres, also where it crosses itself."""

import math

import numpy as np
import pytest

from ambler.control.route_pursuit import RoutePursuit
from ambler.core.robot import VelocityLimits
from ambler.core.se2 import SE2

LIMITS = VelocityLimits(vx_max=1.5, wz_max=1.5)
DT = 0.05


def driven(pursuit: RoutePursuit, start: SE2, seconds: float) -> np.ndarray:
    """Places (N, 3) of a base that obeys at once, until the route is done or lost."""
    pose, places = start, []
    for _ in range(round(seconds / DT)):
        v = pursuit.compute_command(pose)
        assert abs(v.wz) <= LIMITS.wz_max + 1e-9
        assert abs(v.vx) <= LIMITS.vx_max
        if pursuit.is_done or pursuit.is_lost:
            break
        pose = pose @ SE2.exp(np.array([v.vx * DT, 0.0, v.wz * DT]))
        places.append((pose.x, pose.y, pose.yaw))
    return np.array(places)


def circle(radius: float, turns: float = 1.0) -> list[tuple[float, float]]:
    angles = np.linspace(0.0, 2.0 * math.pi * turns, round(60 * turns))
    return [(radius * math.cos(a), radius * math.sin(a)) for a in angles]


@pytest.mark.parametrize("speed", [0.5, 1.2])
def test_a_circle_is_followed_at_its_speed(speed: float) -> None:
    pursuit = RoutePursuit(circle(8.0), speed, LIMITS)
    places = driven(pursuit, SE2(8.0, 0.0, 0.5 * math.pi), 200.0)
    assert pursuit.is_done
    assert np.abs(np.hypot(places[:, 0], places[:, 1]) - 8.0).max() < 0.1
    assert len(places) * DT == pytest.approx(2.0 * math.pi * 8.0 / speed, rel=0.08)


def test_two_laps_and_a_figure_of_eight_are_driven_to_their_end() -> None:
    """Progress only grows: neither the first lap's end nor the crossing is taken for the end."""
    laps = RoutePursuit(circle(5.0, 2.0), 1.0, LIMITS)
    places = driven(laps, SE2(5.0, 0.0, 0.5 * math.pi), 200.0)
    assert np.hypot(*np.diff(places[:, :2], axis=0).T).sum() == pytest.approx(4.0 * math.pi * 5.0, rel=0.03)
    there_and_back = RoutePursuit([(0.0, 0.0), (10.0, 0.0), (0.0, 0.0)], 1.0, LIMITS)
    places = driven(there_and_back, SE2(), 200.0)
    assert there_and_back.is_done
    assert places[:, 0].max() > 9.0
    assert abs(places[-1, 0]) < 0.3
    assert math.cos(places[-1, 2]) < -0.9


def test_it_slows_down_before_the_end_and_turns_in_place_where_it_looks_away() -> None:
    pursuit = RoutePursuit([(0.0, 0.0), (5.0, 0.0)], 1.2, LIMITS)
    assert pursuit.compute_command(SE2(0.0, 0.0, math.pi)).vx == 0.0
    assert abs(pursuit.compute_command(SE2(0.0, 0.0, math.pi)).wz) > 1.0
    speeds = [
        RoutePursuit([(0.0, 0.0), (left, 0.0)], 1.2, LIMITS).compute_command(SE2()).vx for left in (5.0, 0.5, 0.2)
    ]
    assert speeds == pytest.approx([1.2, math.sqrt(0.8 * 0.5), math.sqrt(0.8 * 0.2)], abs=0.02)


def test_the_speed_asked_for_never_exceeds_the_robots() -> None:
    assert RoutePursuit([(0.0, 0.0), (50.0, 0.0)], 4.0, LIMITS).compute_command(SE2()).vx == pytest.approx(1.5)


def test_who_was_carried_away_is_lost_and_stands() -> None:
    pursuit = RoutePursuit([(0.0, 0.0), (50.0, 0.0)], 1.0, LIMITS)
    pursuit.compute_command(SE2())
    assert not pursuit.is_lost
    command = pursuit.compute_command(SE2(0.5, 3.0, 0.0))
    assert pursuit.is_lost
    assert (command.vx, command.wz) == (0.0, 0.0)
