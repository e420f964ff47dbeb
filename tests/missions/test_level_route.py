"""Goals on other levels: through passages, with patience there, and by name where it fails; on the bus in lockstep with a robot that drives by magic."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ambler.core.messages import GroundLevels
from ambler.core.se2 import SE2
from ambler.missions.level_route import LevelRoute, Look, RouteFailed, ToGoal, ToPassage, next_level
from ambler.nodes.level_navigator import LevelNavigatorNode
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import GoalHandle, Node, TaskOutcome
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    CHOOSE_LEVEL,
    NAVIGATE,
    NAVIGATE_LEVELS,
    LevelRequest,
    NavigateGoal,
    NavigateLevelsGoal,
    NavigateResult,
    Nothing,
)
from ambler.runtime.topics import GROUND_LEVELS

# A chain of levels 0 - 1 - 2, and 3 that nobody gets to.
PASSAGES = np.array(
    [
        [0.0, 1.0, 5.0, 1.0, 0.0],
        [1.0, 0.0, 5.0, 1.0, 0.0],
        [1.0, 2.0, 9.0, 2.0, 0.0],
        [2.0, 1.0, 9.0, 2.0, 0.0],
    ]
)
GOAL = SE2(3.0, 4.0, 1.0)


def on(level: int) -> GroundLevels:
    return GroundLevels(0, "map", level, 4, PASSAGES)


def test_the_way_between_levels_has_the_fewest_passages():
    assert next_level(PASSAGES, 0, 2) == 1
    assert next_level(PASSAGES, 2, 0) == 1
    assert next_level(PASSAGES, 1, 2) == 2
    assert next_level(PASSAGES, 0, 3) is None
    direct = np.vstack([PASSAGES, [0.0, 2.0, 1.0, 1.0, 0.0]])
    assert next_level(direct, 0, 2) == 2


def test_a_route_goes_through_passages_and_then_to_the_goal():
    route = LevelRoute(2)
    assert route.begin(on(0)) == ToPassage(1, SE2(5.0, 1.0, 0.0))
    assert isinstance(route.came_to(), Look)
    assert route.looked(on(1)) == ToPassage(2, SE2(9.0, 2.0, 0.0))
    assert route.looked(on(2)) == ToGoal()


def test_a_passage_that_does_not_lead_on_is_given_up_after_three_tries():
    route = LevelRoute(1)
    legs = []
    for _ in range(3):
        route.passage_ended()
        legs.append(route.looked(on(0)))
    assert [type(leg) for leg in legs] == [ToPassage, ToPassage, RouteFailed]
    assert legs[-1].code == "LEVEL_NOT_REACHED"
    route.came_to()
    assert route.looked(on(0)) == ToPassage(1, SE2(5.0, 1.0, 0.0)), "another level is another count"


@pytest.mark.parametrize(("level", "levels"), [(3, on(0)), (7, on(0)), (0, None)])
def test_where_no_way_is_known_it_says_so(level, levels):
    leg = LevelRoute(level).begin(levels)
    assert isinstance(leg, RouteFailed)
    assert leg.code == "NO_PASSAGE"


class MagicRobot(Node):
    """Drives anywhere in a second; who comes to a passage after a level was chosen is on it half a second later, unless the robot `is_stuck`."""

    name = "magic_robot"
    outputs = (GROUND_LEVELS,)
    serves = (NAVIGATE, CHOOSE_LEVEL)

    def __init__(self, outcome: str = "SUCCEEDED", *, is_stuck: bool = False) -> None:
        self.level, self.wanted, self.outcome, self.is_stuck = 0, 0, outcome, is_stuck
        self.drives: list[tuple[int, NavigateGoal]] = []

    def start(self) -> None:
        self.ctx.serve_task(NAVIGATE, self._on_goal, lambda handle: handle.cancelled())
        self.ctx.serve(CHOOSE_LEVEL, self._choose)
        self._tell()

    def _tell(self) -> None:
        self.ctx.publish(GROUND_LEVELS, on(self.level))

    def _choose(self, request: LevelRequest) -> Nothing:
        self.wanted = request.level
        return Nothing()

    def _on_goal(self, handle: GoalHandle[Any, Any, Any]) -> None:
        self.drives.append((self.level, handle.goal))
        self.ctx.after(1.0, lambda: self._arrive(handle))

    def _arrive(self, handle: GoalHandle[Any, Any, Any]) -> None:
        if handle.goal.map_from_goal == GOAL and self.outcome != "SUCCEEDED":
            handle.fail(self.outcome, "no luck")
        else:
            handle.succeed(NavigateResult(handle.goal.map_from_goal, 0.0, 0))
        if self.wanted != self.level and not self.is_stuck and handle.goal.map_from_goal != GOAL:
            self.ctx.after(0.5, self._climb)

    def _climb(self) -> None:
        self.level = self.wanted
        self._tell()


def driven(robot: MagicRobot, goal: NavigateLevelsGoal, seconds: float = 40.0) -> TaskOutcome[Any]:
    with LockstepExecutor(Stack([robot, LevelNavigatorNode()])) as executor:
        executor.run(0.1)
        ticket = executor.send_goal(NAVIGATE_LEVELS, goal)
        executor.run(seconds)
        return ticket.outcome.result(timeout=1.0)


def test_on_the_bus_a_goal_two_levels_up_is_reached_on_its_level():
    robot = MagicRobot()
    end = driven(robot, NavigateLevelsGoal(GOAL, 2, 0.1, 0.3))
    assert (end.code, end.result.map_from_base) == ("SUCCEEDED", GOAL)
    assert [(level, goal.map_from_goal.x) for level, goal in robot.drives] == [(0, 5.0), (1, 9.0), (2, 3.0)]
    assert (robot.drives[-1][1].xy_tolerance, robot.drives[-1][1].yaw_tolerance) == (0.1, 0.3)


def test_on_the_bus_failures_have_their_names():
    assert driven(MagicRobot("NO_VALID_PATH"), NavigateLevelsGoal(GOAL, 1)).code == "NO_VALID_PATH"
    assert driven(MagicRobot(is_stuck=True), NavigateLevelsGoal(GOAL, 1)).code == "LEVEL_NOT_REACHED"
    assert driven(MagicRobot(), NavigateLevelsGoal(GOAL, 3)).code == "NO_PASSAGE"
