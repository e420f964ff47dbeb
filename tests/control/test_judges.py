"""Goal checker, progress checker, path tracker, and the recovery motions."""

import itertools
import math

import numpy as np
import pytest

from ambler.control.checkers import GoalChecker, ProgressChecker, StallChecker
from ambler.control.path_tracker import PathTracker
from ambler.control.recovery_motion import (
    BackUp,
    CollisionAheadError,
    MakeRoom,
    RecoveryMotion,
    RecoveryTimeoutError,
    TurnInPlace,
)
from ambler.control.way_back import WayBack
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from tests.control.closed_loop import DIFF, SPOT, World, line, step_velocity

STILL = BodyVelocity()


def test_a_goal_needs_position_heading_and_rest() -> None:
    goal = SE2(1.0, 0.0, 0.5)
    assert GoalChecker(0.15, 0.2).update(SE2(1.1, 0.1, 0.6), goal, STILL, 0.0)
    assert not GoalChecker(0.15, 0.2).update(SE2(1.1, 0.12, 0.5), goal, STILL, 0.0)
    assert not GoalChecker(0.15, 0.2).update(SE2(1.0, 0.0, 0.71), goal, STILL, 0.0)
    assert not GoalChecker(0.15, 0.2).update(goal, goal, BodyVelocity(0.2), 0.0)
    assert not GoalChecker(0.15, 0.2).update(goal, goal, BodyVelocity(0.0, 0.0, 0.2), 0.0)
    assert GoalChecker(0.15, 0.2).update(SE2(1.0, 0.0, 0.5 - 2 * math.pi), goal, STILL, 0.0)


def test_a_reached_position_is_kept_while_turning() -> None:
    goal, checker = SE2(1.0, 0.0, 0.0), GoalChecker(0.15, 0.2)
    assert not checker.update(SE2(0.9, 0.0, 2.0), goal, STILL, 0.1)
    assert checker.is_position_reached
    assert checker.update(SE2(0.8, 0.0, 0.1), goal, STILL, 0.2)
    assert not checker.update(SE2(0.6, 0.0, 0.1), goal, STILL, 0.4)
    assert not checker.is_position_reached


def test_a_path_through_its_own_goal_is_driven_to_its_end() -> None:
    assert not GoalChecker(0.15, 0.2).update(SE2(), SE2(), STILL, 3.0)


def test_progress() -> None:
    checker = ProgressChecker(radius=0.5, angle=0.5, patience=10.0)
    second = 1_000_000_000
    assert checker.update(0, SE2())
    assert checker.update(10 * second, SE2(0.49, 0.0, 0.0))
    assert not checker.update(10 * second + 1, SE2(0.49, 0.0, 0.0))
    assert checker.update(11 * second, SE2(0.51, 0.0, 0.0))
    assert checker.update(20 * second, SE2(0.6, 0.0, 0.4))
    assert checker.update(22 * second - 1, SE2(0.6, 0.0, 0.51)), "turning is progress too"
    assert not checker.update(33 * second, SE2(0.6, 0.0, 0.6))


def test_the_tracker_does_not_jump_to_another_leg() -> None:
    tracker = PathTracker()
    loop = line((0, 0), (3, 0), (3, 0.4), (0, 0.4))
    assert not tracker.set_path(loop)
    tracker.locate(SE2(0.0, 0.1, 0.0))
    for x in np.linspace(0.0, 2.0, 21):
        left = tracker.locate(SE2(float(x), 0.21, 0.0))
        assert math.isclose(left, 6.4 - x, abs_tol=0.06)
    assert tracker.set_path(loop)
    assert math.isclose(tracker.locate(SE2(2.0, 0.21, 0.0)), 4.4, abs_tol=0.06)
    assert tracker.ahead(2.0)[-1, 2] < 4.0, "what lies ahead ends where the path turns back"
    assert not tracker.set_path(line((0, 0), (0, 2)))


def test_a_path_of_one_pose_or_of_repeated_poses_is_fine() -> None:
    tracker = PathTracker()
    tracker.set_path(np.array([[1.0, 2.0, 0.7]]))
    assert tracker.locate(SE2()) == 0.0
    assert tracker.goal == SE2(1.0, 2.0, 0.7)
    tracker.set_path(np.array([[0.0, 0.0, 0.0]] * 3 + [[0.0, 1.0, 0.0]] * 2))
    assert math.isclose(tracker.length, 1.0)
    assert np.allclose(tracker.points[:, 3], math.pi / 2)


def all_seen(heading: float, length: float) -> float:
    return length


