"""What the planar EKF believes of noise: its growth against an integral, and slip against wheels that are trusted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.se2 import SE2
from ambler.kernels import planar_ekf as kernel
from ambler.localization.planar_ekf import EkfConfig, PlanarEkf
from tests.localization.test_planar_ekf import GYRO, WHEELS, simulate

S = 1_000_000_000


@pytest.mark.parametrize("yaw", [0.0, 0.6, 2.5, -1.2])
def test_noise_along_the_body_lies_along_the_body(yaw: float) -> None:
    """A standing base with white acceleration along its x axis: over dt the position's variance is q dt^3 / 3 along that axis and none
    across it, whatever the heading; the covariance of position and speed is q dt^2 / 2 (the integral of white noise)."""
    q, dt = 2.0, 0.1
    x, p = np.zeros(7), np.zeros((7, 7))
    x[2] = yaw
    density = np.zeros(7)
    density[3] = q
    kernel.predict(x, p, dt, density, np.zeros(2), np.zeros((7, 7)))
    u = np.array([math.cos(yaw), math.sin(yaw)])
    np.testing.assert_allclose(p[:2, :2], q * dt**3 / 3.0 * np.outer(u, u), atol=1e-15)
    np.testing.assert_allclose(p[:2, 3], 0.5 * q * dt**2 * u, atol=1e-15)
    assert p[3, 3] == pytest.approx(q * dt)
    np.testing.assert_allclose(p, p.T, atol=1e-18)
    assert np.linalg.eigvalsh(p)[0] > -1e-15


def test_unmeasured_speeds_become_uncertain_as_fast_as_configured() -> None:
    """The filter is asked 1 s and 3 s after its last measurement: the variances have grown by the power of the noise times the time."""
    config = EkfConfig(speed_noise=0.3, side_noise=0.2, turn_noise=0.5)
    ekf = PlanarEkf(config)
    ekf.add_twist(0, np.array([0.5, 0.0, 0.0]), WHEELS)
    now, later, last = (ekf.estimate(t * S) for t in (0, 1, 3))
    assert now is not None
    assert later is not None
    assert last is not None
    for k, sigma in ((3, 0.3), (4, 0.2), (5, 0.5)):
        assert later.covariance[k, k] - now.covariance[k, k] == pytest.approx(sigma**2, rel=1e-6)
        assert last.covariance[k, k] - now.covariance[k, k] == pytest.approx(3.0 * sigma**2, rel=1e-6)


def errors_after_slip(config: EkfConfig, bias: float = 0.0) -> tuple[float, float]:
    """Wheels spin from 3 s to 4.5 s: they tell 1.2 rad/s and 0.8 m/s too much. Returns the errors of way (m) and heading at the end,
    root mean squares over some seeds."""
    ways, turns = [], []
    for seed in range(4):
        rows = simulate(np.random.default_rng(seed), 6.0)
        ekf = PlanarEkf(config, rows[0][1])
        for stamp, _, _, wheels, rate in rows:
            is_slip = 3 * S < stamp < 4.5 * S
            ekf.add_imu(stamp, rate + bias, GYRO**2)
            ekf.add_twist(stamp, wheels + np.array([0.8, 0.0, 1.2]) * is_slip, WHEELS)
        estimate = ekf.estimate()
        assert estimate is not None
        ways.append(estimate.odom_from_base.distance_to(rows[-1][1]))
        turns.append((rows[-1][1].inverse() @ estimate.odom_from_base).yaw)
    return float(np.sqrt(np.mean(np.square(ways)))), float(np.sqrt(np.mean(np.square(turns))))


def test_wheels_that_slip_move_the_robot_a_third_as_far_as_if_they_were_trusted() -> None:
    """With an open gate, as odometry uses the filter, nothing else holds the slip back."""
    slipping = errors_after_slip(EkfConfig(gate=math.inf))
    trusted = errors_after_slip(EkfConfig(gate=math.inf, slip_factor=1.0, slip_way_factor=1.0))
    assert trusted[0] > 0.6, "believed, the wheels move the robot by about a metre"
    assert trusted[1] > 0.5
    assert slipping[0] < trusted[0] / 3.0
    assert slipping[1] < 0.05


def test_wheels_are_trusted_again_after_the_slip() -> None:
    """A second after a slip the told speed is again as sure as before it."""
    rows = simulate(np.random.default_rng(1), 6.0)
    ekf = PlanarEkf(EkfConfig(), rows[0][1])
    sigmas = {}
    for stamp, _, _, wheels, rate in rows:
        ekf.add_imu(stamp, rate, GYRO**2)
        ekf.add_twist(stamp, wheels + np.array([0.0, 0.0, 1.2]) * (3 * S < stamp < 4 * S), WHEELS)
        estimate = ekf.estimate()
        assert estimate is not None
        sigmas[stamp] = math.sqrt(estimate.covariance[3, 3])
        if stamp > 4.5 * S:
            assert not estimate.is_slipping
    assert sigmas[3_900_000_000] > 3.0 * sigmas[2_900_000_000]
    assert sigmas[5_500_000_000] == pytest.approx(sigmas[2_900_000_000], rel=0.05)


def test_a_known_bias_of_the_gyroscope_is_no_slip() -> None:
    """The gyroscope is off by 0.1 rad/s, which standing still has told: turning wheels do not slip because of it."""
    rng = np.random.default_rng(4)
    ekf = PlanarEkf(EkfConfig(bias_sigma=0.1))
    sure = np.diag([0.02**2, 0.02**2, 0.01**2])
    for k in range(600):
        turn = 0.0 if k < 300 else 0.4
        ekf.add_imu(k * S // 100, turn + 0.1 + 0.005 * rng.standard_normal(), 0.005**2)
        ekf.add_twist(k * S // 100, np.array([0.0, 0.0, turn + 0.01 * rng.standard_normal()]), sure)
        estimate = ekf.estimate()
        assert estimate is not None
        if k > 300 + 40:
            assert not estimate.is_slipping
    assert estimate.gyro_bias == pytest.approx(0.1, abs=0.01)
    assert estimate.odom_from_base.distance_to(SE2()) < 0.02
