"""The start: level, biases, units; and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.lio.config import STANDARD_GRAVITY, StartConfig
from ambler.lio.start import LioInputError, find_start, level_rotation
from ambler.lio.state import exp

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
