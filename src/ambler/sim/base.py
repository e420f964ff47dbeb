"""What moves the robot: the base's own controller (limits, watchdog) and the Protocol of the physics under it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ambler.core.protocols import BodyVelocity
from ambler.core.robot import VelocityLimits
from ambler.core.se2 import SE2
from ambler.sim.sim_robot import SimRobot


@dataclass(frozen=True)
class PlacedRobot:
    """A robot that the physics shall move: the name that others touch it by, and where it starts."""

    name: str
    robot: SimRobot
    start: SE2


@dataclass(frozen=True, slots=True)
class Touch:
    """A contact in the world: names of the robot's part and of the solid (or of the other robot), place, speed of the robot there,
    force."""

    part: str
    solid: str
    position: tuple[float, float, float]
    speed: float
    force: float


@dataclass(frozen=True, slots=True)
class Carriage:
    """State of the moving base without its gait: position and quaternion (wxyz) in the world."""

    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float]

    def to_se2(self) -> SE2:
        w, x, y, z = self.rotation
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return SE2(self.position[0], self.position[1], yaw)


class Physics(Protocol):
    """Moves the bases of all robots of a world at once, in the order in which they were placed."""

    def step(self, targets: Sequence[BodyVelocity]) -> None:
        """Advance by one physics step with the wanted body velocities."""
        ...

    def carriage(self, robot: int) -> Carriage: ...

    def travel(self, robot: int) -> tuple[float, ...]:
        """What the base's own encoders (or legs) have counted, in the order of the robot's `sim.drive`."""
        ...

    def move(self, places: Sequence[tuple[float, float]]) -> None:
        """Put doors to where they are now, and let people head for where they want to be: everything that moves by itself, always in the
        same order, people first."""
        ...

    def people(self) -> Sequence[tuple[float, float]]:
        """Where people are: robots are in their way, too."""
        ...

    def touches(self, robot: int) -> tuple[Touch, ...]:
        """Contacts of a robot during the last step, with anything but the ground."""
        ...


class BaseController:
    """Turns commands into a velocity that respects the base's limits and accelerations; stops without fresh commands.

    It slows down as hard as the base can: whoever wants to brake gently asks for less and less, as the velocity gate does.
    """

    def __init__(self, limits: VelocityLimits, watchdog: float) -> None:
        self._limits = limits
        self._watchdog_ns = int(watchdog * 1e9)
        self._command = BodyVelocity()
        self._command_ns = -(1 << 62)
        self._velocity = BodyVelocity()

    def command(self, command: BodyVelocity, now_ns: int) -> None:
        """Take a new command, clipped to the limits; anything that is not finite is taken as a stop."""
        lim = self._limits
        if not all(math.isfinite(v) for v in (command.vx, command.vy, command.wz)):
            command = BodyVelocity()
        self._command = BodyVelocity(
            min(max(command.vx, lim.vx_min), lim.vx_max),
            min(max(command.vy, -lim.vy_max), lim.vy_max),
            min(max(command.wz, -lim.wz_max), lim.wz_max),
        )
        self._command_ns = now_ns

    def update(self, now_ns: int, dt: float) -> BodyVelocity:
        """Return the velocity wanted for the next `dt` seconds."""
        wanted = self._command if now_ns - self._command_ns <= self._watchdog_ns else BodyVelocity()
        lim, v = self._limits, self._velocity
        self._velocity = BodyVelocity(
            _approach(v.vx, wanted.vx, lim.ax_max * dt, max(lim.ax_brake, lim.ax_stop) * dt),
            _approach(v.vy, wanted.vy, lim.ay_max * dt, max(lim.ay_brake, lim.ay_stop) * dt),
            _approach(v.wz, wanted.wz, lim.az_max * dt, lim.az_max * dt),
        )
        return self._velocity


def _approach(value: float, target: float, gain: float, brake: float) -> float:
    step = gain if abs(target) > abs(value) and target * value >= 0 else brake
    return min(max(target, value - step), value + step)
