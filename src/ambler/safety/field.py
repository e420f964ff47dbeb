"""The protective field: how fast may the robot go along an arc so that it can still stop before it touches anything.

While all axes brake together the robot stays on its arc. At the share s of the wanted velocity it covers the arc time
`s * reaction + s^2 * brake / 2` before it stands, where `brake` is the time that the slowest axis needs from full speed. The
field is that stretch of the swept, filled footprint plus a margin; it grows with the speed and looks only where the motion leads.

It is monotone. How far the arc is free is found in closed form and depends on the arc alone, so at every share s of a velocity v
the same absolute speed is allowed: `s * free_scale(s v) = min(s, free_scale(v))`. A slower motion along the same arc is never less
free, and asking for more never yields less. (Only where a point grazes the margin to the last bits may rounding decide.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel, VelocityLimits
from ambler.kernels import protective_field as kernels
from ambler.kernels.footprint import footprint_corners, footprint_edges

F64 = NDArray[np.float64]

NEARER = 1e-4  # metres by which a motion must come nearer to a close point to be held back


def braking_time(velocity: BodyVelocity, limits: VelocityLimits) -> float:
    """Return the seconds until every axis can stand, braking with the robot's limits."""
    v = velocity
    return float(kernels.braking_time(v.vx, v.vy, v.wz, limits.ax_brake, limits.ay_brake, limits.az_max))


def stopping_time(scale: float, reaction: float, braking: float) -> float:
    """Return the arc time covered before the robot stands, in seconds of motion at full wanted velocity."""
    return float(kernels.stopping_time(scale, reaction, braking))


def safe_scale(contact: float, reaction: float, braking: float) -> float:
    """Return the largest share 0..1 of the wanted velocity whose `stopping_time` does not exceed the time of `contact`."""
    return float(kernels.safe_scale(contact, reaction, braking))


class ProtectiveField:
    """Sweeps the footprint along a wanted motion against points around the robot."""

    def __init__(
        self, robot: RobotModel, reaction_time: float, margin: float, min_points: int, self_depth: float
    ) -> None:
        self._limits = robot.limits
        self._normals, self._offsets = footprint_edges(robot.footprint, 0.0)
        self._radius = float(np.hypot(*footprint_corners(self._normals, self._offsets + margin).T).max())
        self._reaction_time = reaction_time
        self._margin = margin
        self._min_points = min_points
        self._self_depth = self_depth

    def free_scale(self, velocity: BodyVelocity, points_base: F64) -> float:
        """Return the share 0..1 of the wanted velocity that can still be stopped before the margin of `min_points` points (N, 2)."""
        return float(
            kernels.free_scale(
                points_base,
                self._normals,
                self._offsets,
                self._radius,
                np.array([velocity.vx, velocity.vy, velocity.wz], np.float64),
                braking_time(velocity, self._limits),
                self._reaction_time,
                self._margin,
                NEARER,
                self._self_depth,
                self._min_points,
            )
        )
