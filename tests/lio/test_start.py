"""The start: level, biases, units; and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.se3 import SE3
from ambler.lio.config import STANDARD_GRAVITY, PlanarConfig, RestConfig, StartConfig
from ambler.lio.measurements import height_and_tilt, standstill
from ambler.lio.start import LioInputError, find_start, level_rotation
from ambler.lio.state import FilterState, exp

CONFIG = StartConfig()


def still(seconds: float, tilt: np.ndarray, unit: float = STANDARD_GRAVITY, noise: float = 0.02) -> np.ndarray:
    """Samples at 200 Hz of a sensor at rest whose attitude is `tilt` (a rotation vector)."""
    rng = np.random.default_rng(1)
    count = int(seconds * 200) + 1
    rows = np.zeros((count, 7))
    rows[:, 0] = np.arange(count) / 200.0
    rows[:, 1:4] = np.array([0.01, -0.02, 0.005]) + rng.normal(0.0, 0.002, (count, 3))
    rows[:, 4:] = unit * (exp(tilt).T @ [0.0, 0.0, 1.0]) + unit / 9.8 * rng.normal(0.0, noise, (count, 3))
    return rows


@pytest.mark.parametrize("tilt", [[0.0, 0.0, 0.0], [0.4, -0.2, 0.0], [3.0, 0.2, 0.0], [0.0, -1.5, 0.0]])
@pytest.mark.parametrize("unit", [1.0, STANDARD_GRAVITY])
def test_rest_levels_the_map_and_finds_bias_and_unit(tilt: list[float], unit: float) -> None:
    rows = still(1.2, np.array(tilt), unit)
    start = find_start(rows, CONFIG)
    assert start is not None
    assert start.is_rest
    up = start.state.rotation @ (exp(np.array(tilt)).T @ [0.0, 0.0, 1.0])
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=2e-3)
    np.testing.assert_allclose(start.state.gyro_bias, [0.01, -0.02, 0.005], atol=1e-3)
    assert start.scale * unit == pytest.approx(STANDARD_GRAVITY, rel=2e-3)
    assert start.note.startswith("began at rest; forces in " + ("g" if unit == 1.0 else "m/s²"))


def test_it_waits_for_a_second_of_rest() -> None:
    assert find_start(still(0.5, np.zeros(3)), CONFIG) is None


def test_a_moving_start_waits_and_then_begins_without_a_bias() -> None:
    rows = still(3.5, np.zeros(3))
    rows[:, 1:4] += np.sin(9.0 * rows[:, :1])
    assert find_start(rows[rows[:, 0] < 2.5], CONFIG) is None
    start = find_start(rows, CONFIG)
    assert start is not None
    assert not start.is_rest
    assert not start.state.gyro_bias.any()


def test_of_a_moving_start_only_the_unit_is_told_by_the_length_of_the_force() -> None:
    """In a bend it is longer than gravity; all forces would be told too small ever after."""
    for unit, scale in ((1.0, STANDARD_GRAVITY), (STANDARD_GRAVITY, 1.0)):
        rows = still(3.5, np.zeros(3), 1.04 * unit)
        rows[:, 1:4] += np.sin(9.0 * rows[:, :1])
        start = find_start(rows, CONFIG)
        assert start is not None
        assert start.scale == scale


@pytest.mark.parametrize("unit", [1.0, 9.80665])
def test_who_sets_off_is_not_refused_for_the_length_of_his_force(unit: float) -> None:
    """A car's mean force over its first seconds is 10.6 m/s²."""
    rows = still(3.5, np.zeros(3), unit)
    rows[:, 4] += 0.4 * unit
    rows[::2, 4] += 0.2 * unit
    start = find_start(rows, CONFIG)
    assert start is not None
    assert not start.is_rest
    assert start.scale == (9.80665 if unit == 1.0 else 1.0)


@pytest.mark.parametrize("unit", [3.0, 981.0, 0.1])
def test_forces_of_no_known_unit_are_refused(unit: float) -> None:
    with pytest.raises(LioInputError, match=r"neither 1 \(g\) nor 9.81"):
        find_start(still(3.5, np.zeros(3), unit), CONFIG)


