"""The planar EKF: Monte-Carlo consistency, late measurements, slip, gates, Jacobian, and time per step."""

import math
import time

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels import planar_ekf as kernel
from ambler.localization.errors import InvalidPoseError
from ambler.localization.planar_ekf import EkfConfig, PlanarEkf

F64 = NDArray[np.float64]
DT_NS = 10_000_000
WHEELS = np.diag([0.05**2, 0.02**2, 0.05**2])
GYRO = 0.01


def true_twist(t: float) -> F64:
    return np.array([0.6 + 0.2 * math.sin(t), 0.1 * math.sin(0.7 * t), 0.5 * math.sin(0.5 * t)])


def simulate(rng: np.random.Generator, seconds: float) -> list[tuple[int, SE2, F64, F64, float]]:
    """Rows of (stamp, true pose, true twist, measured twist, measured yaw rate) at 100 Hz."""
    bias = 0.005 * rng.standard_normal()
    pose = SE2(1.0, -2.0, 0.5)
    rows = []
    for k in range(int(seconds * 100)):
        if k:
            pose = pose @ SE2.exp(true_twist((k - 0.5) * 0.01) * 0.01)
        twist = true_twist(k * 0.01)
        wheels = twist + np.sqrt(np.diag(WHEELS)) * rng.standard_normal(3)
        rows.append((k * DT_NS, pose, twist, wheels, float(twist[2] + bias + GYRO * rng.standard_normal())))
    return rows


def run(rows: list[tuple[int, SE2, F64, F64, float]], config: EkfConfig) -> PlanarEkf:
    ekf = PlanarEkf(config, rows[0][1])
    for stamp, _, _, wheels, rate in rows:
        ekf.add_imu(stamp, rate, GYRO**2)
        ekf.add_twist(stamp, wheels, WHEELS)
    return ekf


def test_covariance_is_honest_in_monte_carlo() -> None:
    config = EkfConfig(bias_sigma=0.005, speed_noise=0.3, side_noise=0.3, turn_noise=0.4)
    pose_nees, speed_nees = [], []
    for seed in range(20):
        rows = simulate(np.random.default_rng(seed), 6.0)
        estimate = run(rows, config).estimate()
        assert estimate is not None
        truth, twist = rows[-1][1], rows[-1][2]
        error = estimate.odom_from_base.as_array() - truth.as_array()
        error[2] = math.atan2(math.sin(error[2]), math.cos(error[2]))
        pose_nees.append(error @ np.linalg.solve(estimate.covariance[:3, :3], error) / 3)
        v = estimate.velocity
        slip = np.array([v.vx, v.vy, v.wz]) - twist
        speed_nees.append(slip @ np.linalg.solve(estimate.covariance[3:6, 3:6], slip) / 3)
    assert 0.5 < np.mean(pose_nees) < 2.0
    assert 0.3 < np.mean(speed_nees) < 2.0


def test_bias_of_the_gyroscope_is_found() -> None:
    rng = np.random.default_rng(3)
    ekf = PlanarEkf(EkfConfig())
    for k in range(1000):
        ekf.add_imu(k * DT_NS, 0.02 + 0.005 * rng.standard_normal(), 0.005**2)
        ekf.add_twist(k * DT_NS, np.zeros(3), np.diag([1e-4, 1e-4, 1e-4]))
    estimate = ekf.estimate()
    assert estimate is not None
    assert estimate.gyro_bias == pytest.approx(0.02, abs=0.002)
    assert abs(estimate.odom_from_base.yaw) < 0.01


def test_odometry_does_not_jump_when_the_bias_becomes_known() -> None:
    """Far from the start a little bias is worth metres, but a vehicle cannot leap."""
    rng = np.random.default_rng(5)
    ekf = PlanarEkf(EkfConfig(bias_sigma=0.02))
    places = []
    for k in range(6000):
        ekf.add_imu(k * DT_NS, 0.01 + 0.005 * rng.standard_normal(), 0.005**2)
        if k % 10 == 0:
            ekf.add_twist(k * DT_NS, np.array([1.0, 0.0, 0.1 * rng.standard_normal()]), np.diag([1e-3, 1e-3, 0.03]))
        estimate = ekf.estimate()
        assert estimate is not None
        places.append((estimate.odom_from_base.x, estimate.odom_from_base.y))
    assert np.hypot(*np.diff(places[100:], axis=0).T).max() < 0.02, "1 cm per step, and a little"


def test_late_measurements_give_what_timely_ones_would() -> None:
    rows = simulate(np.random.default_rng(1), 3.0)
    timely = run(rows, EkfConfig()).estimate()
    late = PlanarEkf(EkfConfig(), rows[0][1])
    for k, (stamp, _, _, _, rate) in enumerate(rows):
        late.add_imu(stamp, rate, GYRO**2)
        if k >= 15:
            late.add_twist(rows[k - 15][0], rows[k - 15][3], WHEELS)
    for stamp, _, _, wheels, _ in rows[-15:]:
        late.add_twist(stamp, wheels, WHEELS)
    estimate = late.estimate()
    assert timely is not None
    assert estimate is not None
    np.testing.assert_allclose(estimate.odom_from_base.as_array(), timely.odom_from_base.as_array(), atol=1e-12)
    np.testing.assert_allclose(estimate.covariance, timely.covariance, rtol=1e-9, atol=1e-15)
    assert late.counts.too_late == 0
    assert not late.add_twist(0, np.zeros(3), WHEELS)
    assert late.counts.too_late == 1


