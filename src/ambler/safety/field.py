"""The protective field: how fast may the robot go along an arc so that it can still stop before it touches anything.

While all axes brake together the robot stays on its arc. At the share s of the wanted velocity it covers the arc time
`s * reaction + s^2 * brake / 2` before it stands, where `brake` is the time that the slowest axis needs from full speed. The
field is that stretch of the swept, filled footprint plus a margin; it grows with the speed and looks only where the motion leads.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel, VelocityLimits
from ambler.kernels.footprint import contact_time, footprint_edges

F64 = NDArray[np.float64]

SWEEP_STEP = 0.02  # metres that the fastest corner moves between two poses of the sweep
NEARER = 1e-4  # metres by which a motion must come nearer to a close point to be held back


def braking_time(velocity: BodyVelocity, limits: VelocityLimits) -> float:
    """Return the seconds until every axis can stand, braking with the robot's limits."""
    return max(abs(velocity.vx) / limits.ax_brake, abs(velocity.vy) / limits.ay_brake, abs(velocity.wz) / limits.az_max)


def stopping_time(scale: float, reaction: float, braking: float) -> float:
    """Return the arc time covered before the robot stands, in seconds of motion at full wanted velocity."""
    return scale * reaction + 0.5 * scale * scale * braking


def safe_scale(contact: float, reaction: float, braking: float) -> float:
    """Return the largest share 0..1 of the wanted velocity whose `stopping_time` does not exceed the time of `contact`."""
    if contact >= stopping_time(1.0, reaction, braking):
        return 1.0
    if braking <= 1e-9:
        return contact / reaction if reaction > 0.0 else 0.0
    return min(1.0, (math.sqrt(reaction * reaction + 2.0 * braking * contact) - reaction) / braking)


class ProtectiveField:
    """Sweeps the footprint along a wanted motion against points around the robot."""

    def __init__(
        self, robot: RobotModel, reaction_time: float, margin: float, min_points: int, self_depth: float
    ) -> None:
        self._limits = robot.limits
        self._normals, self._offsets = footprint_edges(robot.footprint, 0.0)
        self._radius = robot.circumscribed_radius
        self._reaction_time = reaction_time
        self._margin = margin
        self._min_points = min_points
        self._self_depth = self_depth

    def free_scale(self, velocity: BodyVelocity, points_base: F64) -> float:
        """Return the share 0..1 of the wanted velocity that can still be stopped before the margin of any point (N, 2)."""
        braking = braking_time(velocity, self._limits)
        horizon = stopping_time(1.0, self._reaction_time, braking)
        contact = self.time_to_contact(velocity, points_base, horizon)
        return safe_scale(contact, self._reaction_time, braking)

    def time_to_contact(self, velocity: BodyVelocity, points_base: F64, horizon: float) -> float:
        """Return the seconds of motion until `min_points` points are within the margin; inf when there are none."""
        fastest = math.hypot(velocity.vx, velocity.vy) + abs(velocity.wz) * self._radius
        if fastest <= 0.0:
            return math.inf
        steps = max(1, math.ceil(fastest * horizon / SWEEP_STEP))
        return float(
            contact_time(
                points_base,
                self._normals,
                self._offsets,
                self._radius,
                np.array([velocity.vx, velocity.vy, velocity.wz]),
                self._margin,
                NEARER,
                self._self_depth,
                horizon / steps,
                steps,
                self._min_points,
            )
        )
