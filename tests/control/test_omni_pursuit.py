"""What is the pursuit's own: its tolerances, that it keeps to its path, slows down where it is narrow and in curves, and stops gently."""

import itertools
import math

import numpy as np
import pytest

from ambler.control.omni_pursuit import OmniPursuit
from ambler.control.pursuit_config import PursuitConfig
from ambler.core.errors import InvalidPathError, NoValidControlError
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2, wrap_angle
from tests.control.closed_loop import SPOT, Drive, World, arc, drive, line

AMR = RobotModel(
    "amr", DriveKind.OMNI, np.array([[0.6, -0.4], [0.6, 0.4], [-0.6, 0.4], [-0.6, -0.4]]),
    VelocityLimits(1.0, -0.4, 0.5, 1.0, 0.8, 0.8, 1.5, 1.2, 1.2),
)  # fmt: skip


@pytest.mark.parametrize("robot", [SPOT, AMR], ids=lambda r: r.name)
@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_an_omnidirectional_base_reaches_its_goal_to_a_centimetre(robot: RobotModel, yaw: float) -> None:
    goal = SE2(2.5, 0.4, yaw)
    path = line((0, 0), (1.5, 0), (2.5, 0.4), yaw=yaw)
    log = drive(OmniPursuit(PursuitConfig(), robot), robot, World(), path, SE2(), 40.0, 0.01, 0.005)
    assert log.is_reached
    assert log.poses[-1].distance_to(goal) < 0.01
    assert abs(wrap_angle(log.poses[-1].yaw - yaw)) < 0.005
    assert log.seconds < 12.0


def test_along_the_path_it_looks_ahead_and_near_the_goal_it_moves_holonomically() -> None:
    path = line((0, 0), (3, 0), yaw=math.pi / 2)
    log = drive(OmniPursuit(PursuitConfig(), AMR), AMR, World(), path, SE2(), 40.0, 0.01, 0.005)
    assert log.is_reached
    assert all(abs(p.yaw) < 0.05 for p in log.poses if p.x < 2.3)
    assert any(abs(v.vy) > 0.05 and abs(v.wz) > 0.2 for v in log.velocities), "it slides while it turns"


def test_it_keeps_to_its_path() -> None:
    for robot in (AMR, SPOT):
        log = drive(OmniPursuit(PursuitConfig(), robot), robot, World(), arc(1.5, 2.5), SE2(), 40.0)
        away = [abs(math.hypot(p.x, p.y - 1.5) - 1.5) for p in log.poses]
        assert max(away) < 0.08
    beside = drive(OmniPursuit(PursuitConfig(), AMR), AMR, World(), line((0, 0), (4, 0)), SE2(0.0, 0.3, 0.0), 40.0)
    assert max(abs(p.y) for p in beside.poses if p.x > 2.5) < 0.03


def test_curves_and_narrow_places_are_taken_slowly() -> None:
    free = drive(OmniPursuit(PursuitConfig(), AMR), AMR, World(), line((0, 0), (5, 0)), SE2())
    lane = World().block(1.5, 0.5, 3.5, 0.6).block(1.5, -0.6, 3.5, -0.5)
    narrow = drive(OmniPursuit(PursuitConfig(), AMR), AMR, lane, line((0, 0), (5, 0)), SE2())
    assert narrow.is_reached
    assert narrow.collisions == 0
    fast = max(v.vx for p, v in zip(free.poses, free.velocities, strict=True) if 2.0 < p.x < 3.0)
    slow = max(v.vx for p, v in zip(narrow.poses, narrow.velocities, strict=True) if 2.0 < p.x < 3.0)
    assert fast > 0.9
    assert slow < 0.7
    curve = drive(OmniPursuit(PursuitConfig(), AMR), AMR, World(), arc(0.6, 3.0), SE2())
    assert max(v.vx for v in curve.velocities) < 0.7


def test_near_obstacles_push_it_aside() -> None:
    wall = World().block(0.5, 0.5, 3.5, 0.6)
    log = drive(OmniPursuit(PursuitConfig(), AMR), AMR, wall, line((0, 0), (5, 0)), SE2())
    assert log.is_reached
    beside = [p.y for p in log.poses if 1.5 < p.x < 2.5]
    assert -0.15 < min(beside) < -0.01


def test_it_brakes_within_its_deceleration_before_what_appears() -> None:
    planner, world, log = OmniPursuit(PursuitConfig(), AMR), World().block(3.0, -0.5, 3.1, 0.5), Drive()
    with pytest.raises(NoValidControlError, match="obstacle"):
        drive(planner, AMR, world, line((0, 0), (5, 0)), SE2(), log=log)
    speeds = [v.vx for v in log.velocities]
    assert max(speeds) > 0.7
    assert min(b - a for a, b in itertools.pairwise(speeds)) >= -1.2 * 0.05 - 1e-9
    assert 2.85 < log.poses[-1].x + 0.6 < 3.0


def test_it_leaves_a_niche_that_it_cannot_turn_in_as_it_came() -> None:
    niche = World().block(-0.8, 0.55, 1.0, 0.6).block(-0.8, -0.6, 1.0, -0.55).block(0.8, -0.6, 0.85, 0.6)
    path = np.concatenate((line((0.0, 0.0), (-2.2, 0.0)), line((-2.2, 0.0), (-2.2, 3.0))))
    log = drive(OmniPursuit(PursuitConfig(), AMR), AMR, niche, path, SE2(), 40.0)
    assert log.is_reached
    backwards = [v for p, v in zip(log.poses, log.velocities, strict=False) if p.x > -1.0]
    assert min(v.vx for v in backwards) < -0.2, "not at a crawl: somebody may come"
    assert all(abs(v.wz) < 1e-9 for v in backwards)


def test_without_a_path_it_says_so() -> None:
    planner = OmniPursuit(PursuitConfig(), AMR)
    costs, spec = World().window(0.0, 0.0, 5.0)
    assert planner.path_left == 0.0
    with pytest.raises(InvalidPathError):
        planner.compute_command(costs, spec, SE2(), BodyVelocity())
    planner.set_path(line((0, 0), (2, 0)))
    planner.compute_command(costs, spec, SE2(), BodyVelocity())
    assert planner.path_left == pytest.approx(2.0)
    planner.reset()
    with pytest.raises(InvalidPathError):
        planner.compute_command(costs, spec, SE2(), BodyVelocity())
