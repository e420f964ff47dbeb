"""What else the filter may be told, as linear measurements of few rows: standstill, the speed of the wheels, level ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Odometry
from ambler.core.se3 import SE3
from ambler.kernels import inertial as k
from ambler.lio.config import PlanarConfig, RestConfig, WheelConfig
from ambler.lio.start import Start, smoothed
from ambler.lio.state import FilterState

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """`residual` float64 (M,) = measured - predicted, its `jacobian` (M, 17) to the error state, and independent `variances` (M,)."""

    residual: F64
    jacobian: F64
    variances: F64


def standstill(state: FilterState, samples: F64, start: Start, config: RestConfig) -> Measurement | None:
    """Return zero velocity, and the mean rate as the gyroscope's bias, when the samples (K, 7) are as quiet as those of the start and do not lead away: what sets off smoothly is as quiet."""
    if not start.is_rest or len(samples) < 5 or float(np.linalg.norm(state.velocity)) > config.speed_most:
        return None
    rate = samples[:, 1:4].mean(axis=0)
    quiet = config.factor * np.maximum(start.gyro_sigma, 1e-4), config.factor * np.maximum(start.accel_sigma, 1e-3)
    if (samples[:, 1:4].std(axis=0) > quiet[0]).any() or (samples[:, 4:7].std(axis=0) > quiet[1]).any():
        return None
    rate_most, accel_most = config.rate_most, config.accel_most
    if not start.is_shaken:
        noise = 3.0 / np.sqrt(len(samples))
        rate_most = config.rate_quiet + noise * float(np.linalg.norm(start.gyro_sigma))
        accel_most = config.accel_quiet + noise * float(np.linalg.norm(start.accel_sigma))
    if float(np.linalg.norm(rate - state.gyro_bias)) > rate_most or _acceleration(state, samples) > accel_most:
        return None
    jacobian = np.zeros((6, k.EXTRA))
    jacobian[0:3, k.VELOCITY : k.GYRO_BIAS] = jacobian[3:6, k.GYRO_BIAS : k.ACCEL_BIAS] = np.eye(3)
    variances = np.repeat([config.velocity_sigma**2, config.rate_sigma**2], 3)
    return Measurement(np.concatenate([-state.velocity, rate - state.gyro_bias]), jacobian, variances)


def _acceleration(state: FilterState, samples: F64) -> float:
    """Return how much (m/s²) the samples (K, 7) say on average that it accelerates, without what shakes it."""
    force = smoothed(samples, samples[-1, 0] - samples[0, 0])[:, 4:7].mean(axis=0)
    return float(np.linalg.norm(state.rotation @ (force - state.accel_bias) + state.gravity))


def wheel_velocity(
    state: FilterState, rate: F64, odometry: Odometry, imu_from_base: SE3, config: WheelConfig
) -> Measurement:
    """Return the velocity of the base (m/s, in its own frame) as wheels measure it; `rate` (3,) is the unbiased angular rate of the IMU.

    Upwards a base on wheels moves as the ground does, which is 0 in its own frame.
    """
    mount = imu_from_base.matrix()
    base_from_imu = mount[:3, :3].T
    body_velocity = state.rotation.T @ state.velocity
    predicted = base_from_imu @ (body_velocity + np.cross(rate, mount[:3, 3]))
    measured = np.array([odometry.linear[0], odometry.linear[1], 0.0])
    jacobian = np.zeros((3, k.EXTRA))
    jacobian[:, k.VELOCITY : k.GYRO_BIAS] = base_from_imu @ state.rotation.T
    jacobian[:, k.ROTATION : k.VELOCITY] = base_from_imu @ skew(body_velocity)
    jacobian[:, k.GYRO_BIAS : k.ACCEL_BIAS] = base_from_imu @ skew(mount[:3, 3])
    along = config.sigma**2 + (config.share * float(np.linalg.norm(measured))) ** 2
    return Measurement(
        measured - predicted, jacobian, np.array([along, config.sideways_sigma**2, config.sideways_sigma**2])
    )


def height_and_tilt(state: FilterState, origin: FilterState, config: PlanarConfig) -> Measurement | None:
    """Return the height and the direction of up that a base on level ground keeps; None where the ground is not level."""
    up_body = state.rotation.T @ np.array([0.0, 0.0, 1.0])
    up_start = origin.rotation.T @ np.array([0.0, 0.0, 1.0])
    jacobian = np.zeros((4, k.EXTRA))
    jacobian[0, k.POSITION + 2] = 1.0
    jacobian[1:, k.ROTATION : k.VELOCITY] = skew(up_body)
    residual = np.concatenate([[origin.position[2] - state.position[2]], up_start - up_body])
    sigmas = np.array([config.height_sigma, *[config.tilt_sigma] * 3])
    if (np.abs(residual) > config.gate * sigmas).any():
        return None
    return Measurement(residual, jacobian, sigmas**2)


def skew(v: F64) -> F64:
    """Return the matrix (3, 3) of the cross product with a vector."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
