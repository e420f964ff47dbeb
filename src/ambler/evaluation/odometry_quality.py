"""How good fused odometry is outdoors: wheels alone and the robot's odometry of wheels and gyroscope, against satellite positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import GnssFix, Imu, Odometry
from ambler.evaluation.trajectory import TrajectoryError, trajectory_error
from ambler.localization.odometry import OdometryConfig, WheelInertialOdometry
from ambler.wire.bags import open_bag

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

WGS84_A, WGS84_E2 = 6378137.0, 6.69437999014e-3  # metres; squared eccentricity
MAX_GAP = 1.0  # seconds between two fixes that may be bridged


@dataclass(frozen=True, slots=True, eq=False)
class OdometryRecord:
    """What a recording holds, each in the order of its stamps; `up` is the direction of the vertical in the IMU's frame."""

    wheels: tuple[Odometry, ...]
    imu: tuple[Imu, ...]
    up: F64
    fix_stamps_ns: I64
    fixes: F64


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Poses float64 (N, 3) of (x, y, yaw) at stamps int64 (N,), and their error against the fixes."""

    stamps_ns: I64
    poses: F64
    error: TrajectoryError


def read_odometry_record(path: Path) -> OdometryRecord:
    """Read a bag with wheel odometry, an IMU and satellite fixes; raises BadInputError that names what is missing."""
    wheels: list[Odometry] = []
    imu: list[Imu] = []
    fixes: list[GnssFix] = []
    with open_bag(path) as bag:
        for read in bag.messages(types=[Odometry, Imu, GnssFix]):
            match read.message:
                case Odometry():
                    wheels.append(read.message)
                case Imu():
                    imu.append(read.message)
                case GnssFix() if math.isfinite(read.message.latitude + read.message.longitude):
                    fixes.append(read.message)
    for kind, found in (("wheel odometry", wheels), ("IMU", imu), ("satellite fixes", fixes)):
        if len(found) < 2:
            raise BadInputError(f"{path}: no {kind} in this recording")
    wheels.sort(key=lambda w: w.stamp_ns)
    imu.sort(key=lambda i: i.stamp_ns)
    fixes.sort(key=lambda f: f.stamp_ns)
    stamps = np.array([f.stamp_ns for f in fixes], np.int64)
    return OdometryRecord(tuple(wheels), tuple(imu), vertical(imu), stamps, to_plane(fixes))


def vertical(imu: Sequence[Imu]) -> F64:
    """Return the unit vector float64 (3,) that points up in the IMU's frame: gravity is what remains of all accelerations."""
    mean = np.mean([i.linear_acceleration for i in imu], axis=0)
    size = float(np.linalg.norm(mean))
    if not 8.0 < size < 11.0:
        raise BadInputError(
            f"the mean acceleration is {size:.1f} m/s², not that of gravity: where up is cannot be told"
        )
    return np.asarray(mean / size)


def to_plane(fixes: Sequence[GnssFix]) -> F64:
    """Return metres (N, 2) east and north of the first fix, in the tangent plane of the WGS 84 ellipsoid."""
    degrees = np.array([(f.latitude, f.longitude) for f in fixes])
    latitude, longitude = np.radians(degrees - degrees[0]).T
    sine = math.sin(math.radians(degrees[0, 0]))
    w = math.sqrt(1.0 - WGS84_E2 * sine * sine)
    north = WGS84_A * (1.0 - WGS84_E2) / w**3
    east = WGS84_A / w * math.cos(math.radians(degrees[0, 0]))
    return np.column_stack([longitude * east, latitude * north])


def wheels_alone(record: OdometryRecord) -> Track:
    """Return the track that the wheels' own odometry tells."""
    poses = np.array([w.pose.to_se2().as_array() for w in record.wheels])
    return _judged(record, np.array([w.stamp_ns for w in record.wheels], np.int64), poses)


def fused(record: OdometryRecord, config: OdometryConfig) -> Track:
    """Return the track of the robot's own odometry (wheels and gyroscope), fed in the order of the stamps; one pose per wheel measurement."""
    estimator = WheelInertialOdometry(config)
    stamps, poses = [], []
    measured: list[Odometry | Imu] = sorted([*record.imu, *record.wheels], key=lambda message: message.stamp_ns)
    for message in measured:
        if isinstance(message, Imu):
            rate = float(np.dot(message.angular_velocity, record.up))
            estimator.add_imu(message.stamp_ns, (0.0, 0.0, rate))
            continue
        odometry = estimator.update(message).odometry
        if odometry is not None:
            stamps.append(message.stamp_ns)
            poses.append(odometry.pose.to_se2().as_array())
    return _judged(record, np.array(stamps, np.int64), np.array(poses))


def way_of(track: Track) -> float:
    """Return the length of a track, metres."""
    return float(np.hypot(*np.diff(track.poses[:, :2], axis=0).T).sum())


def largest_step(track: Track) -> float:
    """Return the longest step between two poses, metres: odometry must not jump."""
    return float(np.hypot(*np.diff(track.poses[:, :2], axis=0).T).max())


def _judged(record: OdometryRecord, stamps: I64, poses: F64) -> Track:
    truth = np.column_stack([record.fixes, np.zeros(len(record.fixes))])
    return Track(stamps, poses, trajectory_error(stamps, poses, record.fix_stamps_ns, truth, max_gap=MAX_GAP))
