"""Propagation, motion compensation and residuals against closed forms, slow twins and numerical derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.kernels import inertial as k
from ambler.lio.state import FilterState, exp
from tests.lio.test_state import drawn_state

ZERO = np.zeros(4)


def propagated(state: FilterState, samples: np.ndarray, covariance: np.ndarray, densities: np.ndarray = ZERO):  # type: ignore[no-untyped-def]
    out, knots = state.copy(), np.empty((len(samples), k.KNOT))
    k.propagate(
        *(samples, out.position, out.rotation, out.velocity, out.gyro_bias, out.accel_bias, out.gravity),
        *(covariance, densities, knots),
    )
    return out, knots


def drawn_samples(seed: int, count: int = 21, dt: float = 0.005) -> np.ndarray:
    rng = np.random.default_rng(seed)
    times = np.arange(count) * dt
    return np.ascontiguousarray(
        np.column_stack(
            [times, rng.normal(0.0, 1.0, (count, 3)), rng.normal(0.0, 3.0, (count, 3)) + np.array([0, 0, 9.8])]
        )
    )


def test_free_fall_and_a_steady_turn_are_followed_exactly() -> None:
    start = FilterState(velocity=np.array([1.0, 2.0, 3.0]))
    samples = np.zeros((101, 7))
    samples[:, 0] = np.linspace(0.0, 1.0, 101)
    samples[:, 3] = 0.7
    end, knots = propagated(start, samples, np.eye(17))
    np.testing.assert_allclose(end.position, [1.0, 2.0, 3.0 - 0.5 * 9.80665], atol=1e-9)
    np.testing.assert_allclose(end.velocity, [1.0, 2.0, 3.0 - 9.80665], atol=1e-9)
    np.testing.assert_allclose(end.rotation, exp(np.array([0.0, 0.0, 0.7])), atol=1e-9)
    np.testing.assert_allclose(knots[50, k.P : k.V], [0.5, 1.0, 1.5 - 0.125 * 9.80665], atol=1e-9)


def test_a_body_that_hangs_still_stays_where_it_is() -> None:
    state = FilterState(rotation=exp(np.array([0.3, -0.2, 1.0])))
    samples = np.zeros((201, 7))
    samples[:, 0] = np.linspace(0.0, 1.0, 201)
    samples[:, 4:] = -state.rotation.T @ state.gravity
    end, _ = propagated(state, samples, np.eye(17))
    np.testing.assert_allclose(end.position, 0.0, atol=1e-9)


def test_the_covariance_is_carried_by_the_numerical_jacobian() -> None:
    state, samples = drawn_state(5), drawn_samples(6)
    h = 1e-5
    end, _ = propagated(state, samples, np.eye(17))
    columns = []
    for e in np.eye(17):
        ahead, _ = propagated(state.plus(h * e), samples, np.eye(17))
        behind, _ = propagated(state.plus(-h * e), samples, np.eye(17))
        columns.append((ahead.minus(end) - behind.minus(end)) / (2 * h))
    jacobian = np.stack(columns, axis=1)
    a = np.random.default_rng(7).normal(0.0, 1.0, (17, 17))
    covariance = a @ a.T
    carried = covariance.copy()
    propagated(state, samples, carried)
    expected = jacobian @ covariance @ jacobian.T
    np.testing.assert_allclose(carried, expected, atol=2e-3 * float(np.abs(expected).max()))
    np.testing.assert_allclose(carried, carried.T, atol=0.0)


def test_white_noise_grows_as_the_densities_say() -> None:
    samples = np.zeros((201, 7))
    samples[:, 0] = np.linspace(0.0, 1.0, 201)
    samples[:, 6] = 9.80665
    covariance = np.zeros((17, 17))
    propagated(FilterState(), samples, covariance, np.array([1e-4, 1e-2, 1e-6, 1e-5]))
    assert covariance[5, 5] == pytest.approx(1e-4 + 1e-6 / 3.0, rel=1e-2)  # yaw: white noise and the bias's walk
    assert covariance[8, 8] == pytest.approx(1e-2 + 1e-5 / 3.0, rel=1e-2)
    assert covariance[2, 2] == pytest.approx(1e-2 / 3.0 + 1e-5 / 20.0, rel=2e-2)


def test_points_are_moved_to_the_end_of_the_scan_from_where_the_body_was() -> None:
    state, samples = drawn_state(8), drawn_samples(9)
    end, knots = propagated(state, samples, np.eye(17))
    rng = np.random.default_rng(10)
    mount = state.imu_from_lidar
    places = rng.uniform(-20.0, 20.0, (200, 3))
    times = np.sort(rng.uniform(samples[0, 0], samples[-1, 0], 200))
    seen = np.empty((200, 3), np.float32)
    for m, t in enumerate(times):
        cut = samples[samples[:, 0] < t]
        i = len(cut) - 1
        # Within a step the rate is the mean of its ends, as the filter has it.
        row = knots[i]
        dt = t - row[k.T]
        rotation = row[k.R :].reshape(3, 3) @ exp(row[k.W : k.R] * dt)
        position = row[k.P : k.V] + row[k.V : k.A] * dt + 0.5 * row[k.A : k.W] * dt**2
        in_body = rotation.T @ (places[m] - position)
        seen[m] = mount[:, :3].T @ (in_body - mount[:, 3])
    out = np.empty((200, 3))
    k.compensate(seen, times, knots, mount, out)
    np.testing.assert_allclose(out @ end.rotation.T + end.position, places, atol=2e-5)


def residual_sums(state: FilterState, points: np.ndarray, planes: np.ndarray, motion: np.ndarray, width: int):  # type: ignore[no-untyped-def]
    information, gradient, moments = np.empty((width, width)), np.empty(width), np.empty(4)
    k.sum_residuals(
        *(points, planes, np.ones(len(points), np.bool_), np.full(len(points), 1e9), state.rotation, state.position),
        *(state.imu_from_lidar, motion, width, 1e6, information, gradient, moments),
    )
    return information, gradient, moments


def drawn_planes(seed: int, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    normals = rng.normal(0.0, 1.0, (count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rng.uniform(-10.0, 10.0, (count, 3)), np.column_stack([normals, rng.uniform(-5.0, 5.0, count)])


def test_gradients_of_residuals_are_the_numerical_ones_with_mount_and_clock() -> None:
    state = drawn_state(11)
    lidar, planes = drawn_planes(12)
    rate = np.array([0.3, -0.5, 0.8])
    motion = np.concatenate([state.velocity, rate])

    def residuals(delta: np.ndarray) -> np.ndarray:
        moved = state.plus(delta)
        body = lidar @ moved.imu_from_lidar[:, :3].T + moved.imu_from_lidar[:, 3]
        late = moved.clock - state.clock
        turned = body @ exp(rate * late).T
        places = turned @ moved.rotation.T + moved.position + moved.velocity * late
        return np.asarray((planes[:, :3] * places).sum(axis=1) + planes[:, 3])

    body = lidar @ state.imu_from_lidar[:, :3].T + state.imu_from_lidar[:, 3]
    information, gradient, moments = residual_sums(state, body, planes, motion, 13)
    part = np.r_[0:6, 17:24]
    h = 1e-6
    rows = np.stack([(residuals(h * e) - residuals(-h * e)) / (2 * h) for e in np.eye(24)[part]], axis=1)
    r = residuals(np.zeros(24))
    np.testing.assert_allclose(gradient, rows.T @ r, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(information, rows.T @ rows, rtol=1e-4, atol=1e-2)
    assert moments[0] == 60.0
    assert moments[2] == pytest.approx(np.abs(r).sum())


def test_far_off_points_do_not_count_and_outliers_count_less() -> None:
    planes = np.array([[0.0, 0.0, 1.0, 0.0]] * 3)
    points = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.1], [1.0, 0.0, 1.0]])
    information, gradient, moments = np.empty((6, 6)), np.empty(6), np.empty(4)
    k.sum_residuals(
        *(points, planes, np.ones(3, np.bool_), np.full(3, 4.0), np.eye(3), np.zeros(3), np.eye(3, 4), np.zeros(6)),
        *(6, 0.1, information, gradient, moments),
    )
    assert moments[0] == 2.0  # 81 r^2 < range leaves out the metre
    assert information[2, 2] == pytest.approx(1.0 + 0.25)
    assert gradient[2] == pytest.approx(0.25 * 0.1)
