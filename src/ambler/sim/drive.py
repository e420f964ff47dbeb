"""What turns when a base moves: from body velocities to the speeds of wheels (or legs), and from what they counted back to motion.

Mecanum wheels as in Muir and Neuman 1987: rollers at 45 degrees, seen from above in an X; front left, front right, rear left,
rear right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.sim.sim_robot import SimRobot

F64 = NDArray[np.float64]


class Drive(Protocol):
    """`parts` counters turn: wheels in radians, or legs in (metres, metres, radians)."""

    @property
    def parts(self) -> int: ...

    def rates(self, velocity: BodyVelocity) -> tuple[float, ...]:
        """Return the rate of every counter at a body velocity."""
        ...

    def motion(self, steps: F64, turn_scale: float = 1.0) -> F64:
        """Return the twist (x, y, yaw) of counted steps (parts,), with a track that is `turn_scale` times as wide as it is."""
        ...


@dataclass(frozen=True, slots=True)
class TwoWheels:
    """Left and right wheel on the base's y axis."""

    radius: float
    track: float
    parts: int = 2

    def rates(self, velocity: BodyVelocity) -> tuple[float, ...]:
        half = 0.5 * self.track * velocity.wz
        return ((velocity.vx - half) / self.radius, (velocity.vx + half) / self.radius)

    def motion(self, steps: F64, turn_scale: float = 1.0) -> F64:
        left, right = steps * self.radius
        return np.array([0.5 * (left + right), 0.0, (right - left) / (self.track * turn_scale)])


@dataclass(frozen=True, slots=True)
class MecanumWheels:
    """Four wheels; `reach` is half the track plus half the wheel base."""

    radius: float
    reach: float
    parts: int = 4

    def rates(self, velocity: BodyVelocity) -> tuple[float, ...]:
        vx, vy, turn, r = velocity.vx, velocity.vy, self.reach * velocity.wz, self.radius
        return ((vx - vy - turn) / r, (vx + vy + turn) / r, (vx + vy - turn) / r, (vx - vy + turn) / r)

    def motion(self, steps: F64, turn_scale: float = 1.0) -> F64:
        fl, fr, rl, rr = steps * (0.25 * self.radius)
        return np.array([fl + fr + rl + rr, fr + rl - fl - rr, (fr + rr - fl - rl) / (self.reach * turn_scale)])


@dataclass(frozen=True, slots=True)
class Legs:
    """Steps forward, sideways and around, counted by the legs' own kinematics."""

    parts: int = 3

    def rates(self, velocity: BodyVelocity) -> tuple[float, ...]:
        return (velocity.vx, velocity.vy, velocity.wz)

    def motion(self, steps: F64, turn_scale: float = 1.0) -> F64:
        return steps * [1.0, 1.0, turn_scale]


def drive_of(robot: SimRobot) -> Drive:
    """Return the drive of a robot."""
    if robot.has_two_wheels:
        return TwoWheels(robot.wheel_radius, robot.track)
    if robot.has_mecanum_wheels:
        return MecanumWheels(robot.wheel_radius, 0.5 * (robot.track + robot.wheel_base))
    return Legs()


def after_strafe_loss(robot: SimRobot, velocity: BodyVelocity) -> BodyVelocity:
    """Return how the base moves when its wheels turn for `velocity`: rollers lose a part of the way sideways."""
    return BodyVelocity(velocity.vx, velocity.vy * (1.0 - robot.strafe_loss), velocity.wz)
