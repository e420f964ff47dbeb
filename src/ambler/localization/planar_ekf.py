"""Fuses wheel odometry and an IMU into smooth planar odometry: an extended Kalman filter after robot_localization, for the plane only.

Measurements may come late: the filter rewinds to their instant and repeats what followed. Wheels that slip (their turning
disagrees with the gyroscope's) lose their weight until they agree again.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import planar_ekf as kernel
from ambler.localization.errors import InvalidPoseError

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class EkfConfig:
    """`*_noise`: how fast velocities may change without being measured (m/s²/√Hz, rad/s²/√Hz); `pose_noise` what integration may miss
    (m/√s, rad/√s); `bias_*`: of the gyroscope. `gate`: squared Mahalanobis distance per measurement. Slip: turning of wheels and
    gyroscope differ by `slip_gate` sigma; the covariance of their turning is then `slip_factor` times larger for `slip_hold` seconds, that of
    their way `slip_way_factor` times.
    `history` seconds are kept for late measurements."""

    speed_noise: float = 1.0
    side_noise: float = 1.0
    turn_noise: float = 2.0
    position_noise: float = 1e-4
    yaw_noise: float = 1e-5
    bias_sigma: float = 0.01
    bias_noise: float = 2e-5
    gate: float = 25.0
    slip_gate: float = 4.0
    slip_factor: float = 1e5
    slip_way_factor: float = 1e5
    slip_hold: float = 0.3
    history: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class EkfEstimate:
    """Pose in the odometry frame and velocity of the base; `covariance` float64 (7, 7) of (x, y, yaw, vx, vy, wz, gyro bias), pose
    along the axes of the odometry frame."""

    stamp_ns: int
    odom_from_base: SE2
    velocity: BodyVelocity
    gyro_bias: float
    covariance: F64
    is_slipping: bool


@dataclass(frozen=True, slots=True)
class EkfCounts:
    """How many measurements were used, gated out, came too late, and how many steps were repeated for late ones."""

    used: int
    gated: int
    too_late: int
    repeated: int


class _Entry:
    """One measurement and the filter right after it."""

    __slots__ = ("acceleration", "doubt", "gate_count", "gyro", "kind", "p", "r", "slip_until_ns", "stamp_ns", "x", "z")

    def __init__(
        self, stamp_ns: int, kind: int, z: F64, r: F64, acceleration: F64 | None = None, doubt: float = 0.0
    ) -> None:
        self.stamp_ns, self.kind, self.z, self.r, self.acceleration = stamp_ns, kind, z, r, acceleration
        self.doubt = doubt
        self.x: F64 = z
        self.p: F64 = r
        self.gyro: tuple[int, float, float] = (-1, 0.0, 0.0)
        self.slip_until_ns = 0
        self.gate_count = 0


_NO_ACCELERATION = np.zeros(2)
_CERTAIN = np.diag([1e-9, 1e-9, 1e-9])
_GYRO_MAX_AGE_NS = 100_000_000


class PlanarEkf:
    """The filter. Starts at `odom_from_base` with certainty; the first measurement sets its clock."""

    def __init__(self, config: EkfConfig, odom_from_base: SE2 | None = None) -> None:
        self.config = config
        c = config
        self._density = np.array(
            [
                c.position_noise**2,
                c.position_noise**2,
                c.yaw_noise**2,
                c.speed_noise**2,
                c.side_noise**2,
                c.turn_noise**2,
                c.bias_noise**2,
            ]
        )
        self._work = np.zeros((4, kernel.SIZE, kernel.SIZE))
        self._start = SE2() if odom_from_base is None else odom_from_base
        self._start_covariance = _CERTAIN
        self._entries: list[_Entry] = []
        self._stamps: list[int] = []
        self._used = self._gated = self._too_late = self._repeated = 0

    @property
    def counts(self) -> EkfCounts:
        return EkfCounts(self._used, self._gated, self._too_late, self._repeated)

    def add_twist(self, stamp_ns: int, twist: F64, covariance: F64, turn_doubt: float = 0.0) -> bool:
        """Fuse a velocity of the wheels, float64 (3,) of (vx, vy, wz) in the base frame; returns False when it was not used.

        `turn_doubt` (rad²/s²) is the variance of lasting errors of the turning: it takes weight from it, but makes no slip of more.
        """
        z = np.array(twist, float)
        return self._add(_Entry(stamp_ns, kernel.TWIST, z, _checked(covariance), doubt=turn_doubt))

    def add_imu(self, stamp_ns: int, yaw_rate: float, variance: float, acceleration: F64 | None = None) -> bool:
        """Fuse the turn rate of a gyroscope (rad/s) and, if given, level accelerations of the base float64 (2,) (m/s²)."""
        r = np.zeros((3, 3))
        r[0, 0] = max(variance, 1e-9)
        a = None if acceleration is None else np.array(acceleration, float)
        return self._add(_Entry(stamp_ns, kernel.YAW_RATE, np.array([yaw_rate, 0.0, 0.0]), r, a))

    def add_pose(self, stamp_ns: int, odom_from_base: SE2, covariance: F64) -> bool:
        """Fuse a pose in the odometry frame with its covariance float64 (3, 3)."""
        return self._add(_Entry(stamp_ns, kernel.POSE, odom_from_base.as_array(), _checked(covariance)))

    def set_pose(self, odom_from_base: SE2, covariance: F64 | None = None) -> None:
        """Start again from a pose with its covariance float64 (3, 3) (None: certain), at rest; the gyroscope's bias is learned again."""
        self._start = odom_from_base
        self._start_covariance = _CERTAIN if covariance is None else _checked(covariance)
        self._entries.clear()
        self._stamps.clear()

    def estimate(self, stamp_ns: int | None = None) -> EkfEstimate | None:
        """Return the newest estimate, or carried on (never back) to an instant; None before the first measurement."""
        if not self._entries:
            return None
        last = self._entries[-1]
        x, p = last.x.copy(), last.p.copy()
        stamp = last.stamp_ns if stamp_ns is None else max(stamp_ns, last.stamp_ns)
        if stamp > last.stamp_ns:
            kernel.predict(x, p, (stamp - last.stamp_ns) * 1e-9, self._density, _NO_ACCELERATION, self._work[0])
        pose = SE2(float(x[0]), float(x[1]), wrap_angle(float(x[2])))
        velocity = BodyVelocity(float(x[3]), float(x[4]), float(x[5]))
        return EkfEstimate(stamp, pose, velocity, float(x[6]), p, stamp < last.slip_until_ns)

    def _add(self, entry: _Entry) -> bool:
        if not np.isfinite(entry.z).all():
            raise InvalidPoseError("a measurement of the odometry filter is not finite")
        at = bisect_right(self._stamps, entry.stamp_ns)
        if at == 0 and self._entries:
            self._too_late += 1
            return False
        self._entries.insert(at, entry)
        self._stamps.insert(at, entry.stamp_ns)
        is_used = self._apply(at)
        for k in range(at + 1, len(self._entries)):
            self._repeated += 1
            self._apply(k)
        self._used += is_used
        self._gated += not is_used
        self._forget()
        return is_used

    def _apply(self, at: int) -> bool:
        """Compute the filter after entry `at` from the one before it."""
        entry = self._entries[at]
        dt = 0.0
        if at == 0:
            entry.x = np.zeros(kernel.SIZE)
            entry.x[:3] = self._start.as_array()
            entry.p = np.diag([0.0, 0.0, 0.0, 0.25, 0.25, 0.25, self.config.bias_sigma**2])
            entry.p[:3, :3] = self._start_covariance
            entry.gyro, entry.slip_until_ns, entry.gate_count = (-1, 0.0, 0.0), 0, 0
        else:
            before = self._entries[at - 1]
            entry.x, entry.p = before.x.copy(), before.p.copy()
            entry.gyro, entry.slip_until_ns, entry.gate_count = before.gyro, before.slip_until_ns, before.gate_count
            dt = (entry.stamp_ns - before.stamp_ns) * 1e-9
        r, gate = entry.r, self.config.gate
        if entry.kind == kernel.YAW_RATE:
            entry.gyro = (entry.stamp_ns, float(entry.z[0]), float(entry.r[0, 0]))
        elif entry.kind == kernel.TWIST:
            r = self._weighed(entry)
        if entry.gate_count >= 5:
            gate = math.inf  # a sensor that is refused for long is right, the filter is wrong
        acceleration = _NO_ACCELERATION if entry.acceleration is None else entry.acceleration
        distance = float(
            kernel.step(entry.x, entry.p, dt, self._density, acceleration, entry.kind, entry.z, r, gate, self._work)
        )
        is_used = 0.0 <= distance <= gate
        entry.gate_count = 0 if is_used else entry.gate_count + 1
        return is_used

    def _weighed(self, entry: _Entry) -> F64:
        """Return the covariance of the wheels' velocity with what is known of lasting errors and of slip."""
        r = entry.r.copy()
        r[2, 2] += entry.doubt
        if self._is_slipping(entry):
            root = np.sqrt([self.config.slip_way_factor] * 2 + [self.config.slip_factor])
            r *= np.outer(root, root)
        return r

    def _is_slipping(self, entry: _Entry) -> bool:
        stamp, rate, variance = entry.gyro
        if stamp < 0 or entry.stamp_ns - stamp > _GYRO_MAX_AGE_NS:
            return False
        difference = float(entry.z[2]) - (rate - float(entry.x[6]))
        sigma2 = float(entry.r[2, 2]) + variance + float(entry.p[6, 6])
        if difference * difference > self.config.slip_gate**2 * sigma2:
            entry.slip_until_ns = entry.stamp_ns + int(self.config.slip_hold * 1e9)
        return entry.stamp_ns < entry.slip_until_ns

    def _forget(self) -> None:
        oldest = self._stamps[-1] - int(self.config.history * 1e9)
        keep = bisect_right(self._stamps, oldest)
        if keep > 64:  # in bunches: deleting from the front of a list costs its length
            del self._entries[: keep - 1]
            del self._stamps[: keep - 1]


def _checked(covariance: F64) -> F64:
    """Copy a covariance (3, 3) and keep its variances from being zero; raises InvalidPoseError when it is not finite."""
    out = np.array(covariance, float)
    if out.shape != (3, 3) or not np.isfinite(out).all():
        raise InvalidPoseError("the covariance of a measurement is not a finite 3 x 3 matrix")
    for k in range(3):
        out[k, k] = max(out[k, k], 1e-9)
    return out
