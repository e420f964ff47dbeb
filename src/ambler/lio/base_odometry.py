"""Odometry of a base that carries LiDAR and IMU: corrected by every scan, told at the rate of the IMU.

Scans are registered wherever the caller has time for it (`register`); in between, and while that goes on, the newest estimate is carried on by the
inertial measurements. The odom frame is level, and begins on the ground under the base with the base's heading.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Imu, Odometry, PointCloud
from ambler.core.protocols import CloudFilter
from ambler.core.se3 import SE3, Vector3
from ambler.kernels import inertial as k
from ambler.lio.carry import CarriedState, FilterEstimate
from ambler.lio.config import LioConfig
from ambler.lio.health import LioResult
from ambler.lio.measurements import skew
from ambler.lio.odometry import LidarInertialOdometry
from ambler.lio.state import to_se3
from ambler.recordings.cloud_scan import CloudScan, ScanJoiner

F64 = NDArray[np.float64]
HELD_MOST = 10  # clouds that wait for the IMU: a second of them
TOLD_AS = ("odom", "base")
RATE_BANDWIDTH = 100.0  # Hz of the gyroscope's noise in a single rate


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """A scan's `result`, the filter's `estimate` after it, and its `points` float32 (N, 3) in the filter's map with their `numbers` int64 (N,) in the cloud."""

    scan: CloudScan
    result: LioResult
    estimate: FilterEstimate
    points: NDArray[np.float32]
    numbers: NDArray[np.int64]


class BaseOdometry:
    """Feed it measurements in the order of their arrival; what `scans` yields goes through `register` and then to `take`, one after the other.

    `imu_from_lidar` and `imu_from_base` are the mounts. Odometry ends when no scan has fitted for `config.coast_most` seconds. `airs` take what floats in the air out
    of the few points that are registered, and out of the whole clouds for others.
    """

    def __init__(
        self,
        config: LioConfig,
        imu_from_lidar: SE3,
        imu_from_base: SE3,
        airs: tuple[CloudFilter, CloudFilter] | None = None,
    ) -> None:
        self.config = config
        self._filter = LidarInertialOdometry(config, imu_from_lidar, imu_from_base, airs[0] if airs else None)
        self._air = airs[1] if airs else None
        self._joiner = ScanJoiner(
            waits_for_odometry=False, held_most=HELD_MOST, has_outages=True, lidar_clock=self.config.lidar_clock
        )
        self._carried = CarriedState(config.imu)
        mount = imu_from_base.matrix()
        self._imu_from_base, self._lever, self._base_from_imu = imu_from_base, mount[:3, 3], mount[:3, :3].T
        self._minus_skew = -skew(self._lever)
        self._drift = np.zeros((6, 6))
        self._fitted_ns: int | None = None
        self._odom_from_map = SE3()
        self._turn_of_map = np.eye(3)

    def add(self, message: PointCloud | Imu | Odometry) -> Odometry | None:
        """Take a cloud, an inertial measurement, or the wheels' own odometry; an inertial measurement may give odometry of its stamp."""
        self._joiner.add(message)
        if not isinstance(message, Imu) or not self._carried.add(message) or not self._is_fit(message.stamp_ns):
            return None
        return self._tell(message.stamp_ns)

    def scans(self) -> Iterator[CloudScan]:
        """Yield the scans whose inertial measurements are complete."""
        return self._joiner.ready()

    def register(self, scan: CloudScan) -> Registered | None:
        """Update the filter by a scan (some milliseconds); touches nothing that `add` and `take` use. None: it said nothing.

        Raises LioInputError when the measurements cannot be what they are said to be.
        """
        result = self._filter.update(scan)
        if result is None or self._filter.start is None:
            return None
        state = self._filter.state.copy()
        stamp_ns = result.stamp_ns + round(state.clock * 1e9)
        estimate = FilterEstimate(stamp_ns, state, self._filter.covariance.copy(), self._filter.start.scale)
        points, numbers = self._filter.registered(scan.cloud), np.arange(len(scan.cloud.points))
        if self._air is not None:
            numbers = numbers[self._air.keep(scan.cloud, numbers, lambda wanted: points[wanted])]
        return Registered(scan, result, estimate, points[numbers], numbers)

    def take(self, registered: Registered) -> None:
        """Go on from what a scan gave."""
        estimate, result = registered.estimate, registered.result
        self._carried.restart(estimate)
        self._drift = result.covariance - estimate.covariance[:6, :6]
        if self._fitted_ns is None:
            map_from_base = result.map_from_imu @ self._imu_from_base
            self._odom_from_map = SE3.from_se2(map_from_base.to_se2(), map_from_base.translation[2]).inverse()
            self._turn_of_map = self._odom_from_map.matrix()[:3, :3]
        if self._fitted_ns is None or not result.health.is_lost:
            self._fitted_ns = estimate.stamp_ns

    @property
    def is_astray(self) -> bool:
        """Whether nothing was measured for so long that the place is being looked for; not to be asked while a scan is registered."""
        return self._filter.is_astray

    def between_odoms(self, corrected_from_map: SE3) -> SE3:
        """Return a correction of the filter's map as the pose of odom in a corrected frame that began as odom did."""
        return self._odom_from_map @ corrected_from_map @ self._odom_from_map.inverse()

    def in_odom(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return points (N, 3) of the filter's map in the odom frame."""
        return np.asarray(self._odom_from_map.transform(points), np.float32)

    def _is_fit(self, stamp_ns: int) -> bool:
        return self._fitted_ns is not None and stamp_ns - self._fitted_ns <= self.config.coast_most * 1e9

    def _tell(self, stamp_ns: int) -> Odometry:
        state = self._carried.state
        place = self._odom_from_map @ to_se3(state.position, state.rotation)
        velocity = self._base_from_imu @ (state.rotation.T @ state.velocity + _cross(self._carried.rate, self._lever))
        return Odometry(
            stamp_ns,
            *TOLD_AS,
            place @ self._imu_from_base,
            _vector(velocity),
            _vector(self._base_from_imu @ self._carried.rate),
            self._pose_covariance(place.matrix()[:3, :3]),
            self._twist_covariance(),
        )

    def _pose_covariance(self, odom_from_imu: F64) -> F64:
        """Return (6, 6) of the base's position and of rotations about the axes of odom, from the IMU's of the filter."""
        covariance = self._carried.covariance[:6, :6] + self._drift
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = self._turn_of_map
        jacobian[:3, 3:] = odom_from_imu @ self._minus_skew
        jacobian[3:, 3:] = odom_from_imu
        return np.asarray(jacobian @ covariance @ jacobian.T)

    def _twist_covariance(self) -> F64:
        config = self.config.imu
        turn = self._base_from_imu @ self._carried.state.rotation.T
        v, b = slice(k.VELOCITY, k.GYRO_BIAS), slice(k.GYRO_BIAS, k.ACCEL_BIAS)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = turn @ self._carried.covariance[v, v] @ turn.T
        noise = config.gyro_density**2 * RATE_BANDWIDTH
        covariance[3:, 3:] = self._base_from_imu @ self._carried.covariance[b, b] @ self._base_from_imu.T
        covariance[3:, 3:] += noise * np.eye(3)
        return covariance


def _cross(a: F64, b: F64) -> F64:
    """`np.cross` of two vectors (3,), in a tenth of its time."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _vector(values: F64) -> Vector3:
    x, y, z = values.tolist()
    return (x, y, z)
