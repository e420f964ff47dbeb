"""Odometry of the base out of what its wheels (or legs) and a gyroscope tell: continuous, drifting, never jumping (REP 105).

The way between two messages of the wheels is the difference of their poses; it is a velocity at the middle of that interval, where
the planar filter takes it in beside the turn rates of the gyroscope. Height, roll and pitch are the wheels' own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import LEVEL, lean_of
from ambler.core.messages import Odometry
from ambler.core.se2 import SE2, wrap_angle
from ambler.core.se3 import SE3, Vector3
from ambler.core.units import Radians
from ambler.localization.planar_ekf import EkfConfig, EkfEstimate, PlanarEkf

F64 = NDArray[np.float64]
_PLANE = [0, 1, 5]
_BLOCK = np.ix_(_PLANE, _PLANE)


@dataclass(frozen=True, slots=True)
class Note:
    """Something that people should read in the log: a stable code and one sentence."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class OdometryUpdate:
    """What one message of the wheels gave: odometry of its stamp, None when the message was left out, and what is to be said of it."""

    odometry: Odometry | None
    notes: tuple[Note, ...] = ()


class OdometryEstimator(Protocol):
    """Makes odometry at the rate of the wheels. What else tells motion is fed in between."""

    def add_imu(self, stamp_ns: int, angular_velocity: Vector3) -> None:
        """Take turn rates (rad/s) along the axes of the base."""
        ...

    def update(self, wheels: Odometry) -> OdometryUpdate:
        """Take the wheels' own odometry and return that of the base at the same stamp. Stamps of what is returned increase, unless the
        clock was set back, which is noted."""
        ...


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    """`gyro_variance` (rad²/s²) and `wheel_variance` (m²/s², m²/s², rad²/s²), the latter for wheels that state none. Beside a gyroscope the
    turning of wheels counts little while they move: its lasting errors are `turn_doubt` of it and `way_doubt` rad per metre (so much, because
    they do not average out); while they stand (`still` m/s, rad/s) it is zero to `still_sigma` rad/s, which tells the gyroscope's bias. Wheels that were silent
    for more than `gap_most` s moved the base by the difference of their poses if that is less than `speed_most` m/s and `turn_most` rad/s. A
    pose that is off the told velocity by more than `jump_way` m or `jump_turn` rad was set, not driven. So many older stamps in a row as
    `setbacks` mean that the clock was set back. A gyroscope is missed after `imu_age` s.
    The filter refuses nothing: a bump turns a robot faster than any model of it, and a false pose of the wheels is taken back by the next."""

    gyro_variance: float = 1e-4
    wheel_variance: tuple[float, float, float] = (1e-3, 1e-3, 1e-3)
    turn_doubt: float = 1.0
    way_doubt: Radians = 0.5
    still: float = 1e-3
    still_sigma: Radians = 1e-3
    gap_most: float = 0.25
    speed_most: float = 3.0
    turn_most: Radians = 4.0
    jump_way: float = 0.05
    jump_turn: Radians = 0.05
    setbacks: int = 5
    imu_age: float = 0.2
    ekf: EkfConfig = field(default_factory=lambda: EkfConfig(slip_way_factor=1.0, gate=math.inf))


@dataclass(slots=True)
class _Wheels:
    """The last message of the wheels, its pose in the plane, and the odometry that it gave."""

    stamp_ns: int
    planar: SE2
    told: EkfEstimate


