"""A goal beside the last one is driven to, by every local planner."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.control.checkers import GoalChecker
from ambler.control.local_planners import local_planner
from ambler.core.grid import GridSpec
from ambler.core.protocols import BodyVelocity, LocalPlanner
from ambler.core.se2 import SE2
from ambler.robots.catalog import robot_model

SPEC = GridSpec(0.05, 120, 120, -3.0, -3.0)
COSTS = np.zeros(SPEC.shape, np.uint8)
PERIOD = 0.05
ASIDE = 0.5 * math.pi  # how the robot stands at its goals, across its way


def drive(planner: LocalPlanner, pose: SE2, goal: tuple[float, float], seconds: float) -> tuple[SE2, bool]:
    """Follow a straight path on free ground; return where the robot is then, and whether the goal counts as reached."""
    count = max(2, round(math.hypot(goal[0] - pose.x, goal[1] - pose.y) / 0.05) + 1)
    heading = math.atan2(goal[1] - pose.y, goal[0] - pose.x)
    path = np.linspace((pose.x, pose.y, heading), (*goal, heading), count)
    path[-1, 2] = ASIDE
    checker, velocity = GoalChecker(0.15, 0.1), BodyVelocity()
    for _ in range(round(seconds / PERIOD)):
        planner.set_path(path)
        left = math.hypot(goal[0] - pose.x, goal[1] - pose.y)
        if checker.update(pose, SE2(*goal, ASIDE), velocity, left):
            return pose, True
        velocity = BodyVelocity() if checker.may_stop else planner.compute_command(COSTS, SPEC, pose, velocity)
        pose = pose @ SE2.exp(np.array([velocity.vx, velocity.vy, velocity.wz]) * PERIOD)
    return pose, False


@pytest.mark.parametrize("name", ["rollout", "dwa", "primitives", "pursuit"])
@pytest.mark.parametrize("nudge", [0.17, 0.22, 0.5])
def test_a_goal_a_little_farther_is_driven_to(name: str, nudge: float) -> None:
    """An operator nudges the robot: what was reached of the last goal says nothing of this one."""
    planner = local_planner(name, robot_model("diff"))
    pose, is_reached = drive(planner, SE2(), (1.0, 0.0), 15.0)
    assert is_reached
    pose, is_reached = drive(planner, pose, (pose.x + nudge, 0.0), 15.0)
    assert is_reached
