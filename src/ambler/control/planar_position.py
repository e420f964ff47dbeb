"""Position control of an omnidirectional base for the last metre before a dock: P, PD or PID on x, y and yaw in the dock's frame.

After the planar controller of source 002 (§4.6) and what it wished for: smoother velocities by a derivative and an integral. First
the heading, then both axes while the heading is held; going in waits until the robot is on the dock's line, within a funnel. Every
axis slows down so that it can stop at its target. Inflated costs are ignored on purpose; the velocity gate still watches.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2, wrap_angle
from ambler.core.units import Radians

F64 = NDArray[np.float64]
Axes = tuple[float, float, float]


class Law(enum.Enum):
    """Which parts the controller has."""

    P = "p"
    PD = "pd"
    PID = "pid"


class PlanarPhase(enum.Enum):
    """What the controller is doing."""

    ROTATING = "rotating"
    MOVING = "moving"
    HOLDING = "holding"


@dataclass(frozen=True, slots=True)
class PlanarConfig:
    """Gains and limits per axis (x, y, yaw), SI.

    p (1/s), d (share of the measured velocity that is taken off), i (1/s^2; it acts within `i_zone` of the target and gives at
    most `i_most`); speed, acceleration and braking limits; `reaction_time` from measurement to motion. `rotate_start`, `rotate_end`:
    heading errors (rad) at which turning first begins and ends. `funnel`: how far beside its line the robot may be per metre
    before the target, and `funnel_end` at the target (m). `tolerance`: where an axis is at its target; `creep`: slowest motion
    commanded outside of it, above the dead band of the drives.
    """

    law: Law = Law.PD
    p: Axes = (1.6, 1.8, 2.0)
    d: Axes = (0.15, 0.15, 0.15)
    i: Axes = (0.3, 0.3, 0.3)
    i_zone: Axes = (0.04, 0.04, math.radians(2.0))
    i_most: Axes = (0.02, 0.02, 0.03)
    speed: Axes = (0.3, 0.2, 0.5)
    acceleration: Axes = (0.5, 0.5, 1.0)
    braking: Axes = (0.5, 0.5, 1.0)
    reaction_time: float = 0.12
    rotate_start: Radians = math.radians(6.0)
    rotate_end: Radians = math.radians(1.0)
    funnel: float = 0.12
    funnel_end: float = 0.004
    tolerance: Axes = (0.002, 0.001, math.radians(0.05))
    creep: Axes = (0.012, 0.008, 0.008)


@dataclass(frozen=True, slots=True)
class PlanarStep:
    """One output: the velocity of the base, what the controller is doing, and the errors (x, y, yaw) to the target in its frame."""

    velocity: BodyVelocity
    phase: PlanarPhase
    error: Axes

    @property
    def is_reached(self) -> bool:
        """All axes are within their tolerances."""
        return self.phase is PlanarPhase.HOLDING


class PlanarPositionController:
    """Moves the base to a target pose. `reset` begins anew, from a stand."""

    def __init__(self, config: PlanarConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget integrals, the last command and the phase."""
        self._integral = np.zeros(3)
        self._last = np.zeros(3)
        self._is_rotating = False

    def compute_command(
        self,
        base_from_target: SE2,
        velocity: BodyVelocity,
        dt: float,
        may_turn: Callable[[float], bool] | None = None,
        speed_share: float = 1.0,
    ) -> PlanarStep:
        """Return the command for the next `dt` seconds. `velocity` is the measured one. `may_turn(angle)` says whether the footprint can
        turn in place by so much; where it cannot, all axes move at once. `speed_share` lowers the limits of speed."""
        c = self.config
        target_from_base = base_from_target.inverse()
        error = np.array([-target_from_base.x, -target_from_base.y, -wrap_angle(target_from_base.yaw)])
        if not np.isfinite(error).all() or dt <= 0.0:
            raise ValueError("a target and a period must be numbers, the period positive")
        turn = SE2(0.0, 0.0, target_from_base.yaw)
        moving = np.array([*turn.transform(np.array([[velocity.vx, velocity.vy]]))[0], velocity.wz])
        is_near = np.abs(error) <= c.tolerance
        if is_near.all():
            self._is_rotating = False
            return self._finish(np.zeros(3), turn, dt, PlanarPhase.HOLDING, error)
        can_turn = may_turn is None or may_turn(float(error[2]))
        self._is_rotating = can_turn and abs(error[2]) > (c.rotate_end if self._is_rotating else c.rotate_start)
        wanted = self._law(error, moving, is_near, dt)
        top = np.array(c.speed) * np.clip(speed_share, 0.05, 1.0)
        wanted = np.clip(wanted, -top, top)
        if self._is_rotating:
            wanted[:2] = 0.0
            return self._finish(wanted, turn, dt, PlanarPhase.ROTATING, error)
        wanted[0] *= self._funnel(error)
        return self._finish(wanted, turn, dt, PlanarPhase.MOVING, error)

    def _law(self, error: F64, moving: F64, is_near: NDArray[np.bool_], dt: float) -> F64:
        c = self.config
        p, d, braking = np.array(c.p), np.array(c.d), np.array(c.braking)
        lost = 0.7 * braking * c.reaction_time
        profile = np.sqrt(lost**2 + 1.4 * braking * np.abs(error)) - lost
        wanted = np.sign(error) * np.minimum(p * np.abs(error), profile)
        if c.law is not Law.P:
            slower = d * moving
            # A derivative brakes, it never drives the robot away from its target.
            wanted = np.where(
                np.sign(slower) == np.sign(error), wanted - np.clip(slower, -np.abs(wanted), np.abs(wanted)), wanted
            )
        if c.law is Law.PID:
            is_in_zone = np.abs(error) < c.i_zone
            has_crossed = np.sign(self._integral) * np.sign(error) < 0.0
            self._integral = np.where(is_in_zone & ~has_crossed, self._integral + np.array(c.i) * error * dt, 0.0)
            most = np.array(c.i_most)
            self._integral = np.clip(self._integral, -most, most)
            wanted = wanted + self._integral
        creep = np.array(c.creep)
        is_too_slow = ~is_near & (np.abs(wanted) < creep)
        wanted = np.where(is_too_slow, np.sign(error) * np.minimum(creep, 0.5 * np.abs(error) / dt), wanted)
        return np.asarray(np.where(is_near, 0.0, wanted))

    def _funnel(self, error: F64) -> float:
        """Return the share 0..1 of the speed along x: none while the robot is far beside its line and near the target."""
        c = self.config
        width = c.funnel_end + c.funnel * abs(float(error[0]))
        beside = abs(float(error[1])) / width
        askew = abs(float(error[2])) / (c.rotate_end + 0.5 * c.funnel * abs(float(error[0])))
        return float(np.clip(2.0 - max(beside, askew), 0.0, 1.0)) if error[0] > 0.0 else 1.0

    def _finish(self, wanted: F64, turn: SE2, dt: float, phase: PlanarPhase, error: F64) -> PlanarStep:
        """Limit accelerations, in the target's frame, and turn the command into the base frame."""
        c = self.config
        is_slower = np.abs(wanted) < np.abs(self._last)
        most = np.where(is_slower | (wanted * self._last < 0.0), c.braking, c.acceleration) * dt
        self._last = self._last + np.clip(wanted - self._last, -most, most)
        vx, vy = turn.inverse().transform(self._last[None, :2])[0]
        command = BodyVelocity(float(vx), float(vy), float(self._last[2]))
        return PlanarStep(command, phase, (float(error[0]), float(error[1]), float(error[2])))
