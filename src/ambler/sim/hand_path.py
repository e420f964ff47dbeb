"""A prescribed path with six degrees of freedom: a sensor in the hand of somebody who walks, on a cart, or shaken.

The way is a closed spline that is run through once: rest, a smooth start, a steady walk with sway, a smooth end, rest. Everything is an
analytic function of time, so that rates and forces are exact to rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ambler.core.se3 import SE3

F64 = NDArray[np.float64]
_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class Sway:
    """How a hand moves about its way: amplitudes in metres and radians, the frequency of steps in Hz. `yaw` is a slow look to both sides."""

    along: float = 0.015
    sideways: float = 0.02
    up: float = 0.025
    roll: float = math.radians(3.0)
    pitch: float = math.radians(3.0)
    yaw: float = math.radians(12.0)
    steps_hz: float = 1.8
    look_hz: float = 0.11

    @classmethod
    def none(cls) -> Sway:
        """The sway of a cart on smooth ground."""
        return cls(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Burst:
    """A shake: from `begin` on for `seconds`, turning to and fro about `axis` (unit) with rates up to `rate` rad/s, and moving along
    `direction` (unit) with accelerations up to `acceleration` m/s²."""

    begin: float
    seconds: float
    axis: tuple[float, float, float]
    rate: float
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    acceleration: float = 0.0
    frequency_hz: float = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class HandPath:
    """`way` float64 (N, 3): closed polyline of places of the hand, metres in the world, N >= 4, run through at `speed` m/s.

    Rests of `rest` seconds stand at both ends, the last one of `rest_after` seconds where that is given; speed changes within `ramp` seconds. `tilt` is a constant mounting roll and pitch.
    """

    way: F64
    speed: float = 1.4
    rest: float = 2.0
    rest_after: float | None = None
    ramp: float = 2.0
    sway: Sway = field(default_factory=Sway)
    bursts: tuple[Burst, ...] = ()
    is_closed: bool = True
    _spline: CubicSpline = field(init=False, repr=False)
    _length: float = field(init=False)

    def __post_init__(self) -> None:
        points = np.vstack([self.way, self.way[:1]]) if self.is_closed else np.asarray(self.way)
        kind: Literal["periodic", "natural"] = "periodic" if self.is_closed else "natural"
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        rough = CubicSpline(along, points, bc_type=kind)
        # Once more over its own arc length, so that the speed is what it is said to be.
        fine = np.linspace(0.0, along[-1], max(200, 20 * len(points)))
        places = rough(fine)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
        object.__setattr__(self, "_spline", CubicSpline(arc, places, bc_type=kind))
        object.__setattr__(self, "_length", float(arc[-1]))

    @property
    def length(self) -> float:
        """The length of the way, metres, without sway."""
        return self._length

    @property
    def seconds(self) -> float:
        """How long it takes with both rests."""
        return self.standing_from + (self.rest if self.rest_after is None else self.rest_after)

    @property
    def standing_from(self) -> float:
        """When the walk has ended, seconds."""
        return self.rest + self._walk_seconds

    @property
    def _walk_seconds(self) -> float:
        return self._length / self.speed + self.ramp

    def places(self, along: F64) -> F64:
        """Return places (K, 3) of the way at metres (K,) along it, without sway."""
        return np.asarray(self._spline(along))

    def poses(self, times: F64) -> tuple[F64, F64]:
        """Return positions (K, 3) and quaternions (K, 4, wxyz) of the hand in the world at times (K,)."""
        t = np.asarray(times, np.float64)
        s, activity = self._progress(t)
        places, ahead = self._spline(s), self._spline(s, 1)
        yaw = np.arctan2(ahead[:, 1], ahead[:, 0])
        w = self.sway
        beat, look = 2.0 * math.pi * w.steps_hz * t, 2.0 * math.pi * w.look_hz * t
        c, si = np.cos(yaw), np.sin(yaw)
        along = activity * w.along * np.sin(beat)
        sideways = activity * w.sideways * np.sin(0.5 * beat)
        positions = places + np.stack(
            [c * along - si * sideways, si * along + c * sideways, activity * w.up * np.sin(beat + 0.7)], axis=1
        )
        quaternions = _quaternions(
            activity * w.roll * np.sin(0.5 * beat + 0.3),
            activity * w.pitch * np.sin(beat + 1.1),
            yaw + activity * w.yaw * np.sin(look),
        )
        for burst in self.bursts:
            positions, quaternions = _shaken(burst, t, positions, quaternions)
        return positions, quaternions

    def velocities(self, times: F64) -> F64:
        """Return the velocities of the hand in the world at times (K,), float64 (K, 3)."""
        t = np.asarray(times, np.float64)
        return np.asarray((self.poses(t + _STEP)[0] - self.poses(t - _STEP)[0]) / (2.0 * _STEP))

    def pose(self, time: float) -> SE3:
        """Return the pose of the hand in the world at one time."""
        positions, quaternions = self.poses(np.array([time]))
        x, y, z = positions[0].tolist()
        qw, qx, qy, qz = quaternions[0].tolist()
        return SE3((x, y, z), (qw, qx, qy, qz))

    def _progress(self, t: F64) -> tuple[F64, F64]:
        """Return metres along the way, and how much of a walk it is (0: rest, 1: full sway)."""
        u = np.clip(t - self.rest, 0.0, self._walk_seconds)
        end = self._walk_seconds - u
        rising, falling = _smooth_integral(u, self.ramp), _smooth_integral(end, self.ramp)
        total = self._walk_seconds - self.ramp
        s = np.where(u <= 0.5 * self._walk_seconds, rising, total - falling) * self._length / total
        activity = _smooth(u / self.ramp) * _smooth(end / self.ramp)
        return np.clip(s, 0.0, self._length), activity


def _smooth(u: F64) -> F64:
    """A step from 0 to 1 with two continuous derivatives."""
    v = np.clip(u, 0.0, 1.0)
    return np.asarray(v * v * v * (v * (6.0 * v - 15.0) + 10.0))


def _smooth_integral(t: F64, ramp: float) -> F64:
    """The integral of the smooth step of `ramp` seconds."""
    v = np.clip(t / ramp, 0.0, 1.0)
    return np.asarray(ramp * v**4 * (v * (v - 3.0) + 2.5) + np.maximum(t - ramp, 0.0))


def _shaken(burst: Burst, t: F64, positions: F64, quaternions: F64) -> tuple[F64, F64]:
    u = t - burst.begin
    inside = (u > 0.0) & (u < burst.seconds)
    if not inside.any():
        return positions, quaternions
    window = _smooth(u / 0.5) * _smooth((burst.seconds - u) / 0.5)
    beat = 2.0 * math.pi * burst.frequency_hz
    angle = window * (burst.rate / beat) * np.sin(beat * u)
    half = 0.5 * angle[:, None]
    turn = np.concatenate([np.cos(half), np.sin(half) * np.array(burst.axis)], axis=1)
    slow = 2.0 * math.pi * 0.8
    shift = window * (burst.acceleration / slow**2) * np.sin(slow * u)
    return positions + shift[:, None] * np.array(burst.direction), _product(quaternions, turn)


def _quaternions(roll: F64, pitch: F64, yaw: F64) -> F64:
    """Return quaternions (K, 4, wxyz) of fixed-axis roll, pitch, yaw."""
    cr, sr, cp, sp, cy, sy = (f(0.5 * a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )


def _product(a: F64, b: F64) -> F64:
    """Hamilton product, row by row."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=1,
    )