def run_motion(
    motion: RecoveryMotion, robot: RobotModel, world: World, seconds: float = 30.0, start: SE2 | None = None
) -> list[SE2]:
    pose, v, poses = start or SE2(), STILL, []
    for tick in range(round(seconds / 0.05)):
        costs, spec = world.window(pose.x, pose.y, 5.0)
        command = motion.compute_command(tick * 50_000_000, costs, spec, pose)
        if command is None:
            return poses
        for _ in range(5):
            v = step_velocity(v, command, robot.limits, 0.01)
            pose = pose @ SE2.exp(np.array([v.vx, v.vy, v.wz]) * 0.01)
        poses.append(pose)
        assert not world.touches(robot, pose)
    raise AssertionError("the motion did not end")


@pytest.mark.parametrize("amount", [math.pi / 2, -math.pi / 2, 2 * math.pi])
def test_turning_in_place(amount: float) -> None:
    poses = run_motion(TurnInPlace(SPOT, amount, 0.02), SPOT, World())
    turned = np.unwrap([p.yaw for p in poses])
    assert math.isclose(turned[-1], amount, abs_tol=0.1)
    assert max(math.hypot(p.x, p.y) for p in poses) < 1e-6


def test_turning_takes_the_side_with_more_room() -> None:
    corner = World().block(0.45, 0.3, 0.9, 0.6)  # in the way of the front left corner
    poses = run_motion(TurnInPlace(SPOT, 1.0, 0.02), SPOT, corner)
    assert poses[-1].yaw < -0.9


def test_turning_is_refused_between_walls() -> None:
    aisle = World().block(-3, 0.35, 3, 0.6).block(-3, -0.6, 3, -0.35)
    with pytest.raises(CollisionAheadError):
        run_motion(TurnInPlace(SPOT, 1.5, 0.02), SPOT, aisle)


@pytest.mark.parametrize(("wall", "expected"), [(3.0, 0.3), (0.45, 0.16)])
def test_backing_up_takes_what_is_free(wall: float, expected: float) -> None:
    poses = run_motion(BackUp(DIFF, 0.3, 0.02), DIFF, World().block(-wall - 0.2, -1.0, -wall, 1.0))
    assert math.isclose(-poses[-1].x, expected, abs_tol=0.06)


def test_backing_up_is_refused_without_room_or_reverse() -> None:
    with pytest.raises(CollisionAheadError):
        run_motion(BackUp(DIFF, 0.3, 0.02), DIFF, World().block(-0.5, -1.0, -0.3, 1.0))
    forward_only = RobotModel("f", DIFF.drive, DIFF.footprint, VelocityLimits(0.8, 0.0, 0.0, 1.5))
    with pytest.raises(CollisionAheadError):
        run_motion(BackUp(forward_only, 0.3, 0.02), forward_only, World())


def came_by(*twists: tuple[float, float, float]) -> tuple[WayBack, SE2]:
    """Return the way back of a base that drove each twist for a second from the origin, and where it is."""
    way_back, pose = WayBack(), SE2()
    for twist in twists:
        for _ in range(50):
            way_back.add(pose)
            pose = pose @ SE2.exp(np.array(twist) * 0.02)
    return way_back, pose


ARC = ((0.47, 0.0, 0.785),) * 2  # a quarter of a circle of 0.6 m to the left
BEHIND_ARC = World().block(0.75, -0.6, 1.1, 0.05)  # what straight back from its end leads to after 0.3 m


def test_backing_up_follows_the_way_that_the_base_came() -> None:
    way_back, end = came_by(*ARC)
    straight = run_motion(BackUp(DIFF, 0.6, 0.02), DIFF, BEHIND_ARC, start=end)
    assert end.distance_to(straight[-1]) < 0.4
    poses = run_motion(BackUp(DIFF, 0.6, 0.02, way_back), DIFF, BEHIND_ARC, start=end)
    assert 0.55 < sum(a.distance_to(b) for a, b in itertools.pairwise([end, *poses])) < 0.65
    for pose in poses:
        assert abs(math.hypot(pose.x, pose.y - 0.6) - 0.6) < 0.03
    assert math.isclose(poses[-1].yaw, math.pi / 2 - 1.0, abs_tol=0.15)


def test_where_there_is_room_it_backs_up_straight_whatever_way_it_came() -> None:
    way_back, end = came_by(*ARC)
    poses = run_motion(BackUp(DIFF, 0.3, 0.02, way_back), DIFF, World(), start=end)
    assert max(abs(p.yaw - end.yaw) for p in poses) < 1e-6
    assert math.isclose(end.y - poses[-1].y, 0.3, abs_tol=0.03)