def test_slipping_wheels_lose_their_weight() -> None:
    """For 1.5 s the wheels spin: they report turning and speed that the robot does not have. The gyroscope sees it."""
    rows = simulate(np.random.default_rng(5), 6.0)
    config = EkfConfig()
    ekf = PlanarEkf(config, rows[0][1])
    seen = 0
    for stamp, _, _, wheels, rate in rows:
        is_slip = 3_000_000_000 < stamp < 4_500_000_000
        reported = wheels + np.array([0.8, 0.0, 1.2]) if is_slip else wheels
        ekf.add_imu(stamp, rate, GYRO**2)
        ekf.add_twist(stamp, reported, WHEELS)
        estimate = ekf.estimate()
        assert estimate is not None
        seen += estimate.is_slipping and is_slip
        if stamp < 2_900_000_000:
            assert not estimate.is_slipping
    assert seen > 120
    assert estimate.odom_from_base.distance_to(rows[-1][1]) < 0.4  # trusting the wheels would be wrong by 1.2 m
    assert abs(estimate.odom_from_base.yaw - rows[-1][1].yaw) < 0.06


def test_an_outlier_is_refused_and_a_lasting_change_is_believed() -> None:
    rows = simulate(np.random.default_rng(2), 2.0)
    ekf = run(rows, EkfConfig())
    stamp = rows[-1][0] + DT_NS
    turn = rows[-1][2][2]
    assert not ekf.add_twist(stamp, np.array([9.0, 0.0, turn]), WHEELS)
    used = [ekf.add_twist(stamp + k * DT_NS, np.array([3.0, 0.0, turn]), WHEELS) for k in range(1, 9)]
    assert not used[0]
    assert used[-1]


def test_prediction_jacobian_is_that_of_the_motion() -> None:
    rng = np.random.default_rng(7)
    x = rng.normal(size=7)
    zero, still, work = np.zeros(7), np.zeros(2), np.zeros((7, 7))
    a = rng.normal(size=(7, 7))
    p0 = a @ a.T
    moved, p = x.copy(), p0.copy()
    kernel.predict(moved, p, 0.05, zero, still, work)
    jacobian = np.empty((7, 7))
    for k in range(7):
        low, high = x.copy(), x.copy()
        low[k] -= 1e-6
        high[k] += 1e-6
        kernel.predict(low, np.eye(7), 0.05, zero, still, work)
        kernel.predict(high, np.eye(7), 0.05, zero, still, work)
        jacobian[:, k] = (high - low) / 2e-6
    np.testing.assert_allclose(p, jacobian @ p0 @ jacobian.T, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("kind", [kernel.TWIST, kernel.YAW_RATE, kernel.POSE])
def test_correction_equals_the_textbook(kind: int) -> None:
    rng = np.random.default_rng(8)
    a, b = rng.normal(size=(7, 7)), rng.normal(size=(3, 3))
    p0, r = a @ a.T, b @ b.T + np.eye(3)
    x0, z = 0.1 * rng.normal(size=7), 0.1 * rng.normal(size=3)
    h = np.zeros((3, 7))
    if kind == kernel.YAW_RATE:
        h = np.array([[0, 0, 0, 0, 0, 1.0, 1.0]])
        z[1:], r = 0.0, np.diag([r[0, 0], 0, 0])
    else:
        first = 3 if kind == kernel.TWIST else 0
        h[:, first : first + 3] = np.eye(3)
    m = len(h)
    s = h @ p0 @ h.T + r[:m, :m]
    gain = p0 @ h.T @ np.linalg.inv(s)
    if kind != kernel.POSE:  # what is told of the bias does not move the pose
        gain[:3] -= np.outer(p0[:3, 6] / p0[6, 6], p0[6] @ h.T @ np.linalg.inv(s))
    x, p = x0.copy(), p0.copy()
    kernel.correct(x, p, kind, z, r, 1e9, np.zeros((4, 7, 7)))
    np.testing.assert_allclose(x, x0 + gain @ (z[:m] - h @ x0), rtol=1e-9)
    kept = np.eye(7) - gain @ h
    np.testing.assert_allclose(p, kept @ p0 @ kept.T + gain @ r[:m, :m] @ gain.T, rtol=1e-7, atol=1e-9)


def test_values_that_are_not_finite_are_refused() -> None:
    ekf = PlanarEkf(EkfConfig())
    with pytest.raises(InvalidPoseError, match="not finite"):
        ekf.add_twist(0, np.array([math.nan, 0.0, 0.0]), WHEELS)
    with pytest.raises(InvalidPoseError):
        ekf.add_twist(0, np.zeros(3), np.full((3, 3), np.inf))
    assert ekf.estimate() is None


def test_a_step_is_fast() -> None:
    """A loose bound for a busy machine; `ambler bench particles` reports the median."""
    rows = simulate(np.random.default_rng(0), 2.0)
    run(rows, EkfConfig())
    begin = time.perf_counter()
    run(rows, EkfConfig())
    assert (time.perf_counter() - begin) / (2 * len(rows)) < 1e-3
