"""The filter's state on SO(3) x R^12 x S^2 (x mount x clock) with its plus and minus (FAST-LIO2, section III)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3, Quaternion
from ambler.kernels import inertial as k
from ambler.lio.config import STANDARD_GRAVITY

F64 = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class FilterState:
    """`position` (m), `velocity` (m/s) and `rotation` (3, 3) of the IMU in the map, biases in the IMU, `gravity` in the map (m/s²), the LiDAR's
    mount `imu_from_lidar` (3, 4), and the seconds `clock` that the LiDAR's stamps lag behind the IMU's."""

    position: F64 = field(default_factory=lambda: np.zeros(3))
    rotation: F64 = field(default_factory=lambda: np.eye(3))
    velocity: F64 = field(default_factory=lambda: np.zeros(3))
    gyro_bias: F64 = field(default_factory=lambda: np.zeros(3))
    accel_bias: F64 = field(default_factory=lambda: np.zeros(3))
    gravity: F64 = field(default_factory=lambda: np.array([0.0, 0.0, -STANDARD_GRAVITY]))
    imu_from_lidar: F64 = field(default_factory=lambda: np.eye(3, 4))
    clock: float = 0.0

    def copy(self) -> FilterState:
        """Return the same state with arrays of its own."""
        names = ("position", "rotation", "velocity", "gyro_bias", "accel_bias", "gravity", "imu_from_lidar")
        return replace(self, **{name: getattr(self, name).copy() for name in names})

    def plus(self, delta: F64) -> FilterState:
        """Return the state moved by an error vector (17, 23 or 24)."""
        basis = gravity_basis(self.gravity)
        mount, clock = self.imu_from_lidar, self.clock
        if len(delta) > k.EXTRA:
            turned = mount[:, :3] @ exp(delta[k.EXTRA + 3 : k.EXTRA + 6])
            mount = np.column_stack([turned, mount[:, 3] + delta[k.EXTRA : k.EXTRA + 3]])
        if len(delta) > k.EXTRA + 6:
            clock += float(delta[k.EXTRA + 6])
        return FilterState(
            self.position + delta[k.POSITION : k.ROTATION],
            self.rotation @ exp(delta[k.ROTATION : k.VELOCITY]),
            self.velocity + delta[k.VELOCITY : k.GYRO_BIAS],
            self.gyro_bias + delta[k.GYRO_BIAS : k.ACCEL_BIAS],
            self.accel_bias + delta[k.ACCEL_BIAS : k.GRAVITY],
            exp(basis @ delta[k.GRAVITY : k.EXTRA]) @ self.gravity,
            np.ascontiguousarray(mount),
            clock,
        )

    def minus(self, other: FilterState, size: int = k.EXTRA) -> F64:
        """Return the error vector (size,) that takes `other` to this state."""
        delta = np.zeros(size)
        delta[k.POSITION : k.ROTATION] = self.position - other.position
        delta[k.ROTATION : k.VELOCITY] = log(other.rotation.T @ self.rotation)
        delta[k.VELOCITY : k.GYRO_BIAS] = self.velocity - other.velocity
        delta[k.GYRO_BIAS : k.ACCEL_BIAS] = self.gyro_bias - other.gyro_bias
        delta[k.ACCEL_BIAS : k.GRAVITY] = self.accel_bias - other.accel_bias
        delta[k.GRAVITY : k.EXTRA] = gravity_basis(other.gravity).T @ _turn_between(other.gravity, self.gravity)
        if size > k.EXTRA:
            delta[k.EXTRA : k.EXTRA + 3] = self.imu_from_lidar[:, 3] - other.imu_from_lidar[:, 3]
            delta[k.EXTRA + 3 : k.EXTRA + 6] = log(other.imu_from_lidar[:, :3].T @ self.imu_from_lidar[:, :3])
        if size > k.EXTRA + 6:
            delta[k.EXTRA + 6] = self.clock - other.clock
        return delta

    @property
    def map_from_imu(self) -> SE3:
        """The pose of the IMU in the map."""
        return to_se3(self.position, self.rotation)

    @property
    def mount(self) -> SE3:
        """Where the LiDAR sits on the IMU."""
        return to_se3(self.imu_from_lidar[:, 3], self.imu_from_lidar[:, :3])


def exp(vector: F64) -> F64:
    """Return the rotation matrix (3, 3) of a rotation vector (3,)."""
    out = np.empty((3, 3))
    k.so3_exp(float(vector[0]), float(vector[1]), float(vector[2]), out)
    return out


def log(rotation: F64) -> F64:
    """Return the rotation vector (3,) of a rotation matrix, up to half a turn."""
    w, x, y, z = quaternion_of(rotation)
    sine = math.hypot(x, y, z)
    scale = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return np.array([scale * x, scale * y, scale * z])


def right_jacobian(vector: F64) -> F64:
    """Return the right Jacobian (3, 3) of the exponential at a rotation vector."""
    out = np.empty((3, 3))
    k.right_jacobian(float(vector[0]), float(vector[1]), float(vector[2]), out)
    return out


def gravity_basis(gravity: F64) -> F64:
    """Return two unit vectors normal to gravity, (3, 2)."""
    out = np.empty((3, 2))
    k.sphere_basis(float(gravity[0]), float(gravity[1]), float(gravity[2]), out)
    return out


def quaternion_of(rotation: F64) -> Quaternion:
    """Return the unit quaternion (w, x, y, z), w not negative, of a rotation matrix (Shepperd)."""
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    traces = (a + e + i, a, e, i)
    largest = traces.index(max(traces))
    if largest == 0:
        q = (1.0 + traces[0], h - f, c - g, d - b)
    elif largest == 1:
        q = (h - f, 1.0 + a - e - i, d + b, g + c)
    elif largest == 2:
        q = (c - g, d + b, 1.0 + e - i - a, h + f)
    else:
        q = (d - b, g + c, h + f, 1.0 + i - a - e)
    scale = math.copysign(1.0 / math.hypot(*q), q[0])
    return (scale * q[0], scale * q[1], scale * q[2], scale * q[3])


def to_se3(position: F64, rotation: F64) -> SE3:
    """Return a pose from a position (3,) and a rotation matrix."""
    x, y, z = position.tolist()
    return SE3((x, y, z), quaternion_of(rotation))


def _turn_between(start: F64, end: F64) -> F64:
    """Return the shortest rotation vector (3,) that turns the direction of one vector into that of another."""
    cross = np.cross(start, end)
    sine, cosine = float(np.linalg.norm(cross)), float(start @ end)
    return np.zeros(3) if sine < 1e-15 else cross * (float(np.arctan2(sine, cosine)) / sine)


def orthonormal(rotation: F64) -> F64:
    """Return the nearest rotation (one step of Newton's method, enough for what rounding does to a scan)."""
    return np.ascontiguousarray(rotation @ (1.5 * np.eye(3) - 0.5 * rotation.T @ rotation))
