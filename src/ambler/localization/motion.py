"""Odometry as a motion with growing uncertainty: variance per metre and per radian, so that constant scale errors are covered."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.localization.errors import InvalidPoseError

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Standard deviations that grow with the square root of the way: m/√m, rad/√m, rad/√rad, m/√rad."""

    translation: float = 0.06
    yaw_per_way: float = 0.02
    yaw: float = 0.06
    translation_per_turn: float = 0.02

    def covariance_of(self, motion: SE2) -> F64:
        """Return the covariance float64 (3, 3) of a motion, along the axes of the base at its end."""
        way, turn = math.hypot(motion.x, motion.y), abs(motion.yaw)
        xy = self.translation**2 * way + self.translation_per_turn**2 * turn
        return np.diag([xy, xy, self.yaw_per_way**2 * way + self.yaw**2 * turn])


def predict(pose: SE2, covariance: F64, motion: SE2, noise: OdometryNoise) -> tuple[SE2, F64]:
    """Carry a pose with covariance (3, 3) in map axes along `base0_from_base1`; returns both at the end of the motion."""
    moved = pose @ motion
    jacobian = np.eye(3)
    jacobian[0, 2], jacobian[1, 2] = pose.y - moved.y, moved.x - pose.x
    turned = np.eye(3)
    c, s = math.cos(moved.yaw), math.sin(moved.yaw)
    turned[:2, :2] = [[c, -s], [s, c]]
    return moved, jacobian @ covariance @ jacobian.T + turned @ noise.covariance_of(motion) @ turned.T


def require_valid(pose: SE2, covariance: F64) -> None:
    """Raise InvalidPoseError unless the pose is finite and the covariance a positive definite (3, 3) matrix."""
    if not np.isfinite(pose.as_array()).all():
        raise InvalidPoseError(f"the pose ({pose.x}, {pose.y}, {pose.yaw}) is not finite")
    if covariance.shape != (3, 3) or not np.isfinite(covariance).all() or np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise InvalidPoseError("the covariance of the pose is not a positive definite 3 x 3 matrix")
