"""Goals on any level of a map of ground, on the bus: NAVIGATE_LEVELS in; NAVIGATE and CHOOSE_LEVEL out."""

from __future__ import annotations

import math
from typing import Any

from ambler.core.messages import GroundLevels
from ambler.missions.level_route import LevelRoute, LevelRouteConfig, Look, RouteFailed, ToGoal, ToPassage
from ambler.runtime.node import GoalHandle, GoalTicket, Node, TaskOutcome, Topics
from ambler.runtime.tasks import (
    CHOOSE_LEVEL,
    NAVIGATE,
    NAVIGATE_LEVELS,
    LevelRequest,
    NavigateFeedback,
    NavigateGoal,
    NavigateLevelsGoal,
    NavigateResult,
    Nothing,
)
from ambler.runtime.topics import GROUND_LEVELS

Handle = GoalHandle[NavigateLevelsGoal, NavigateFeedback, NavigateResult]


class LevelNavigatorNode(Node):
    """Carries out one `LevelRoute` at a time; a new goal preempts the old one. What ends the last drive ends the goal."""

    name = "level_navigator"
    inputs: Topics = (GROUND_LEVELS,)
    serves = (NAVIGATE_LEVELS,)
    calls = (NAVIGATE, CHOOSE_LEVEL)
    latency = 0.001

    def __init__(self, config: LevelRouteConfig | None = None) -> None:
        self._config = config
        self._levels: GroundLevels | None = None
        self._handle: Handle | None = None
        self._route = LevelRoute(0, config)
        self._ticket: GoalTicket | None = None
        self._leg = 0  # answers to an earlier leg are void

    def start(self) -> None:
        """Subscribe and serve."""
        self.ctx.subscribe(GROUND_LEVELS, self._on_levels)
        self.ctx.serve_task(NAVIGATE_LEVELS, self._on_goal, self._on_cancel)

    def _on_levels(self, levels: GroundLevels) -> None:
        before, self._levels = self._levels, levels
        if self._handle is not None and before is not None and before.active != levels.active:
            self.ctx.log("LEVEL_REACHED", f"from level {before.active} to level {levels.active}")
            self._stop()
            self._carry_out(self._route.came_to())

    def _on_goal(self, handle: Handle) -> None:
        self._stop()
        self._handle = handle
        self._route = LevelRoute(handle.goal.level, self._config)
        self._carry_out(self._route.begin(self._levels))

    def _on_cancel(self, handle: Handle) -> None:
        if handle is self._handle:
            self._stop()
            self._handle = None
            handle.cancelled()

    def _stop(self) -> None:
        """Void what is under way."""
        self._leg += 1
        if self._ticket is not None:
            ticket, self._ticket = self._ticket, None
            ticket.cancel()

    def _carry_out(self, leg: ToPassage | ToGoal | Look | RouteFailed) -> None:
        handle = self._handle
        if handle is None:
            return
        self._leg += 1
        number, goal = self._leg, handle.goal
        match leg:
            case ToPassage():
                self.ctx.call(CHOOSE_LEVEL, LevelRequest(leg.level), self._on_chosen)
                there = NavigateGoal(leg.place, self._route.config.tolerance, math.pi)
                self._ticket = self.ctx.send_goal(
                    NAVIGATE, there, lambda outcome: self._on_passage(number, outcome), handle.feedback
                )
            case ToGoal():
                there = NavigateGoal(goal.map_from_goal, goal.xy_tolerance, goal.yaw_tolerance)
                self._ticket = self.ctx.send_goal(
                    NAVIGATE, there, lambda outcome: self._on_there(number, outcome), handle.feedback
                )
            case Look():
                self.ctx.after(leg.seconds, lambda: self._look(number))
            case RouteFailed():
                self._handle = None
                handle.fail(leg.code, leg.text)

    def _on_chosen(self, reply: Nothing | Exception) -> None:
        if isinstance(reply, Exception):
            self.ctx.log("LEVEL_REFUSED", str(reply))

    def _on_passage(self, number: int, outcome: TaskOutcome[Any]) -> None:
        if number != self._leg:
            return
        self._ticket = None
        if outcome.code == "PREEMPTED":  # a person drives
            self._end(outcome)
        else:
            self._carry_out(self._route.passage_ended())

    def _on_there(self, number: int, outcome: TaskOutcome[NavigateResult]) -> None:
        if number == self._leg:
            self._ticket = None
            self._end(outcome)

    def _end(self, outcome: TaskOutcome[NavigateResult]) -> None:
        handle, self._handle = self._handle, None
        if handle is not None:
            handle.end(outcome)

    def _look(self, number: int) -> None:
        if number == self._leg and self._levels is not None:
            self._carry_out(self._route.looked(self._levels))