def test_the_next_time_it_backs_up_farther_not_forth_again() -> None:
    way_back, end = came_by(*ARC)
    half = run_motion(BackUp(DIFF, 0.5, 0.02, way_back), DIFF, BEHIND_ARC, start=end)[-1]
    assert half.yaw > 0.5
    there = run_motion(BackUp(DIFF, 2.0, 0.02, way_back), DIFF, World().block(-1.4, -3.0, -1.0, 3.0), start=half)[-1]
    assert there.yaw < 0.2
    assert there.x < -0.1  # the way has come to its beginning: straight on from there


def test_legs_leave_a_pocket_sideways_as_they_came() -> None:
    pocket = World().block(-1.2, 0.35, 1.2, 0.5).block(-0.75, -0.35, -0.6, 0.35)  # at the left side, and behind
    way_back = WayBack()
    for y in np.arange(-1.2, 0.01, 0.04):
        way_back.add(SE2(0.0, float(y), 0.0))
    with pytest.raises(CollisionAheadError):
        run_motion(BackUp(SPOT, 0.6, 0.02), SPOT, pocket)
    poses = run_motion(BackUp(SPOT, 0.6, 0.02, way_back), SPOT, pocket)
    assert poses[-1].y < -0.5
    assert max(abs(p.x) for p in poses) < 0.02


def test_a_way_back_on_which_something_stands_now_is_not_taken() -> None:
    way_back, end = came_by((0.6, 0.0, 0.0), (0.6, 0.0, 0.0))
    with pytest.raises(CollisionAheadError):
        run_motion(BackUp(DIFF, 0.6, 0.02, way_back), DIFF, World().block(0.6, -0.5, 0.9, 0.5), start=end)


def test_after_a_straight_bit_the_way_goes_on_back_from_beside() -> None:
    way_back, end = came_by(*ARC)
    target = way_back.target(end @ SE2(-0.3, 0.0, 0.0))
    assert target is not None
    assert target.y < 0.35  # not forth to where it had been


def test_who_was_carried_away_does_not_go_back() -> None:
    way_back, _ = came_by((0.6, 0.0, 0.0))
    way_back.add(SE2(5.0, 0.0))
    assert len(way_back) == 1


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi, math.pi])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_who_cannot_turn_goes_to_the_nearest_place_where_he_can(side: float, yaw: float) -> None:
    """The nose is 3 cm before a wall, or the tail."""
    near = side * (SPOT.footprint[:, 0].max() + 0.03)
    corners = SE2(0.0, 0.0, yaw).transform(np.array([[near, -1.5], [near + 0.2 * side, 1.5]]))
    world = World().block(*corners.min(axis=0), *corners.max(axis=0))
    with pytest.raises(CollisionAheadError):
        run_motion(TurnInPlace(SPOT, 0.8, 0.02), SPOT, world, start=SE2(0.0, 0.0, yaw))
    poses = run_motion(MakeRoom(SPOT, 1.0, 0.02, all_seen), SPOT, world, start=SE2(0.0, 0.0, yaw))
    moved = SE2(0.0, 0.0, yaw).inverse() @ poses[-1]
    assert 0.02 < -side * moved.x < 0.35
    assert abs(moved.y) < 0.01
    assert abs(run_motion(TurnInPlace(SPOT, 0.8, 0.02), SPOT, world, start=poses[-1])[-1].yaw - yaw) > 0.7


def test_room_is_made_only_where_it_was_seen_and_only_as_far_as_told() -> None:
    wall = World().block(0.62, -1.5, 0.8, 1.5)
    assert run_motion(MakeRoom(SPOT, 1.0, 0.02, all_seen), SPOT, wall)[-1].x < 0.0
    with pytest.raises(CollisionAheadError):
        run_motion(MakeRoom(SPOT, 1.0, 0.02, lambda heading, length: 0.0), SPOT, wall)
    with pytest.raises(CollisionAheadError):
        run_motion(MakeRoom(SPOT, 0.04, 0.02, all_seen), SPOT, wall)
    aisle = World().block(-3, 0.35, 3, 0.6).block(-3, -0.6, 3, -0.35)
    with pytest.raises(CollisionAheadError):
        run_motion(MakeRoom(SPOT, 1.0, 0.02, all_seen), SPOT, aisle)
    forward_only = RobotModel("f", SPOT.drive, SPOT.footprint, VelocityLimits(0.8, 0.0, 0.0, 1.5))
    with pytest.raises(CollisionAheadError):
        run_motion(MakeRoom(forward_only, 1.0, 0.02, all_seen), forward_only, wall)
    assert run_motion(MakeRoom(SPOT, 1.0, 0.02, all_seen), SPOT, World()) == [], "where one can turn, there is room"


