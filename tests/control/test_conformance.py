"""What every local planner must do, driven in closed loop. A new planner joins by one line in PLANNERS."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from examples.carrot_planner import CarrotPlanner

from ambler.control.config import RolloutConfig
from ambler.control.dynamic_window import DynamicWindow
from ambler.control.motion_primitives import MotionPrimitives
from ambler.control.omni_pursuit import OmniPursuit
from ambler.control.primitives_config import PrimitivesConfig
from ambler.control.pursuit_config import PursuitConfig
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.core.errors import InvalidPathError, NoValidControlError
from ambler.core.protocols import BodyVelocity, LocalPlanner
from ambler.core.robot import RobotModel, VelocityLimits
from ambler.core.se2 import SE2, wrap_angle
from tests.control.closed_loop import DIFF, ROBOTS, Drive, World, arc, drive, line

Maker = Callable[[RobotModel], LocalPlanner]
PLANNERS: dict[str, Maker] = {
    "rollout": lambda robot: TrajectoryRollout(RolloutConfig(), robot),
    "dwa": lambda robot: DynamicWindow(RolloutConfig(), robot),
    "pursuit": lambda robot: OmniPursuit(PursuitConfig(), robot),
    "primitives": lambda robot: MotionPrimitives(PrimitivesConfig(), robot),
    "carrot": CarrotPlanner,
}
KEEPS_TO_ITS_PATH = {"pursuit", "carrot"}
"""Planners that stop before an obstacle instead of driving around it."""

DOOR = World().block(2.0, -8.0, 2.12, -0.45).block(2.0, 0.45, 2.12, 8.0)
U_TURN = np.vstack(
    (line((0, 0), (3, 0)), [[3 + 0.6 * math.sin(a), 0.6 - 0.6 * math.cos(a), a] for a in np.linspace(0.1, 3.1, 30)], line((3, 1.2), (0, 1.2)))
)  # fmt: skip
CASES: dict[str, tuple[World, np.ndarray, SE2]] = {
    "straight": (World(), line((0, 0), (4, 0)), SE2()),
    "curve": (World(), arc(1.5, 2.5), SE2()),
    "u_turn": (World(), U_TURN, SE2()),
    "goal_behind": (World(), line((0, 0), (-3, 0)), SE2()),
    "goal_beside": (World(), line((0, 0), (0.3, 0.3), yaw=0.0), SE2()),
    "door": (DOOR, line((0, 0), (4, 0)), SE2()),
    "door_from_the_side": (DOOR, line((0.9, -3), (0.9, -0.5), (1.2, -0.1), (1.4, 0), (4, 0), yaw=1.57), SE2(0.9, -3, 1.57)),
    "corner_and_turn": (World(), line((0, 0), (2, 0), (2, 2), yaw=3.1), SE2()),
    "beside_the_path": (World(), line((0, 0), (4, 0)), SE2(0.0, 0.5, 0.0)),
    "obstacle_on_the_path": (World().block(2.0, -0.2, 2.3, 0.1), line((0, 0), (5, 0)), SE2()),
}  # fmt: skip
ALL = [(p, r) for p in PLANNERS for r in ROBOTS]


def length(path: np.ndarray) -> float:
    return float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())


def sign_changes(values: list[float]) -> int:
    signs = [math.copysign(1.0, v) for v in values if abs(v) > 0.05]
    return sum(a != b for a, b in itertools.pairwise(signs))


def stops_before_the_obstacle(local: LocalPlanner, model: RobotModel, world: World, path: np.ndarray) -> None:
    log = Drive()
    with pytest.raises(NoValidControlError):
        drive(local, model, world, path, SE2(), seconds=40.0, log=log)
    assert log.collisions == 0
    front = log.poses[-1].x + model.footprint[:, 0].max()
    assert 1.8 < front < 2.0, "it comes to the obstacle at 2 m and stops"
    assert abs(log.velocities[-1].vx) < 0.1


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("planner", "robot"), ALL)
def test_it_reaches_the_goal_and_touches_nothing(planner: str, robot: str, case: str) -> None:
    world, path, start = CASES[case]
    model = ROBOTS[robot]
    if case == "obstacle_on_the_path" and planner in KEEPS_TO_ITS_PATH:
        stops_before_the_obstacle(PLANNERS[planner](model), model, world, path)
        return
    log: Drive = drive(PLANNERS[planner](model), model, world, path, start, seconds=40.0)
    assert log.is_reached
    assert log.collisions == 0
    end, goal = log.poses[-1], SE2.from_array(path[-1])
    assert end.distance_to(goal) < 0.12
    assert abs(wrap_angle(end.yaw - goal.yaw)) < 0.2
    turns = abs(wrap_angle(start.yaw - path[0, 2])) + abs(wrap_angle(path[-1, 2] - path[-2, 2]))
    assert log.seconds < length(path) / 0.5 + turns / 0.6 + 6.0
    limits = model.limits
    for c in log.commands:
        assert limits.vx_min <= c.vx <= limits.vx_max
        assert abs(c.vy) <= limits.vy_max
        assert abs(c.wz) <= limits.wz_max


@pytest.mark.parametrize(("planner", "robot"), ALL)
@pytest.mark.parametrize("acceleration", [0.3, 3.0])
def test_it_does_not_overshoot_with_weak_or_strong_brakes(planner: str, robot: str, acceleration: float) -> None:
    base = ROBOTS[robot]
    a = acceleration
    limits = VelocityLimits(
        0.8, base.limits.vx_min, base.limits.vy_max, base.limits.wz_max, a, a, max(1.0, a), a, a
    )  # fmt: skip
    model = RobotModel(base.name, base.drive, base.footprint, limits)
    log = drive(PLANNERS[planner](model), model, World(), line((0, 0), (4, 0), yaw=0.0), SE2(), 40.0, 0.05, 0.03)
    assert log.is_reached
    assert max(p.x for p in log.poses) < 4.05
    assert log.poses[-1].distance_to(SE2(4.0, 0.0, 0.0)) < 0.05
    last = [v for p, v in zip(log.poses, log.velocities, strict=True) if p.x > 3.0]
    assert sign_changes([v.vx for v in last]) == 0
    assert sign_changes([v.wz for v in last]) <= 1


@pytest.mark.parametrize(("planner", "robot"), ALL)
def test_it_says_when_it_is_boxed_in(planner: str, robot: str) -> None:
    model = ROBOTS[robot]
    x, y = model.footprint[:, 0].max() + 0.06, model.footprint[:, 1].max() + 0.06
    box = World().block(-x - 0.2, -y - 0.2, -x, y + 0.2).block(x, -y - 0.2, x + 0.2, y + 0.2)
    box.block(-x, -y - 0.2, x, -y).block(-x, y, x, y + 0.2)
    local = PLANNERS[planner](model)
    local.set_path(line((0, 0), (3, 0)))
    costs, spec = box.window(0.0, 0.0, 5.0)
    with pytest.raises(NoValidControlError):
        local.compute_command(costs, spec, SE2(), BodyVelocity())


@pytest.mark.parametrize(("planner", "robot"), ALL)
def test_it_refuses_bad_paths(planner: str, robot: str) -> None:
    local = PLANNERS[planner](ROBOTS[robot])
    for bad in (np.zeros((0, 3)), np.zeros((4, 2)), np.full((3, 3), np.nan)):
        with pytest.raises(InvalidPathError):
            local.set_path(bad)


@pytest.mark.parametrize(("planner", "robot"), ALL)
def test_same_input_same_output(planner: str, robot: str) -> None:
    world, path, start = CASES["door_from_the_side"]
    model = ROBOTS[robot]
    runs = [drive(PLANNERS[planner](model), model, world, path, start, seconds=6.0) for _ in range(2)]
    assert runs[0].commands == runs[1].commands


@pytest.mark.parametrize(("planner", "robot"), ALL)
def test_it_shows_where_its_command_leads(planner: str, robot: str) -> None:
    local = PLANNERS[planner](ROBOTS[robot])
    assert local.trajectory.shape == (0, 3), "there is no motion before the first command"
    start = SE2(0.5, -0.25, 0.1)
    local.set_path(line((0.5, -0.25), (4.0, 0.0)))
    costs, spec = World().window(0.5, -0.25, 6.0)
    command = local.compute_command(costs, spec, start, BodyVelocity(0.5))
    shown = local.trajectory
    assert shown.dtype == np.float64
    assert shown.shape[1] == 3
    np.testing.assert_allclose(shown[0], start.as_array(), atol=1e-9)
    assert command.vx > 0.3
    assert shown[-1, 0] > start.x + 0.2, "it leads forward, as the command does"
    assert math.dist(shown[-1, :2], shown[0, :2]) < 2.0


def test_it_leaves_a_place_where_it_already_touches_something() -> None:
    world = World().block(0.22, -0.5, 0.3, 0.5)  # 3 cm inside the front of the robot
    log = drive(PLANNERS["rollout"](DIFF), DIFF, world, line((0, 0), (-2, 0)), SE2(0.0, 0.0, math.pi), seconds=20.0)
    assert log.is_reached
    assert not world.touches(DIFF, log.poses[-1])


def test_the_end_of_a_replaced_path_decides() -> None:
    planner = TrajectoryRollout(RolloutConfig(), DIFF)
    log = drive(planner, DIFF, World(), line((0, 0), (2, 0)), SE2(), seconds=20.0)
    assert log.is_reached
    again = drive(planner, DIFF, World(), line((2, 0), (2, 2)), log.poses[-1], seconds=20.0)
    assert again.is_reached
    assert again.poses[-1].distance_to(SE2(2.0, 2.0, 0.0)) < 0.12
