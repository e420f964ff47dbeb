"""A goal at which the robot cannot turn to the heading that is asked for: slide to a place with room, turn there, slide to the goal.

Whoever parks a long robot does so. The plan is the shortest one whose first slide is straight, along any direction for a base that
moves sideways, along its own axis for one that does not; what is free is asked of the filled footprint on the local costmap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ambler.control.config import RolloutConfig
from ambler.control.local_window import LocalWindow
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel
from ambler.core.se2 import SE2, wrap_angle

STEP = 0.05  # metres between the places that are tried
ASIDE = 0.04  # metres that a base without sideways motion may miss the goal by
THERE = 0.02  # metres at which a slide is over
YAW_GAIN, YAW_RATE = 1.5, 0.3  # how a heading is held while sliding, 1/s and rad/s


@dataclass(frozen=True, slots=True)
class TurnPlan:
    """`place` is where the robot turns, with the heading it has until then; `goal` is where it slides to afterwards."""

    place: SE2
    goal: SE2


class GoalTurn:
    """Plans such a manoeuvre and says the velocity of its slides; the turn between them is the local planner's own."""

    def __init__(self, config: RolloutConfig, robot: RobotModel, window: LocalWindow) -> None:
        self._config = config
        self._limits = robot.limits
        self._is_omni = robot.drive is DriveKind.OMNI and robot.limits.vy_max > 0.0
        self._window = window
        self._plan: TurnPlan | None = None
        self._is_out = self._is_turned = False

    @property
    def is_active(self) -> bool:
        """Whether a manoeuvre is under way."""
        return self._plan is not None

    @property
    def wants_turn(self) -> bool:
        """Whether the robot stands where it shall turn now."""
        return self._plan is not None and self._is_out and not self._is_turned

    def reset(self) -> None:
        """Forget the manoeuvre."""
        self._plan = None
        self._is_out = self._is_turned = False

    def begin(self, start: SE2, goal: SE2) -> bool:
        """Plan from `start` to `goal` (both in the odom frame); returns whether there is a way."""
        self.reset()
        error = wrap_angle(goal.yaw - start.yaw)
        directions = np.arange(16) * math.pi / 8.0 if self._is_omni else np.array([0.0, math.pi])
        best = math.inf
        for direction in start.yaw + directions:
            free = self._window.free_slide(start, float(direction), self._config.escape_length)
            for away in np.arange(1, int(free / STEP + 1e-9) + 1) * STEP:
                place = SE2(start.x + away * math.cos(direction), start.y + away * math.sin(direction), start.yaw)
                length = away + place.distance_to(goal)
                if length >= best:
                    continue
                if self._can_turn(place, error) and self._can_slide(SE2(place.x, place.y, goal.yaw), goal):
                    best, self._plan = length, TurnPlan(place, goal)
                    break
        return self.is_active

    def turned(self) -> None:
        """Say that the robot has its heading: it may slide to the goal now."""
        self._is_turned = True

    def slide(self, here: SE2) -> BodyVelocity | None:
        """Return the velocity of the slide that is due; None when it is not free any more. A slide that is over ends itself: then the
        turn is due (`wants_turn`), or nothing (`is_active` is False)."""
        plan = self._plan
        if plan is None:
            return None
        target = plan.goal if self._is_turned else plan.place
        offset = here.inverse() @ target
        left = abs(offset.x) if not self._is_omni else math.hypot(offset.x, offset.y)
        if left <= THERE and self._is_turned:
            self.reset()
            return BodyVelocity()
        if left <= THERE:
            self._is_out = True
            return BodyVelocity()
        unit = (math.copysign(1.0, offset.x), 0.0) if not self._is_omni else (offset.x / left, offset.y / left)
        heading = here.yaw + math.atan2(unit[1], unit[0])
        if self._window.free_slide(here, heading, left) < left - STEP:
            return None
        speed = max(self._config.speed_min, min(self._config.escape_speed, left))
        wz = min(YAW_RATE, max(-YAW_RATE, YAW_GAIN * offset.yaw))
        return BodyVelocity(speed * unit[0], speed * unit[1], wz)

    def _can_turn(self, place: SE2, error: float) -> bool:
        turns = (error, error - math.copysign(2.0 * math.pi, error))
        return any(abs(self._window.free_turn(place, turn)) >= abs(turn) - 1e-9 for turn in turns)

    def _can_slide(self, turned: SE2, goal: SE2) -> bool:
        offset = turned.inverse() @ goal
        if not self._is_omni and abs(offset.y) > ASIDE:
            return False
        length = turned.distance_to(goal)
        if length <= THERE:
            return True
        heading = math.atan2(goal.y - turned.y, goal.x - turned.x)
        return self._window.free_slide(turned, heading, length) >= length - 1e-9
