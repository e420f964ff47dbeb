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


_NO_ACCELERATION = np.zeros(2)
_CERTAIN = np.diag([1e-9, 1e-9, 1e-9])
_FEW = 64  # entries that are kept in any case


class PlanarEkf:
    """The filter. Starts at `odom_from_base` with certainty; the first measurement sets its clock."""

    def __init__(self, config: EkfConfig, odom_from_base: SE2 | None = None) -> None:
        self.config = config
        c = config
        self._rules = np.zeros(1, kernel.RULES)
        rules = self._rules[0]
        noise = [
            c.position_noise,
            c.position_noise,
            c.yaw_noise,
            c.speed_noise,
            c.side_noise,
            c.turn_noise,
            c.bias_noise,
        ]
        rules["density"] = [density**2 for density in noise]
        rules["gate"], rules["slip_gate"], rules["slip_hold_ns"] = c.gate, c.slip_gate, round(c.slip_hold * 1e9)
        rules["slip_factor"], rules["slip_way_factor"] = c.slip_factor, c.slip_way_factor
        self._work = np.zeros((5, kernel.SIZE, kernel.SIZE))
        self._start = SE2() if odom_from_base is None else odom_from_base
        self._start_covariance = _CERTAIN
        # Sorted by stamp, as many as `_stamps`; the first is the start, or the newest that is forgotten, and no measurement.
        self._entries = np.zeros(2 * _FEW, kernel.ENTRY)
        self._stamps: list[int] = []
        self._rate, self._rate_covariance = np.zeros(3), np.zeros((3, 3))
        self._used = self._gated = self._too_late = self._repeated = 0

    @property
    def counts(self) -> EkfCounts:
        return EkfCounts(self._used, self._gated, self._too_late, self._repeated)

    def add_twist(self, stamp_ns: int, twist: F64, covariance: F64, turn_doubt: float = 0.0) -> bool:
        """Fuse a velocity of the wheels, float64 (3,) of (vx, vy, wz) in the base frame; returns False when it was not used.

        `turn_doubt` (rad²/s²) is the variance of lasting errors of the turning: it takes weight from it, but makes no slip of more.
        """
        return self._add(stamp_ns, kernel.TWIST, np.array(twist, float), _checked(covariance), turn_doubt)

    def add_imu(self, stamp_ns: int, yaw_rate: float, variance: float, acceleration: F64 | None = None) -> bool:
        """Fuse the turn rate of a gyroscope (rad/s) and, if given, level accelerations of the base float64 (2,) (m/s²)."""
        z, r = self._rate, self._rate_covariance
        z[0], r[0, 0] = yaw_rate, max(variance, 1e-9)
        a = _NO_ACCELERATION if acceleration is None else np.array(acceleration, float)
        return self._add(stamp_ns, kernel.YAW_RATE, z, r, 0.0, a)

    def add_pose(self, stamp_ns: int, odom_from_base: SE2, covariance: F64) -> bool:
        """Fuse a pose in the odometry frame with its covariance float64 (3, 3)."""
        return self._add(stamp_ns, kernel.POSE, odom_from_base.as_array(), _checked(covariance))

    def set_pose(self, odom_from_base: SE2, covariance: F64 | None = None) -> None:
        """Start again from a pose with its covariance float64 (3, 3) (None: certain), at rest; the gyroscope's bias is learned again."""
        self._start = odom_from_base
        self._start_covariance = _CERTAIN if covariance is None else _checked(covariance)
        self._stamps.clear()

    def estimate(self, stamp_ns: int | None = None) -> EkfEstimate | None:
        """Return the newest estimate, or that of an instant, carried on from the last measurement before it (never back from the oldest that is
        kept); None before the first measurement."""
        if not self._stamps:
            return None
        at = len(self._stamps) - 1 if stamp_ns is None else max(0, bisect_right(self._stamps, stamp_ns) - 1)
        last, last_ns = self._entries[at], self._stamps[at]
        x, p = last["x"].copy(), last["p"].copy()
        stamp = last_ns if stamp_ns is None else max(stamp_ns, last_ns)
        if stamp > last_ns:
            density = self._rules[0]["density"]
            kernel.predict(x, p, (stamp - last_ns) * 1e-9, density, _NO_ACCELERATION, self._work[0])
        px, py, yaw, vx, vy, wz, bias = x.tolist()
        is_slipping = bool(stamp < last["slip_until_ns"])
        return EkfEstimate(stamp, SE2(px, py, wrap_angle(yaw)), BodyVelocity(vx, vy, wz), bias, p, is_slipping)

    def _add(
        self, stamp_ns: int, kind: int, z: F64, r: F64, doubt: float = 0.0, acceleration: F64 = _NO_ACCELERATION
    ) -> bool:
        if not all(map(math.isfinite, z.tolist())):
            raise InvalidPoseError("a measurement of the odometry filter is not finite")
        stamps = self._stamps
        if not stamps:
            self._begin(stamp_ns)
        at = bisect_right(stamps, stamp_ns)
        if at == 0:
            self._too_late += 1
            return False
        count = len(stamps)
        is_used = bool(
            kernel.insert(self._entries, count, at, stamp_ns, kind, z, r, doubt, acceleration, self._rules, self._work)
        )
        stamps.insert(at, stamp_ns)
        self._repeated += count - at
        self._used += is_used
        self._gated += not is_used
        self._make_room()
        return is_used

    def _begin(self, stamp_ns: int) -> None:
        """Set the filter's clock: at that instant the base is at the start."""
        start = self._entries[0]
        start["stamp_ns"], start["gyro_ns"], start["slip_until_ns"], start["refused"] = stamp_ns, -1, 0, 0
        start["x"] = 0.0
        start["x"][:3] = self._start.as_array()
        start["p"] = np.diag([0.0, 0.0, 0.0, 0.25, 0.25, 0.25, self.config.bias_sigma**2])
        start["p"][:3, :3] = self._start_covariance
        self._stamps.append(stamp_ns)

    def _make_room(self) -> None:
        """Forget in bunches what is too old for late measurements, and have room for one more."""
        count = len(self._stamps)
        old = bisect_right(self._stamps, self._stamps[-1] - int(self.config.history * 1e9)) - 1
        if old >= _FEW:
            self._entries[: count - old] = self._entries[old:count].copy()
            del self._stamps[:old]
        elif count == len(self._entries):
            self._entries = np.concatenate([self._entries, np.zeros_like(self._entries)])


def _checked(covariance: F64) -> F64:
    """Copy a covariance (3, 3) and keep its variances from being zero; raises InvalidPoseError when it is not finite."""
    out = np.array(covariance, float)
    if out.shape != (3, 3) or not all(map(math.isfinite, out.ravel().tolist())):
        raise InvalidPoseError("the covariance of a measurement is not a finite 3 x 3 matrix")
    diagonal = np.einsum("ii->i", out)
    np.maximum(diagonal, 1e-9, out=diagonal)
    return out
