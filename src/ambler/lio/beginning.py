"""What a way is told from: the place where the IMU stood at the start, which is known better with every turn.

The first scan is laid into the map with the mount as it was told, so the map holds where the LiDAR began, and an error of the mount is one of the IMU's first pose in it.
When the filter learns the mount, the IMU's poses in the map turn by what was learned and the first one, told long ago, does not: the way would be turned about its start,
by 1.7 m per kilometre and tenth of a degree. So poses are told since the start: a relative motion of the IMU is mount * that of the LiDAR * mount^-1 (the hand-eye equation), with the
mount as it is known now.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3
from ambler.kernels import inertial as k
from ambler.lio.config import STANDARD_GRAVITY, LioConfig
from ambler.lio.measurements import skew
from ambler.lio.start import level_rotation
from ambler.lio.state import FilterState, gravity_basis

F64 = NDArray[np.float64]
DEFINED = 1e-4  # m and rad; the map is defined by where the sensors begin in it


def begun_covariance(state: FilterState, config: LioConfig, is_rest: bool, speed_sigma: float) -> F64:
    """Return the covariance (17 + extras, 17 + extras) of a filter that begins with `state`, whose first scan will lie where that says; `speed_sigma` (m/s) is how well one in motion knows his velocity."""
    imu, n = config.imu, k.EXTRA + config.extras
    sigmas = np.zeros(n)
    sigmas[: k.VELOCITY] = DEFINED
    sigmas[k.VELOCITY : k.GYRO_BIAS] = 1e-2 if is_rest else speed_sigma
    sigmas[k.GYRO_BIAS : k.ACCEL_BIAS] = 1e-3 if is_rest else imu.gyro_bias_sigma
    sigmas[k.ACCEL_BIAS : k.GRAVITY] = imu.accel_bias_sigma
    sigmas[k.GRAVITY : k.EXTRA] = imu.accel_bias_sigma / STANDARD_GRAVITY if is_rest else 0.05
    if n > k.EXTRA + 6:
        sigmas[k.EXTRA + 6] = config.clock_sigma
    covariance = np.diag(sigmas**2)
    if n > k.EXTRA:
        place, turn = config.mount_sigma if config.estimates_mount else (1e-6, 1e-6)
        causes = _of_mount(state, n) * np.repeat([place, turn], 3)
        covariance += causes @ causes.T
    return covariance


def levelled(state: FilterState) -> FilterState:
    """Return the same motion in a level map that begins where the IMU is."""
    turn = level_rotation(-state.rotation.T @ state.gravity)
    return replace(
        state.copy(),
        position=np.zeros(3),
        rotation=turn,
        velocity=turn @ state.rotation.T @ state.velocity,
        gravity=FilterState().gravity,
    )


def _of_mount(state: FilterState, n: int) -> F64:
    """Return what an error of the mount's place and rotation makes of all errors (n, 6) while the LiDAR's pose in the map is given."""
    r, mount = state.rotation, state.imu_from_lidar
    turned = -mount[:, :3]  # of the IMU in its own axes
    out = np.zeros((n, 6))
    out[k.EXTRA : k.EXTRA + 6] = np.eye(6)
    out[k.ROTATION : k.VELOCITY, 3:] = turned
    out[: k.ROTATION, :3] = -r
    out[: k.ROTATION, 3:] = r @ skew(mount[:, 3]) @ turned
    out[k.GRAVITY : k.EXTRA, 3:] = gravity_basis(state.gravity).T @ r @ turned  # gravity is known in the IMU
    return out


def start_from_map(origin: FilterState, state: FilterState) -> SE3:
    """Return what takes poses in the map to poses since the start `origin`, by the mount that `state` knows; the identity while that is the same."""
    if origin.imu_from_lidar is state.imu_from_lidar or np.array_equal(origin.imu_from_lidar, state.imu_from_lidar):
        return SE3()
    began = origin.map_from_imu
    return began @ state.mount @ origin.mount.inverse() @ began.inverse()


def since_start_jacobian(origin: FilterState, state: FilterState, begin: SE3, n: int) -> F64:
    """Return the derivative (6, n) of the pose since the start (its place; its rotation perturbed on the right) by the filter's errors; `begin` is `start_from_map`."""
    out = np.zeros((6, n))
    turn = begin.matrix()[:3, :3]
    out[:3, k.POSITION : k.ROTATION] = turn
    out[3:, k.ROTATION : k.VELOCITY] = np.eye(3)
    if n > k.EXTRA:
        axes = origin.rotation @ state.imu_from_lidar[:, :3]  # of the LiDAR at the start
        pivot = origin.position + origin.rotation @ state.imu_from_lidar[:, 3]
        place = np.array((begin @ state.map_from_imu).translation)
        out[:3, k.EXTRA : k.EXTRA + 3] = origin.rotation
        out[:3, k.EXTRA + 3 : k.EXTRA + 6] = -skew(place - pivot) @ axes
        out[3:, k.EXTRA + 3 : k.EXTRA + 6] = (turn @ state.rotation).T @ axes
    return out
