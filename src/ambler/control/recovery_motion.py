"""Simple motions that free a robot: turning in place, backing up, and going where it can turn, each simulated on the local costs before it is done."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.control.local_window import LocalWindow
from ambler.control.trajectory_rollout import approach_limit
from ambler.control.way_back import TURN_RATE, WayBack, towards
from ambler.core.errors import ControlError
from ambler.core.grid import GridSpec
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2, wrap_angle

TURN_RATE_MIN, TURN_RATE_MAX = 0.3, 1.0  # rad/s
BACK_SPEED = 0.15  # m/s
REACTION_TIME = 0.15  # s
TURN_FREE_MIN = 0.3  # rad that must be free before a turn begins
ROOM = 0.8  # rad by which a robot can turn one way where there is room to turn
ROOM_STEP = 0.05  # metres between the places at which room is looked for
BACK_FREE_MIN = 0.05  # m that must be free before backing up begins
STRAIGHT_LEAST = 0.8  # of the distance that must be free straight behind for the base not to go back as it came
ALLOWANCE = 5.0  # s beyond the time that the motion should take


class CollisionAheadError(ControlError):
    """The motion would touch something."""

    code = "COLLISION_AHEAD"


class RecoveryTimeoutError(ControlError):
    """The motion took longer than its time allowance."""

    code = "TIMEOUT"


class RecoveryMotion(Protocol):
    """A motion of its own; `compute_command` returns None when it is done."""

    def compute_command(
        self, now_ns: int, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2
    ) -> BodyVelocity | None: ...


class _Clock:
    """Raises when a motion lasts too long."""

    def __init__(self, allowance: float) -> None:
        self._allowance = allowance
        self._start_ns: int | None = None

    def check(self, now_ns: int) -> None:
        if self._start_ns is None:
            self._start_ns = now_ns
        if now_ns - self._start_ns > self._allowance * 1e9:
            raise RecoveryTimeoutError(f"not done after {self._allowance:.0f} s")


class TurnInPlace:
    """Turns by an angle; the sign of `amount` is only a wish, it turns the other way when there is more room."""

    def __init__(self, robot: RobotModel, amount: float, padding: float) -> None:
        self._limits = robot.limits
        self._window = LocalWindow(robot, padding)
        self._amount = amount
        self._sign = 0.0
        self._turned = 0.0
        self._last_yaw: float | None = None
        self._has_turned_back = False
        self._clock = _Clock(abs(amount) / TURN_RATE_MIN + ALLOWANCE)

    def compute_command(
        self, now_ns: int, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2
    ) -> BodyVelocity | None:
        """Return the next velocity, or None when done; raises CollisionAheadError or RecoveryTimeoutError."""
        self._clock.check(now_ns)
        self._window.update(costs, spec)
        if self._last_yaw is None:
            self._choose_direction(odom_from_base)
        else:
            self._turned += self._sign * wrap_angle(odom_from_base.yaw - self._last_yaw)
        self._last_yaw = odom_from_base.yaw
        left = abs(self._amount) - self._turned
        if left <= 0.02:
            return None
        braking = 0.6 * self._limits.az_max
        limit = approach_limit(left, braking, REACTION_TIME)
        rate = min(TURN_RATE_MAX, self._limits.wz_max, max(TURN_RATE_MIN, limit))
        reach = min(left, rate * REACTION_TIME + rate * rate / (2.0 * braking) + 0.05)
        if abs(self._window.free_turn(odom_from_base, self._sign * reach)) < reach - 1e-9:
            raise CollisionAheadError("turning further would touch something")
        return BodyVelocity(0.0, 0.0, self._sign * rate)

    def turn_back(self) -> bool:
        """Try the other direction, once; returns False when that was done before."""
        if self._has_turned_back or self._sign == 0.0:
            return False
        self._has_turned_back = True
        self._sign, self._turned = -self._sign, 0.0
        return True

    def _choose_direction(self, odom_from_base: SE2) -> None:
        wish = math.copysign(1.0, self._amount)
        room = {sign: abs(self._window.free_turn(odom_from_base, sign * abs(self._amount))) for sign in (wish, -wish)}
        self._sign = wish if room[wish] >= room[-wish] else -wish
        if room[self._sign] < min(TURN_FREE_MIN, abs(self._amount)):
            raise CollisionAheadError("there is no room to turn in place")


class BackUp:
    """Backs up by a distance, or by what is free of it: straight, or, where little of that is free, along the way that the base has come (`way_back`) as far as that is known and still free."""

    def __init__(self, robot: RobotModel, amount: float, padding: float, way_back: WayBack | None = None) -> None:
        self._limits = robot.limits
        self._window = LocalWindow(robot, padding)
        self._amount = abs(amount)
        self._way_back = WayBack() if way_back is None else way_back
        self._last: SE2 | None = None
        self._moved = 0.0
        self._goes_straight = True
        turns = math.pi / TURN_RATE  # belong to a way back
        self._clock = _Clock(self._amount / BACK_SPEED * 1.5 + ALLOWANCE + turns)

    def compute_command(
        self, now_ns: int, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2
    ) -> BodyVelocity | None:
        """Return the next velocity, or None when done; raises CollisionAheadError or RecoveryTimeoutError."""
        self._clock.check(now_ns)
        self._window.update(costs, spec)
        if self._last is None:
            self._goes_straight = self._free_behind(odom_from_base, self._amount) >= STRAIGHT_LEAST * self._amount
        else:
            self._moved += self._last.distance_to(odom_from_base)
        self._last = odom_from_base
        left = self._amount - self._moved
        if left <= 0.01:
            return None
        comes_back = not self._goes_straight and self._limits.vx_min < 0.0
        target = self._way_back.target(odom_from_base) if comes_back else None
        if target is not None and self._is_free(odom_from_base, target):
            return towards(odom_from_base, target, BACK_SPEED, self._limits, sideways=self._limits.vy_max > 0.0)
        return self._straight(odom_from_base, left)

    def _is_free(self, odom_from_base: SE2, target: SE2) -> bool:
        """Whether nothing comes under the footprint on the way to a pose that is not there now."""
        there_now = self._window.lethal_cells(odom_from_base)
        between = odom_from_base.inverse() @ target
        steps = [odom_from_base @ SE2(s * between.x, s * between.y, s * between.yaw) for s in (0.34, 0.67, 1.0)]
        return all(self._window.lethal_cells(pose) <= there_now for pose in steps)

    def _free_behind(self, odom_from_base: SE2, most: float) -> float:
        return self._window.free_slide(odom_from_base, odom_from_base.yaw + math.pi, most)

    def _straight(self, odom_from_base: SE2, left: float) -> BodyVelocity | None:
        free = self._free_behind(odom_from_base, left)
        speed = min(BACK_SPEED, -self._limits.vx_min, approach_limit(free, 0.6 * self._limits.ax_brake, REACTION_TIME))
        if speed <= 0.0 or free < min(BACK_FREE_MIN, left - 1e-9):
            if self._moved >= BACK_FREE_MIN:
                return None
            raise CollisionAheadError("there is no room to back up")
        return BodyVelocity(-max(speed, min(0.05, -self._limits.vx_min)), 0.0, 0.0)


class MakeRoom:
    """Goes straight ahead or back, by `amount` metres at most, to the nearest place where the robot can turn. `seen_slide(heading, length)` says how far it may
    slide along a heading of the odom frame, at most `length` metres, through what it has seen to be free."""

    def __init__(
        self, robot: RobotModel, amount: float, padding: float, seen_slide: Callable[[float, float], float]
    ) -> None:
        self._limits = robot.limits
        self._window = LocalWindow(robot, padding)
        self._amount = abs(amount)
        self._seen_slide = seen_slide
        self._begin: SE2 | None = None
        self._way, self._sign = 0.0, 1.0
        self._clock = _Clock(self._amount / BACK_SPEED * 1.5 + ALLOWANCE)

    def compute_command(
        self, now_ns: int, costs: NDArray[np.uint8], spec: GridSpec, odom_from_base: SE2
    ) -> BodyVelocity | None:
        """Return the next velocity, or None when done; raises CollisionAheadError or RecoveryTimeoutError."""
        self._clock.check(now_ns)
        self._window.update(costs, spec)
        if self._begin is None:
            self._way, self._sign = self._nearest_room(odom_from_base)
            self._begin = odom_from_base
        left = self._way - self._sign * (self._begin.inverse() @ odom_from_base).x
        if left <= 0.01:
            return None
        free = self._window.free_slide(odom_from_base, self._heading(odom_from_base, self._sign), left)
        if free < min(BACK_FREE_MIN, left - 1e-9):
            raise CollisionAheadError("something has come to where there was room to turn")
        fastest = min(BACK_SPEED, self._limits.vx_max if self._sign > 0.0 else -self._limits.vx_min)
        speed = min(fastest, approach_limit(free, 0.6 * self._limits.ax_brake, REACTION_TIME))
        return BodyVelocity(self._sign * max(speed, min(0.05, fastest)), 0.0, 0.0)

    def _heading(self, odom_from_base: SE2, sign: float) -> float:
        return odom_from_base.yaw + (0.0 if sign > 0.0 else math.pi)

    def _nearest_room(self, odom_from_base: SE2) -> tuple[float, float]:
        """Return how far away it is, and the sign of the velocity towards it; rather ahead than behind."""
        if self._can_turn(odom_from_base):
            return 0.0, 1.0
        open_signs = [1.0, -1.0] if self._limits.vx_min < 0.0 else [1.0]
        for way in np.arange(ROOM_STEP, self._amount + 1e-9, ROOM_STEP).tolist():
            for sign in tuple(open_signs):
                if self._seen_slide(self._heading(odom_from_base, sign), way) < way - 1e-6:
                    open_signs.remove(sign)
                elif self._can_turn(odom_from_base @ SE2(sign * way, 0.0)):
                    return way, sign
        raise CollisionAheadError("there is no room to turn, neither here nor ahead nor behind")

    def _can_turn(self, odom_from_base: SE2) -> bool:
        return any(abs(self._window.free_turn(odom_from_base, angle)) >= ROOM - 1e-9 for angle in (ROOM, -ROOM))
