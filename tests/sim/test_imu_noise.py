"""The IMU's noise and bias over many seeds: white noise does not depend on the rate, and a bias forgets itself with its time constant."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from ambler.core.se3 import SE3
from ambler.sim.imu import GRAVITY, ImuSensor
from ambler.sim.sensors import MEMS_IMU, ImuSpec

F64 = NDArray[np.float64]
SILENT = replace(MEMS_IMU.perfect(), bias_time=1.0)


def at_rest(spec: ImuSpec, seed: int, seconds: float) -> F64:
    """Return what an IMU that stands still measures, (N, 6) of turn rates and forces without gravity."""
    sensor, rows = ImuSensor(spec, "imu", seed), []
    for k in range(round(seconds * spec.rate_hz) + 1):
        imu = sensor.update(SE3(), (0.0, 0.0, 0.0), k)
        if imu is not None:
            rows.append([*imu.angular_velocity, *imu.linear_acceleration])
    return np.array(rows) - [0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY]


def assert_sigma(values: F64, sigma: float) -> None:
    """The root mean square lies within the interval that holds 99.9 % of such samples."""
    low, high = stats.chi2.ppf([0.0005, 0.9995], values.size) / values.size
    assert low < float(np.mean(np.square(values))) / sigma**2 < high


@pytest.mark.parametrize("rate_hz", [25.0, 100.0, 400.0])
def test_the_integral_of_white_noise_over_a_second_does_not_depend_on_the_rate(rate_hz: float) -> None:
    """The angle (and the speed) after a second is off by the density times the root of a second, however often it is measured."""
    spec = replace(SILENT, rate_hz=rate_hz, gyro_density=2e-3, accel_density=5e-2)
    angles = np.array([at_rest(spec, seed, 1.0).sum(axis=0) / rate_hz for seed in range(40)])
    assert_sigma(angles[:, :3], 2e-3)
    assert_sigma(angles[:, 3:], 5e-2)


def test_a_bias_is_there_from_the_start_and_wanders_with_its_time_constant() -> None:
    """A Gauss-Markov process: stationary sigma at every instant, correlation exp(-t / T) between two."""
    spec = replace(SILENT, rate_hz=50.0, gyro_bias_sigma=3e-3, accel_bias_sigma=0.2)
    tracks = np.array([at_rest(spec, seed, 3.0) for seed in range(60)])
    for k in (0, 75, 149):
        assert_sigma(tracks[:, k, :3], 3e-3)
        assert_sigma(tracks[:, k, 3:], 0.2)
    for seconds in (0.5, 1.0, 2.5):
        later = tracks[:, round(seconds * 50.0), :] / tracks.std(axis=(0, 1))
        first = tracks[:, 0, :] / tracks.std(axis=(0, 1))
        expected = math.exp(-seconds)
        assert float(np.mean(first * later)) == pytest.approx(expected, abs=4.0 / math.sqrt(first.size))
