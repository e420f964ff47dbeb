"""The last metre: from anywhere before the dock to the millimetre, gently, on the dock's line, also with lame drives."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.control.planar_position import Law, PlanarConfig, PlanarPhase, PlanarPositionController, PlanarStep
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import VelocityLimits
from ambler.core.se2 import SE2
from tests.control.closed_loop import step_velocity

LIMITS = VelocityLimits(1.0, -0.4, 0.5, 1.0, 0.8, 0.8, 1.5, 1.2, 1.2)
STARTS = [
    SE2(-1.0, 0.0, 0.0), SE2(-1.0, 0.1, 0.1), SE2(-0.9, -0.15, -0.4), SE2(-0.5, 0.05, 0.05), SE2(-1.2, 0.3, 0.8),
    SE2(0.01, 0.005, 0.01), SE2(0.1, 0.02, -0.02),
]  # fmt: skip


def approach(
    config: PlanarConfig, start: SE2, seconds: float = 15.0, dead: float = 0.0, period: float = 0.02, noise: float = 0.0
) -> tuple[list[SE2], list[PlanarStep]]:
    """Drive a base with limited accelerations and one period of delay; it does not move for commands below `dead` m/s."""
    controller, pose, v = PlanarPositionController(config), start, BodyVelocity()
    rng, waiting = np.random.default_rng(1), BodyVelocity()
    poses, steps = [pose], []
    for _ in range(round(seconds / period)):
        seen = pose @ SE2(*(rng.normal(0.0, 1.0, 3) * noise).tolist())
        step = controller.compute_command(seen.inverse(), v, period)
        obeyed = waiting if math.hypot(waiting.vx, waiting.vy) + 0.3 * abs(waiting.wz) > dead else BodyVelocity()
        waiting = step.velocity
        for _ in range(2):
            v = step_velocity(v, obeyed, LIMITS, 0.5 * period)
            pose = pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * 0.5 * period)
        poses.append(pose)
        steps.append(step)
        if step.is_reached and math.hypot(v.vx, v.vy) < 1e-4:
            break
    return poses, steps


@pytest.mark.parametrize("law", Law)
@pytest.mark.parametrize("start", STARTS, ids=str)
def test_it_arrives_to_the_millimetre_within_its_limits(law: Law, start: SE2) -> None:
    config = PlanarConfig(law=law)
    poses, steps = approach(config, start)
    end = poses[-1]
    assert steps[-1].is_reached
    assert math.hypot(end.x, end.y) < 0.003
    assert abs(end.yaw) < math.radians(0.1)
    assert len(steps) * 0.02 < (10.0 if abs(start.yaw) > 0.5 else 8.0)
    for a, b in itertools.pairwise(steps):
        assert math.hypot(b.velocity.vx, b.velocity.vy) < math.hypot(*config.speed[:2]) + 1e-9
        assert abs(b.velocity.wz) <= config.speed[2] + 1e-9
        assert abs(b.velocity.wz - a.velocity.wz) <= max(config.braking[2], config.acceleration[2]) * 0.02 + 1e-9
    if start.x < -0.05:
        assert max(p.x for p in poses) < 0.002, "it never goes deeper than the dock"


@pytest.mark.parametrize("start", STARTS[1:5], ids=str)
def test_heading_first_then_the_line_then_in(start: SE2) -> None:
    config = PlanarConfig()
    poses, steps = approach(config, start)
    if abs(start.yaw) > config.rotate_start:
        assert steps[0].phase is PlanarPhase.ROTATING
        first = [s for s in steps if s.phase is PlanarPhase.ROTATING]
        assert all(math.hypot(s.velocity.vx, s.velocity.vy) < 1e-9 for s in first)
    for p in poses:
        if p.x > -0.3:
            assert abs(p.y) < 0.012 + 2.0 * 0.12 * abs(p.x), "near the dock it is on its line"
        if p.x > -0.05:
            assert abs(p.y) < 0.02


def test_where_it_cannot_turn_all_axes_move_at_once() -> None:
    step = PlanarPositionController(PlanarConfig()).compute_command(
        SE2(-1.0, 0.1, 0.5).inverse(), BodyVelocity(), 0.02, lambda angle: False
    )
    assert step.phase is PlanarPhase.MOVING
    asked: list[float] = []

    def may_turn(angle: float) -> bool:
        asked.append(angle)
        return True

    step = PlanarPositionController(PlanarConfig()).compute_command(
        SE2(-1.0, 0.1, 0.5).inverse(), BodyVelocity(), 0.02, may_turn
    )
    assert step.phase is PlanarPhase.ROTATING
    assert asked == [pytest.approx(-0.5)]
    assert step.velocity.wz < 0.0


def test_drives_with_a_dead_band_still_arrive() -> None:
    """Nothing moves below 8 mm/s: the creep gets through it, a plain P ends centimetres before."""
    poses, steps = approach(PlanarConfig(law=Law.PID), STARTS[1], dead=0.0075)
    assert steps[-1].is_reached
    assert math.hypot(poses[-1].x, poses[-1].y) < 0.004
    lame = replace(PlanarConfig(law=Law.P), creep=(0.0, 0.0, 0.0), p=(0.4, 0.4, 0.4))
    poses, steps = approach(lame, STARTS[1], dead=0.0075)
    assert not steps[-1].is_reached


def test_a_noisy_target_does_not_shake_the_robot() -> None:
    poses, steps = approach(PlanarConfig(), STARTS[1], seconds=10.0, noise=0.0005)
    assert math.hypot(poses[-1].x, poses[-1].y) < 0.004
    late = [s.velocity for s in steps if math.hypot(s.error[0], s.error[1]) < 0.004]
    assert len(late) > 5
    assert max(math.hypot(v.vx, v.vy) for v in late) < 0.05


def test_it_overshoots_nothing_and_refuses_nonsense() -> None:
    for law in Law:
        poses, _ = approach(PlanarConfig(law=law), SE2(-1.0, 0.2, 0.0))
        assert min(p.y for p in poses) > -0.003
    controller = PlanarPositionController(PlanarConfig())
    with pytest.raises(ValueError, match="numbers"):
        controller.compute_command(SE2(math.nan, 0.0, 0.0), BodyVelocity(), 0.02)
    with pytest.raises(ValueError, match="positive"):
        controller.compute_command(SE2(), BodyVelocity(), 0.0)
