"""Rigid motions of the plane, SE(2). `a_from_b @ b_from_c` is `a_from_c`; angles are radians, lengths metres."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.units import Radians

F64 = NDArray[np.float64]


def wrap_angle(angle: float) -> float:
    """Bring an angle into [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@dataclass(frozen=True, slots=True)
class SE2:
    """A pose of one planar frame in another: translation (x, y) in metres and yaw in radians."""

    x: float = 0.0
    y: float = 0.0
    yaw: Radians = 0.0

    def __matmul__(self, other: SE2) -> SE2:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return SE2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.yaw + other.yaw),
        )

    def inverse(self) -> SE2:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return SE2(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.yaw))

    def transform(self, points: NDArray[np.floating]) -> F64:
        """Map points (N, 2) of the child frame into the parent frame; returns float64 (N, 2)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        out = np.empty((len(points), 2))
        out[:, 0] = self.x + c * points[:, 0] - s * points[:, 1]
        out[:, 1] = self.y + s * points[:, 0] + c * points[:, 1]
        return out

    def as_array(self) -> F64:
        """Return (x, y, yaw) as float64 (3,)."""
        return np.array([self.x, self.y, self.yaw])

    @classmethod
    def from_array(cls, values: NDArray[np.floating]) -> SE2:
        """Build from (x, y, yaw)."""
        return cls(float(values[0]), float(values[1]), float(values[2]))

    def log(self) -> F64:
        """Return the twist (vx, vy, w) that reaches this pose in unit time (Lie logarithm)."""
        w = wrap_angle(self.yaw)
        half = 0.5 * w
        k = 1.0 - half * half / 3.0 if abs(w) < 1e-6 else half / math.tan(half)
        return np.array([k * self.x + half * self.y, -half * self.x + k * self.y, w])

    @classmethod
    def exp(cls, twist: NDArray[np.floating]) -> SE2:
        """Integrate a constant body twist (vx, vy, w) for unit time (Lie exponential)."""
        vx, vy, w = float(twist[0]), float(twist[1]), float(twist[2])
        if abs(w) < 1e-9:
            return cls(vx - 0.5 * w * vy, vy + 0.5 * w * vx, w)
        a, b = math.sin(w) / w, math.sin(0.5 * w) ** 2 / (0.5 * w)  # the second is (1 - cos w) / w without cancellation
        return cls(a * vx - b * vy, b * vx + a * vy, wrap_angle(w))

    def interpolate(self, other: SE2, ratio: float) -> SE2:
        """Move along the constant-twist arc from here (0) to `other` (1); also extrapolates."""
        return self @ SE2.exp(ratio * (self.inverse() @ other).log())

    def distance_to(self, other: SE2) -> float:
        """Euclidean distance of the two origins, metres."""
        return math.hypot(other.x - self.x, other.y - self.y)