def test_room_close_by_is_gone_to_although_what_lies_beyond_was_not_seen() -> None:
    wall = World().block(0.62, -1.5, 0.8, 1.5)
    poses = run_motion(MakeRoom(SPOT, 1.0, 0.02, lambda heading, length: length if length < 0.3 else 0.0), SPOT, wall)
    assert -0.3 < poses[-1].x < 0.0


def test_who_is_pushed_aside_has_not_gone_where_there_is_room() -> None:
    wall, motion = World().block(0.62, -1.5, 0.8, 1.5), MakeRoom(SPOT, 1.0, 0.02, all_seen)
    costs, spec = wall.window(0.0, 0.0, 5.0)
    assert motion.compute_command(0, costs, spec, SE2()) is not None
    assert motion.compute_command(50_000_000, costs, spec, SE2(0.0, 0.4)) is not None


def test_room_into_which_somebody_steps_is_not_gone_to() -> None:
    wall, motion = World().block(0.62, -1.5, 0.8, 1.5), MakeRoom(SPOT, 1.0, 0.02, all_seen)
    costs, spec = wall.window(0.0, 0.0, 5.0)
    command = motion.compute_command(0, costs, spec, SE2())
    assert command is not None
    assert command.vx < 0.0
    costs, spec = wall.block(-0.8, -0.3, -0.58, 0.3).window(0.0, 0.0, 5.0)
    with pytest.raises(CollisionAheadError, match="come"):
        motion.compute_command(50_000_000, costs, spec, SE2())


@pytest.mark.parametrize("motion", [TurnInPlace(DIFF, 1.0, 0.02), BackUp(DIFF, 0.3, 0.02)])
def test_a_motion_that_does_not_move_times_out(motion: RecoveryMotion) -> None:
    costs, spec = World().window(0.0, 0.0, 5.0)
    assert motion.compute_command(0, costs, spec, SE2()) is not None
    with pytest.raises(RecoveryTimeoutError):
        motion.compute_command(60_000_000_000, costs, spec, SE2())


@pytest.mark.parametrize("acceleration", [0.05, 0.2, 1.2])
def test_a_heavy_base_that_obeys_slowly_is_not_stuck_and_one_that_stands_is(acceleration: float) -> None:
    heavy, stuck = StallChecker(acceleration), StallChecker(acceleration)
    told = [(k * 50_000_000, BodyVelocity(0.8)) for k in range(1, 160)]
    assert all(heavy.update(ns, v, BodyVelocity(min(v.vx, acceleration * ns * 1e-9))) for ns, v in told)
    assert not all(stuck.update(ns, v, BodyVelocity()) for ns, v in told[:61])


@pytest.mark.parametrize("told", [BodyVelocity(0.4), BodyVelocity(0.24, -0.32)])
def test_a_base_that_trembles_or_slides_to_the_side_does_not_obey(told: BodyVelocity) -> None:
    """At a kerb its wheels slip: it sways by more than a fifth of what it is told, and does not get on."""
    trembling, sliding, obeying = (StallChecker(1.0) for _ in range(3))
    ns = [k * 50_000_000 for k in range(1, 60)]
    sways = [BodyVelocity(s * told.vx, s * told.vy) for s in (0.4, -0.4)]
    assert not all(trembling.update(t, told, sways[k % 2]) for k, t in enumerate(ns))
    assert not all(sliding.update(t, told, BodyVelocity(-told.vy, told.vx)) for t in ns)
    assert all(obeying.update(t, told, BodyVelocity(0.4 * told.vx, 0.4 * told.vy)) for t in ns)


@pytest.mark.parametrize("period", [2, 4, 6])
def test_a_base_that_is_told_now_this_and_now_the_opposite_cannot_obey_and_is_not_held(period: int) -> None:
    """Two people in the way: the planner changes its mind several times a second, and the base, which follows with 0.8 m/s², hardly moves."""
    stall, vy = StallChecker(0.8), 0.0
    for k in range(1, 200):
        told = BodyVelocity(0.0, 0.25 if k // period % 2 else -0.25)
        vy += min(max(told.vy - vy, -0.04), 0.04)
        assert stall.update(k * 50_000_000, told, BodyVelocity(0.0, 0.3 * vy))
    assert not all(stall.update((200 + k) * 50_000_000, BodyVelocity(0.0, 0.25), BodyVelocity()) for k in range(40))