def test_the_heading_is_kept_where_there_is_one() -> None:
    rotation = level_rotation(np.array([0.1, 0.3, 9.7]))
    assert rotation[1, 0] == pytest.approx(0.0, abs=0.01)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    steep = level_rotation(np.array([9.8, 0.1, 0.2]))
    np.testing.assert_allclose(steep @ steep.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(steep) == pytest.approx(1.0)


def driven(seconds: float, sway: float = 0.0, sets_off: float = 1e9) -> np.ndarray:
    """Samples at 100 Hz of who stands with a motor running at 23, 41 and 57 Hz (0.3 m/s² in each), sways at 2 Hz by so many m/s², and sets off with 3 m/s²."""
    rng = np.random.default_rng(2)
    at = np.arange(0.0, seconds, 0.01)
    rows = np.column_stack([at, rng.normal(0.0, 0.002, (len(at), 3)), rng.normal(0.0, 0.02, (len(at), 3))])
    rows[:, 6] += STANDARD_GRAVITY
    for rate in (23.0, 41.0, 57.0):
        rows[:, 4:] += 0.3 * np.sin(2.0 * np.pi * rate * at[:, None] + rng.uniform(0.0, 6.0, 3))
    rows[:, 4] += 3.0 * np.clip((at - sets_off) / 0.5, 0.0, 1.0) + sway * np.sin(4.0 * np.pi * at)
    return rows


def test_who_stands_with_a_running_motor_stands() -> None:
    """A car was levelled by the second in which it set off, and was 77 m off after 470 m."""
    start = find_start(driven(1.05), CONFIG)
    assert start is not None
    assert start.is_rest
    assert start.is_shaken
    np.testing.assert_allclose(start.state.rotation[2], [0.0, 0.0, 1.0], atol=3e-3)
    assert "began at rest; " in start.note
    assert "shaken by 0.6" in start.note


def test_what_sways_or_sets_off_with_a_running_motor_does_not_stand() -> None:
    assert find_start(driven(1.5, sway=0.3), CONFIG) is None
    assert find_start(driven(1.5, sets_off=1.1), CONFIG) is None
    still_quiet = find_start(still(1.2, np.zeros(3)), CONFIG)
    assert still_quiet is not None
    assert not still_quiet.is_shaken


@pytest.mark.parametrize(("acceleration", "is_rest"), [(0.0, True), (0.4, False)])
def test_who_sets_off_with_a_running_motor_is_not_held(acceleration: float, is_rest: bool) -> None:
    """What shakes it varies by more than what a gentle start adds within a scan."""
    rows = driven(3.0)
    start = find_start(rows[:106], CONFIG)
    assert start is not None
    rows[:, 4] += acceleration
    told = [standstill(start.state, rows[k : k + 11], start, RestConfig()) is not None for k in range(110, 290, 10)]
    assert np.mean(told) == pytest.approx(1.0 if is_rest else 0.0, abs=0.1)


@pytest.mark.parametrize(("column", "most", "is_rest"), [(4, 0.0, True), (4, 0.3, False), (3, 0.015, False)])
def test_who_sets_off_smoothly_is_not_held(column: int, most: float, is_rest: bool) -> None:
    """Held for as long as a scan of 0.1 s adds little speed and turn, it would lose what it sets off with, which in the open no scan gives back."""
    rows = still(3.0, np.zeros(3))
    start = find_start(rows[:202], CONFIG)
    assert start is not None
    assert start.is_rest
    assert not start.is_shaken
    rows[:, column] += most
    told = [standstill(start.state, rows[k : k + 21], start, RestConfig()) is not None for k in range(210, 590, 20)]
    assert np.mean(told) == pytest.approx(1.0 if is_rest else 0.0, abs=0.1)


def test_level_ground_draws_height_and_lean_back_and_says_nothing_on_a_slope() -> None:
    """On a hill of 7 m a base that was told to be on level ground was 2.8 m off."""
    config, origin = PlanarConfig(), FilterState()
    near = replace(origin.copy(), position=np.array([5.0, 1.0, 0.08]))
    near.rotation = np.array(SE3.from_rpy((0.0, 0.0, 0.0), 0.01, -0.01, 0.7).matrix()[:3, :3])
    ground = height_and_tilt(near, origin, config)
    assert ground is not None
    assert ground.residual[0] == pytest.approx(-0.08)
    assert ground.variances[0] == pytest.approx(config.height_sigma**2)
    # A turn by what the residual says of up brings up back.
    turn = np.linalg.lstsq(ground.jacobian[1:, 3:6], ground.residual[1:], rcond=None)[0]
    assert float(np.linalg.norm(turn)) == pytest.approx(math.hypot(0.01, 0.01), rel=0.02)
    for height, pitch in ((0.16, 0.0), (0.0, 0.03), (-0.16, 0.0)):
        steep = replace(origin.copy(), position=np.array([5.0, 1.0, height]))
        steep.rotation = np.array(SE3.from_rpy((0.0, 0.0, 0.0), 0.0, pitch, 0.7).matrix()[:3, :3])
        assert height_and_tilt(steep, origin, config) is None
