"""The dynamic window: what is tried and what is commanded can be reached within one control period."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ambler.control.config import RolloutConfig
from ambler.control.dynamic_window import DynamicWindow
from ambler.control.velocity_samples import dynamic_window, velocity_samples, window_samples
from ambler.core.errors import BadInputError
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from tests.control.closed_loop import DIFF, PERIOD, ROBOTS, World, arc, drive, line, step_velocity

CONFIG = RolloutConfig()


def velocities(robot: str) -> st.SearchStrategy[BodyVelocity]:
    lim = ROBOTS[robot].limits
    return st.builds(
        BodyVelocity,
        st.floats(lim.vx_min, lim.vx_max),
        st.floats(-lim.vy_max, lim.vy_max),
        st.floats(-lim.wz_max, lim.wz_max),
    )


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_window_holds_exactly_what_a_base_reaches_in_one_period(robot: str) -> None:
    limits = ROBOTS[robot].limits

    @given(velocities(robot), velocities(robot))
    def check(now: BodyVelocity, wanted: BodyVelocity) -> None:
        after = step_velocity(now, wanted, limits, PERIOD)
        low, high = dynamic_window(now, limits, PERIOD).T
        reached = np.array([after.vx, after.vy, after.wz])
        assert (reached >= low - 1e-9).all()
        assert (reached <= high + 1e-9).all()

    check()


@pytest.mark.parametrize("robot", ROBOTS)
def test_samples_lie_in_the_window_and_are_never_none(robot: str) -> None:
    model = ROBOTS[robot]

    @given(velocities(robot), st.floats(0.05, 0.8))
    def check(now: BodyVelocity, top: float) -> None:
        samples = window_samples(CONFIG, model, now, top)
        low, high = dynamic_window(now, model.limits, CONFIG.control_period).T
        assert len(samples) > 0
        if now.vx >= CONFIG.speed_min:
            assert (samples >= low - 1e-9).all()
        assert (samples <= np.maximum(high, [0.0, -np.inf, -np.inf]) + 1e-9).all()

    check()


def test_an_omnidirectional_base_samples_sideways_a_differential_one_does_not() -> None:
    assert np.ptp(window_samples(CONFIG, ROBOTS["spot"], BodyVelocity(0.3), 0.8)[:, 1]) > 0.05
    assert np.ptp(window_samples(CONFIG, ROBOTS["diff"], BodyVelocity(0.3), 0.8)[:, 1]) == 0.0


def test_the_window_is_what_distinguishes_it_from_the_rollout() -> None:
    window = window_samples(CONFIG, DIFF, BodyVelocity(0.4), 0.8)
    rollout = velocity_samples(CONFIG, DIFF, 0.8)
    assert np.ptp(window[:, 0]) == pytest.approx(0.05 * (1.0 + 1.5))
    assert np.ptp(rollout[:, 0]) > 0.7


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_command_is_reachable_from_the_one_before(robot: str) -> None:
    model = ROBOTS[robot]
    planner = DynamicWindow(CONFIG, model)
    log = drive(planner, model, World(), arc(1.0, 3.0), SE2(0.0, 0.0, 1.2), seconds=30.0)
    assert log.is_reached
    for before, after in itertools.pairwise([BodyVelocity(), *log.commands]):
        low, high = dynamic_window(before, model.limits, CONFIG.control_period).T
        command = np.array([after.vx, after.vy, after.wz])
        assert (command >= low - 1e-6).all()
        assert (command <= high + 1e-6).all()


def test_a_base_that_was_held_starts_from_rest_again() -> None:
    planner = DynamicWindow(CONFIG, DIFF)
    planner.set_path(line((0, 0), (4, 0)))
    costs, spec = World().window(0.0, 0.0, 5.0)
    for _ in range(20):
        command = planner.compute_command(costs, spec, SE2(), BodyVelocity())  # the gate holds the base
    assert command.vx <= (CONFIG.reaction_time + CONFIG.control_period) * DIFF.limits.ax_max + 1e-9


@pytest.mark.parametrize("name", ["horizon", "vx_samples", "vy_samples", "wz_samples", "control_period", "step_length"])
def test_nothing_is_tried_without_samples_or_time(name: str) -> None:
    with pytest.raises(BadInputError, match=f"rollout.{name} must be positive"):
        RolloutConfig(**{name: 0})
