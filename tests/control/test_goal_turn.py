"""Goals at which a robot can stand, but not turn: it slides to a place with room, turns there, and slides to the goal."""

import math

import numpy as np
import pytest

from ambler.control.config import RolloutConfig
from ambler.control.goal_turn import GoalTurn
from ambler.control.local_window import LocalWindow
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.core.errors import NoValidControlError
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2, wrap_angle
from tests.control.closed_loop import DIFF, SPOT, Drive, World, drive, line


def alcove(width: float, depth: float = 1.4) -> World:
    """A room of 3 m, on whose right side (x from 1.5 m) a dead end opens that is as wide as told."""
    world = World()
    half = 0.5 * width
    world.block(-1.6, -1.6, 1.5, -1.5).block(-1.6, 1.5, 1.5, 1.6).block(-1.6, -1.6, -1.5, 1.6)
    world.block(1.5, half, 1.5 + depth, 1.6).block(1.5, -1.6, 1.5 + depth, -half)
    return world.block(1.5 + depth, -1.6, 1.6 + depth, 1.6)


def final(log: Drive) -> SE2:
    return log.poses[-1]


def test_a_long_robot_backs_into_its_goal_which_it_entered_head_first() -> None:
    goal = SE2(1.9, 0.0, math.pi)  # looking out of the alcove, which is narrower than the robot is long
    path = line((0.0, 0.0), (1.9, 0.0), yaw=math.pi)
    log = drive(TrajectoryRollout(RolloutConfig(), SPOT), SPOT, alcove(0.9), path, SE2(), seconds=60.0)
    assert log.is_reached
    assert log.collisions == 0
    assert final(log).distance_to(goal) <= 0.15
    assert abs(wrap_angle(final(log).yaw - goal.yaw)) <= 0.2


def test_the_manoeuvre_is_needed_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(GoalTurn, "begin", lambda self, start, goal: False)
    path = line((0.0, 0.0), (1.9, 0.0), yaw=math.pi)
    with pytest.raises(NoValidControlError, match="room to turn"):
        drive(TrajectoryRollout(RolloutConfig(), SPOT), SPOT, alcove(0.9), path, SE2(), seconds=60.0)


def test_a_closed_cell_without_room_is_said() -> None:
    world = World().block(-0.8, 0.35, 0.8, 0.5).block(-0.8, -0.5, 0.8, -0.35)
    world.block(-0.9, -0.5, -0.75, 0.5).block(0.75, -0.5, 0.9, 0.5)
    path = line((-0.05, 0.0), (0.05, 0.0), yaw=math.pi)
    with pytest.raises(NoValidControlError, match="room to turn"):
        drive(TrajectoryRollout(RolloutConfig(), SPOT), SPOT, world, path, SE2(), seconds=20.0)


def plan_in_clutter(robot: RobotModel, seed: int) -> bool:
    """Check a manoeuvre among random posts by a slow twin that moves in small steps; returns whether one was found."""
    rng = np.random.default_rng(seed)
    world = World()
    for x, y in rng.uniform(-2.0, 2.0, (14, 2)):
        if math.hypot(x, y) > 0.7:
            world.block(float(x), float(y), float(x) + 0.1, float(y) + 0.1)
    start = SE2(0.0, 0.0, float(rng.uniform(-3.0, 3.0)))
    goal = SE2(0.0, 0.0, start.yaw + float(rng.choice([math.pi, 2.0, -2.0])))
    window = LocalWindow(robot, 0.03)
    window.update(*world.window(0.0, 0.0, 5.0))
    turn = GoalTurn(RolloutConfig(), robot, window)
    if world.touches(robot, start) or world.touches(robot, goal) or not turn.begin(start, goal):
        return False
    plan = turn._plan
    assert plan is not None
    error = wrap_angle(goal.yaw - start.yaw)
    ways = []
    for whole in (error, error - math.copysign(2.0 * math.pi, error)):
        turned = [SE2(plan.place.x, plan.place.y, start.yaw + whole * k / 60.0) for k in range(61)]
        ways.append(not any(world.touches(robot, pose) for pose in turned))
    assert any(ways)
    for a, b in ((start, plan.place), (SE2(plan.place.x, plan.place.y, goal.yaw), goal)):
        for share in np.linspace(0.0, 1.0, 40):
            assert not world.touches(robot, SE2(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), a.yaw))
    return True


@pytest.mark.parametrize(("robot", "least"), [(SPOT, 8), (DIFF, 4)], ids=["spot", "diff"])
def test_what_is_planned_is_free_and_something_is_planned(robot: RobotModel, least: int) -> None:
    assert sum(plan_in_clutter(robot, seed) for seed in range(16)) >= least


def test_a_long_robot_gets_out_of_a_dead_end_in_which_it_stands_askew(monkeypatch: pytest.MonkeyPatch) -> None:
    start, path = SE2(3.1, 0.02, 0.2), line((3.1, 0.0), (0.6, 0.0), (0.0, 0.8))

    def log_of() -> Drive:
        return drive(TrajectoryRollout(RolloutConfig(padding=0.05), SPOT), SPOT, alcove(0.98, 2.3), path, start)

    log = log_of()
    assert log.is_reached
    assert log.collisions == 0
    monkeypatch.setattr(TrajectoryRollout, "_glide", lambda self, start, velocity, left: None)
    with pytest.raises(NoValidControlError):  # straight ahead, back or aside alone it does not come out
        log_of()
