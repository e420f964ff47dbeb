"""Setting out: slow for a moment in company, at once when alone, and never in the middle of a drive."""

from __future__ import annotations

import math

import pytest

from ambler.control.slow_start import SlowStart, SlowStartConfig
from ambler.core.protocols import BodyVelocity
from ambler.evaluation.collisions import MIN_SPEED
from tests.control.closed_loop import ROBOTS, SPOT

PERIOD_NS = 50_000_000
REST = BodyVelocity()


def fastest(robot, v: BodyVelocity) -> float:
    """The speed of the footprint's fastest corner."""
    return max(math.hypot(v.vx - v.wz * y, v.vy + v.wz * x) for x, y in robot.footprint.tolist())


@pytest.mark.parametrize("name", sorted(ROBOTS))
@pytest.mark.parametrize("wanted", [BodyVelocity(0.5), BodyVelocity(0.0, 0.0, 0.7), BodyVelocity(0.2, 0.0, -0.6)])
def test_no_corner_of_a_robot_that_sets_out_is_to_blame_for_half_a_second(name: str, wanted: BodyVelocity) -> None:
    robot, now = ROBOTS[name], 0
    start, velocity = SlowStart(SlowStartConfig(), robot), REST
    for _ in range(4):
        assert start.limited(now, REST, velocity, is_somebody_near=True) == REST
        now += PERIOD_NS
    for k in range(30):
        velocity = start.limited(now + k * PERIOD_NS, wanted, velocity, is_somebody_near=True)
        if k <= 10:
            assert 0.0 < fastest(robot, velocity) < MIN_SPEED
            assert velocity.vx * wanted.wz == pytest.approx(velocity.wz * wanted.vx)
    assert velocity == wanted


def test_who_was_near_a_moment_ago_is_company_still() -> None:
    config = SlowStartConfig()
    for seconds, is_slow in ((config.wary - 1.0, True), (config.wary + 1.0, False)):
        start = SlowStart(config, SPOT)
        start.limited(0, REST, REST, is_somebody_near=True)
        passed = start.limited(round(seconds * 1e9), BodyVelocity(0.5), REST, is_somebody_near=False)
        assert (passed.vx < MIN_SPEED) is is_slow


def test_alone_and_on_its_way_a_robot_is_not_held_up() -> None:
    alone, moving = SlowStart(SlowStartConfig(), SPOT), SlowStart(SlowStartConfig(), SPOT)
    assert alone.limited(0, BodyVelocity(0.5), REST, is_somebody_near=False) == BodyVelocity(0.5)
    assert moving.limited(0, BodyVelocity(0.5), BodyVelocity(0.4), is_somebody_near=True) == BodyVelocity(0.5)


def test_each_rest_is_followed_by_another_slow_start() -> None:
    start, wanted = SlowStart(SlowStartConfig(), SPOT), BodyVelocity(0.5)
    for now in (0, 5_000_000_000):
        assert start.limited(now, wanted, REST, is_somebody_near=True).vx < MIN_SPEED
        assert start.limited(now + 1_000_000_000, wanted, BodyVelocity(0.03), is_somebody_near=True) == wanted
        assert start.limited(now + 2_000_000_000, REST, REST, is_somebody_near=True) == REST