class WheelInertialOdometry:
    """The estimator of wheels and gyroscope; without a gyroscope it follows the wheels."""

    def __init__(self, config: OdometryConfig | None = None) -> None:
        self.config = config or OdometryConfig()
        self._ekf = PlanarEkf(self.config.ekf)
        self._last: _Wheels | None = None
        self._lean = (0.0, 0.0)
        self._sway = np.zeros(3)
        self._imu_ns: int | None = None
        self._is_imu_missed = False
        self._setbacks = 0
        self._is_bad = False
        self._notes: list[Note] = []

    def add_imu(self, stamp_ns: int, angular_velocity: Vector3) -> None:
        """Take turn rates (rad/s) along the axes of the base; what is no number is left out, and if that lasts, the gyroscope is missed."""
        if self._last is None or not all(math.isfinite(w) for w in angular_velocity):
            return
        roll, pitch = self._lean
        _, wy, wz = angular_velocity
        yaw_rate = (wy * math.sin(roll) + wz * math.cos(roll)) / max(math.cos(pitch), 0.5)
        self._ekf.add_imu(stamp_ns, yaw_rate, self.config.gyro_variance)
        self._imu_ns = stamp_ns

    def update(self, wheels: Odometry) -> OdometryUpdate:
        """Take one message of the wheels."""
        self._notes = []
        estimate = self._step(wheels)
        odometry = None if estimate is None else self._tell(wheels, estimate)
        return OdometryUpdate(odometry, tuple(self._notes))

    def _step(self, wheels: Odometry) -> EkfEstimate | None:
        """Move the filter to the message's stamp; None when the message cannot be used."""
        if not _is_finite(wheels):
            if not self._is_bad:
                self._say("WHEELS_NOT_FINITE", "wheel odometry that is no number is left out")
            self._is_bad = True
            return None
        self._is_bad = False
        last, planar, stamp_ns = self._last, wheels.pose.to_se2(), wheels.stamp_ns
        self._lean = _roll_pitch(wheels.pose)
        if last is None:
            return self._start(wheels, planar, planar, None)
        if stamp_ns <= last.stamp_ns:
            return self._set_back(wheels, planar, last)
        self._setbacks = 0
        self._miss_imu(stamp_ns)
        seconds = (stamp_ns - last.stamp_ns) * 1e-9
        way = last.planar.inverse() @ planar
        if seconds > self.config.gap_most:
            return self._bridge(wheels, planar, last, way)
        told, twist = _twist(wheels), way.log() / seconds
        off = (twist - told) * seconds
        if math.hypot(off[0], off[1]) > self.config.jump_way or abs(off[2]) > self.config.jump_turn:
            self._say("WHEELS_JUMPED", f"the wheels' pose was set {math.hypot(off[0], off[1]):.2f} m away")
            twist = told
        self._sway = twist - told
        self._add_twist((stamp_ns + last.stamp_ns) // 2, twist, wheels)
        return self._remember(stamp_ns, planar)

    def _start(self, wheels: Odometry, planar: SE2, odom_from_base: SE2, covariance: F64 | None) -> EkfEstimate | None:
        """Begin at a pose, with the velocity that the wheels tell."""
        self._ekf.set_pose(odom_from_base, covariance)
        self._sway = np.zeros(3)
        self._add_twist(wheels.stamp_ns, _twist(wheels), wheels)
        return self._remember(wheels.stamp_ns, planar)

    def _bridge(self, wheels: Odometry, planar: SE2, last: _Wheels, way: SE2) -> EkfEstimate | None:
        """Go on after a silence: the wheels have counted what the base went meanwhile, the gyroscope how it turned."""
        seconds = (wheels.stamp_ns - last.stamp_ns) * 1e-9
        text = f"the wheels were silent for {seconds:.2f} s"
        length = math.hypot(way.x, way.y)
        turn = way.yaw
        now = self._ekf.estimate(wheels.stamp_ns)
        if now is not None and self._imu_ns is not None and wheels.stamp_ns - self._imu_ns < self.config.imu_age * 1e9:
            turn = wrap_angle(now.odom_from_base.yaw - last.told.odom_from_base.yaw)
        if length > self.config.speed_most * seconds or abs(way.yaw) > self.config.turn_most * seconds:
            text, length, way, turn = text + " and begin anew: taken as standing still", 0.0, SE2(), 0.0
        self._say("WHEELS_BACK", text)
        covariance = last.told.covariance[:3, :3] + np.diag([(0.1 * length) ** 2] * 2 + [(0.1 * way.yaw) ** 2])
        pose = last.told.odom_from_base @ SE2(way.x, way.y, turn)
        return self._start(wheels, planar, pose, covariance)

    def _set_back(self, wheels: Odometry, planar: SE2, last: _Wheels) -> EkfEstimate | None:
        """Leave out a message that is not newer than the last; after several in a row the clock was set back, and that is followed."""
        if wheels.stamp_ns == last.stamp_ns:
            return None
        self._setbacks += 1
        back = (last.stamp_ns - wheels.stamp_ns) * 1e-9
        if self._setbacks == 1:
            self._say("WHEELS_OUT_OF_ORDER", f"wheel odometry {back:.3f} s older than the last is left out")
        if self._setbacks < self.config.setbacks:
            return None
        self._setbacks, self._imu_ns = 0, None
        self._say("CLOCK_SET_BACK", f"stamps of the wheels run backwards by {back:.3f} s: begun anew there")
        return self._start(wheels, planar, last.told.odom_from_base, last.told.covariance[:3, :3])

    def _remember(self, stamp_ns: int, planar: SE2) -> EkfEstimate | None:
        estimate = self._ekf.estimate(stamp_ns)
        if estimate is not None:
            self._last = _Wheels(stamp_ns, planar, estimate)
        return estimate

    def _miss_imu(self, stamp_ns: int) -> None:
        if self._imu_ns is None:
            return
        is_missed = stamp_ns - self._imu_ns > self.config.imu_age * 1e9
        if is_missed and not self._is_imu_missed:
            self._say("IMU_SILENT", "no turn rates any more: odometry follows the wheels alone")
        elif self._is_imu_missed and not is_missed:
            self._say("IMU_BACK", "turn rates again")
        self._is_imu_missed = is_missed

    def _add_twist(self, stamp_ns: int, twist: F64, wheels: Odometry) -> None:
        """Fuse a velocity of the wheels with the covariance that they state."""
        config = self.config
        covariance = wheels.twist_covariance[_BLOCK]
        if np.count_nonzero(covariance) == 0:
            covariance = np.diag(config.wheel_variance)
        speed, turning = math.hypot(twist[0], twist[1]), abs(float(twist[2]))
        has_imu = self._imu_ns is not None and wheels.stamp_ns - self._imu_ns < config.imu_age * 1e9
        doubt = (config.turn_doubt * turning) ** 2 + (config.way_doubt * speed) ** 2 if has_imu else 0.0
        if speed < config.still and turning < config.still:
            covariance[:2, 2] = covariance[2, :2] = 0.0
            covariance[2, 2] = min(covariance[2, 2], config.still_sigma**2)
            if (
                self._last is not None
                and self._imu_ns is not None
                and self._last.stamp_ns < self._imu_ns < wheels.stamp_ns
            ):
                stamp_ns = self._imu_ns  # at rest the instant is free: with a turn rate, all that differs is its bias
        self._ekf.add_twist(stamp_ns, twist, covariance, doubt)

    def _say(self, code: str, text: str) -> None:
        self._notes.append(Note(code, text))

    def _tell(self, wheels: Odometry, estimate: EkfEstimate) -> Odometry:
        """Put the fused plane under the height and lean of the wheels. A walking body's sway is in the pose, not in the velocity, as the
        wheels tell it. Covariances: of the filter, and of what wheels state for the way (their scale is never seen by the filter)."""
        pose = SE3.from_se2(estimate.odom_from_base, wheels.pose.translation[2])
        lean = lean_of(wheels.pose)
        if lean != LEVEL:
            pose = pose @ SE3((0.0, 0.0, 0.0), lean)
        v, sway = estimate.velocity, self._sway
        pose_covariance, twist_covariance = wheels.pose_covariance.copy(), wheels.twist_covariance.copy()
        pose_covariance[_BLOCK] = estimate.covariance[:3, :3]
        pose_covariance[0, 0] += wheels.pose_covariance[0, 0]
        pose_covariance[1, 1] += wheels.pose_covariance[1, 1]
        twist_covariance[_BLOCK] = estimate.covariance[3:6, 3:6]
        return Odometry(
            wheels.stamp_ns,
            wheels.frame,
            wheels.child,
            pose,
            (v.vx - float(sway[0]), v.vy - float(sway[1]), wheels.linear[2]),
            (wheels.angular[0], wheels.angular[1], v.wz - float(sway[2])),
            pose_covariance,
            twist_covariance,
        )


def _twist(wheels: Odometry) -> F64:
    return np.array([wheels.linear[0], wheels.linear[1], wheels.angular[2]])


def _is_finite(wheels: Odometry) -> bool:
    numbers = (*wheels.pose.translation, *wheels.pose.rotation, *wheels.linear, *wheels.angular)
    return all(map(math.isfinite, (*numbers, *wheels.twist_covariance.ravel().tolist())))


def _roll_pitch(pose: SE3) -> tuple[float, float]:
    w, x, y, z = pose.rotation
    if x == 0.0 and y == 0.0:
        return 0.0, 0.0
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
