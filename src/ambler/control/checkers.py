"""Judges of a drive: has it reached its goal, and does it still get anywhere."""

from __future__ import annotations

import math

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2, wrap_angle

TURNED_AWAY = 0.05  # metres by which turning on the spot may move a base off


class GoalChecker:
    """Says when a goal is reached: position once, heading, and at rest.

    The position is remembered once it was within its tolerance, so that turning on the spot cannot lose it again; it does not
    count while more than `path_tolerance` metres of path are left, so that a loop through its own goal is driven to its end.
    """

    def __init__(
        self, xy_tolerance: float, yaw_tolerance: float, path_tolerance: float = 1.0, rest_speed: float = 0.1
    ) -> None:
        self._xy_tolerance = xy_tolerance
        self._yaw_tolerance = yaw_tolerance
        self._path_tolerance = path_tolerance
        self._rest_speed = rest_speed
        self.is_position_reached = False
        self.may_stop = False
        """Within both tolerances: only rest is missing."""

    def update(self, odom_from_base: SE2, odom_from_goal: SE2, velocity: BodyVelocity, path_left: float) -> bool:
        """Return whether the goal is reached."""
        away = odom_from_base.distance_to(odom_from_goal)
        if away <= self._xy_tolerance and path_left <= self._path_tolerance:
            self.is_position_reached = True
        elif away > self._xy_tolerance + TURNED_AWAY:
            self.is_position_reached = False
        yaw_error = abs(wrap_angle(odom_from_goal.yaw - odom_from_base.yaw))
        is_at_rest = math.hypot(velocity.vx, velocity.vy) + abs(velocity.wz) <= self._rest_speed
        self.may_stop = self.is_position_reached and yaw_error <= self._yaw_tolerance
        return self.may_stop and is_at_rest


class ProgressChecker:
    """Says when the robot has stayed within a circle, and a sector of heading, for too long."""

    def __init__(self, radius: float = 0.5, angle: float = 0.5, patience: float = 10.0) -> None:
        self._radius = radius
        self._angle = angle
        self._patience_ns = round(patience * 1e9)
        self._anchor: SE2 | None = None
        self._since_ns = 0

    def update(self, now_ns: int, odom_from_base: SE2) -> bool:
        """Return whether the robot still makes progress. The first pose starts the clock."""
        anchor = self._anchor
        if (
            anchor is None
            or anchor.distance_to(odom_from_base) > self._radius
            or abs(wrap_angle(anchor.yaw - odom_from_base.yaw)) > self._angle
        ):
            self._anchor, self._since_ns = odom_from_base, now_ns
            return True
        return now_ns - self._since_ns <= self._patience_ns


class StallChecker:
    """Says when a robot that is told to move, and let through, does not: something holds it that no sensor shows, such as glass or a low kerb's end.

    Within `patience` seconds it must have moved `share` of what a base with its `acceleration` (m/s²) does that obeys from rest; where that one is slower than
    `slow` (m/s), as when it is told now this and now the opposite, nothing is asked. What counts is how it moved along with that one: a robot that is held trembles, and
    slides to the side.
    """

    def __init__(self, acceleration: float, share: float = 0.2, patience: float = 1.0, slow: float = 0.1) -> None:
        self._acceleration, self._share, self._patience, self._slow = acceleration, share, patience, slow
        self._able = (0.0, 0.0)
        self._last_ns: int | None = None
        self._seconds = self._told = self._moved = 0.0

    def update(self, now_ns: int, told: BodyVelocity, has: BodyVelocity) -> bool:
        """Take the velocities that the base is told and has; return whether it obeys."""
        since, self._last_ns = 0.0 if self._last_ns is None else (now_ns - self._last_ns) * 1e-9, now_ns
        x, y = self._able
        missing = math.hypot(told.vx - x, told.vy - y)
        step = min(1.0, self._acceleration * since / missing) if missing > 0.0 else 0.0
        x, y = self._able = x + step * (told.vx - x), y + step * (told.vy - y)
        able = math.hypot(x, y)
        if able < self._slow:
            self._seconds = self._told = self._moved = 0.0
            return True
        self._seconds, self._told, self._moved = (
            self._seconds + since,
            self._told + able * since,
            self._moved + (has.vx * x + has.vy * y) / able * since,
        )
        if self._seconds < self._patience:
            return True
        obeys = self._moved >= self._share * self._told
        self._seconds = self._told = self._moved = 0.0
        return obeys
