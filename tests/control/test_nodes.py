"""Gate, controller and navigator together on the bus, in lockstep with a toy robot."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from ambler.control.config import RolloutConfig
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.core.errors import NoValidPathError
from ambler.core.messages import GateState, PoseStamped
from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.nodes.controller import ControllerNode
from ambler.nodes.gate import GateNode
from ambler.nodes.navigator import NavigatorNode
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    ARM,
    EMERGENCY_STOP,
    FOLLOW_PATH,
    NAVIGATE,
    PAUSE,
    RECOVER,
    RESET_STOP,
    FollowPathGoal,
    GateRequest,
    NavigateGoal,
    RecoverGoal,
    RecoveryKind,
)
from ambler.runtime.topics import GOAL, TELEOP_REQUEST
from tests.control.toy_robot import MAP_FROM_ODOM, ROBOT, Person, ToyBase, ToyPlanner, room, straight_path

Act = Callable[[Person], None]
STILL = BodyVelocity()
OPEN = room(-6.0, -6.0, 6.0, 6.0)


def goal_at(x: float, y: float = 0.0, yaw: float = 0.0) -> SE2:
    """A goal told in the odom frame, as a pose of the map."""
    return MAP_FROM_ODOM @ SE2(x, y, yaw)


def follow(x: float, y: float = 0.0) -> Act:
    return lambda p: p.send(FOLLOW_PATH, FollowPathGoal(straight_path(SE2(), goal_at(x, y))))


def navigate(x: float, y: float = 0.0) -> Act:
    return lambda p: p.send(NAVIGATE, NavigateGoal(goal_at(x, y)))


def ask(service: object) -> Act:
    return lambda p: p.ask(service, GateRequest("person", "test"))


def cancel(p: Person) -> None:
    p.ticket.cancel()


class Robot:
    """A running stack."""

    def __init__(self, script: list[tuple[float, Act]], walls: np.ndarray = OPEN, *, is_armed: bool = True) -> None:
        self.base = ToyBase(walls)
        self.planner = ToyPlanner(self.base)
        self.person = Person([(0.3, ask(ARM)), *script] if is_armed else script)
        self.gate = GateNode(ROBOT)
        local = TrajectoryRollout(RolloutConfig(), ROBOT)
        self.controller = ControllerNode(ROBOT, local, LocalCostmap(LocalCostmapConfig(), ROBOT))
        nodes = [self.base, self.planner, self.controller, NavigatorNode(), self.gate, self.person]
        self.executor = LockstepExecutor(Stack(nodes, external=(TELEOP_REQUEST,)), on_failure=self.gate.stop_now)

    def run(self, seconds: float) -> "Robot":
        self.executor.run(seconds)
        return self

    @property
    def codes(self) -> list[str]:
        return [o.code for o in self.person.outcomes]

    def commands_after(self, seconds: float) -> list[BodyVelocity]:
        return [v for ns, v in self.base.heard if ns > seconds * 1e9]


def test_follow_path_reaches_its_end_and_leaves_zero() -> None:
    robot = Robot([(0.5, follow(1.5))]).run(6.0)
    assert robot.codes == ["SUCCEEDED"]
    assert robot.base.pose.distance_to(SE2(1.5, 0.0, 0.0)) < 0.15
    assert robot.commands_after(5.5)[-1] == STILL


def test_nothing_moves_before_the_gate_is_armed() -> None:
    robot = Robot([(0.5, follow(1.5))], is_armed=False).run(13.0)
    assert robot.base.pose == SE2()
    assert robot.codes == [], "a paused gate is no lack of progress"
    assert {s.state for s in robot.person.states} == {GateState.PAUSED}


def test_cancelling_stops() -> None:
    robot = Robot([(0.5, follow(4.0)), (2.0, cancel)]).run(4.0)
    assert robot.codes == ["CANCELLED"]
    assert 0.3 < robot.base.pose.x < 2.5
    assert robot.commands_after(3.0)[-1] == STILL


def test_a_new_path_goal_preempts() -> None:
    robot = Robot([(0.5, follow(4.0)), (1.5, follow(0.8, 1.0))]).run(10.0)
    assert robot.codes == ["PREEMPTED", "SUCCEEDED"]
    assert robot.base.pose.distance_to(SE2(0.8, 1.0, 0.0)) < 0.15


@pytest.mark.parametrize("sense", ["has_scan", "has_odometry"])
def test_a_silent_sensor_ends_the_path_by_name(sense: str) -> None:
    robot = Robot([(0.5, follow(4.0)), (2.0, lambda p: None)])
    robot.person._script.append((2.0, lambda p: setattr(robot.base, sense, False)))
    robot.run(5.0)
    assert robot.codes == ["STALE_INPUT"]
    assert robot.base.velocity == STILL
    reasons = [s.reason for s in robot.person.states if s.state is GateState.FAULT]
    assert reasons
    assert all("STALE" in r for r in reasons)


def test_recoveries_on_the_bus() -> None:
    turn = RecoverGoal(RecoveryKind.ROTATE, math.pi / 2)
    back = RecoverGoal(RecoveryKind.BACK_UP, 0.3)
    robot = Robot([(0.5, lambda p: p.send(RECOVER, turn)), (5.0, lambda p: p.send(RECOVER, back))]).run(10.0)
    assert robot.codes == ["SUCCEEDED", "SUCCEEDED"]
    assert abs(robot.base.pose.yaw - math.pi / 2) < 0.1
    assert abs(robot.base.pose.y + 0.3) < 0.06


def test_a_recovery_without_room_says_so() -> None:
    corner = np.vstack((OPEN, [[-0.28, -1.0, -0.28, 1.0]]))
    back = RecoverGoal(RecoveryKind.BACK_UP, 0.3)
    robot = Robot([(0.8, lambda p: p.send(RECOVER, back))], corner).run(2.0)
    assert robot.codes == ["COLLISION_AHEAD"]
    assert robot.base.pose.x > -0.03


def test_navigate_and_a_click_that_preempts_it() -> None:
    click = PoseStamped(0, "map", SE3.from_se2(goal_at(0.5, 1.0)))
    robot = Robot([(0.5, navigate(4.0)), (2.0, lambda p: p.ctx.publish(GOAL, click))]).run(10.0)
    assert robot.codes == ["PREEMPTED"]
    assert robot.base.pose.distance_to(SE2(0.5, 1.0, 0.0)) < 0.15
    assert robot.commands_after(9.5)[-1] == STILL


def test_navigate_fails_by_name_when_there_is_no_path() -> None:
    robot = Robot([(0.5, navigate(2.0))])
    robot.planner.failure = NoValidPathError("walled in")
    robot.run(2.0)
    assert robot.codes == ["NO_VALID_PATH"]
    assert robot.planner.cleared == 1
    assert robot.base.pose == SE2()


def test_navigate_to_a_goal_in_a_wall_ends_beside_it_and_says_how_far() -> None:
    robot = Robot([(0.5, navigate(2.5))])
    robot.planner.nearest = goal_at(1.7)
    robot.run(10.0)
    assert robot.codes == ["NEAREST_REACHED"]
    (outcome,) = robot.person.outcomes
    away = 2.5 - robot.base.pose.x
    assert 0.6 < away < 1.3
    assert outcome.result.goal_distance == pytest.approx(away, abs=0.02)
    assert f"{outcome.result.goal_distance:.2f} m" in outcome.text


def test_navigate_into_a_wall_gives_up_without_touching_it() -> None:
    wall = np.vstack((OPEN, [[1.0, -3.0, 1.0, 3.0]]))
    robot = Robot([(0.5, navigate(3.0))], wall).run(60.0)
    assert robot.codes == ["RECOVERIES_EXHAUSTED"]
    assert robot.person.outcomes[0].result.recoveries == 7
    corners = robot.base.pose.transform(ROBOT.footprint)
    assert corners[:, 0].max() < 1.0
    assert robot.base.velocity == STILL


def test_the_emergency_stop_over_the_bus() -> None:
    script = [
        (0.5, follow(4.0)),
        (2.0, ask(EMERGENCY_STOP)),
        (2.5, ask(ARM)),
        (3.0, ask(RESET_STOP)),
        (5.0, ask(PAUSE)),
    ]
    robot = Robot(script).run(6.0)
    first_zero = next(ns for ns, v in robot.base.heard if ns > 2_000_000_000 and v == STILL)
    assert first_zero - 2_000_000_000 < 30_000_000
    assert set(robot.commands_after(2.05)) == {STILL}
    assert [r.is_done for r in robot.person.replies] == [True, True, False, True, True]
    states = [s.state for s in robot.person.states]
    assert GateState.EMERGENCY_STOP in states
    assert states[-1] is GateState.PAUSED


def test_a_failed_node_stops_the_robot_for_good() -> None:
    robot = Robot([(0.5, follow(4.0)), (3.0, ask(RESET_STOP))])
    robot.person._script.append((2.0, lambda p: robot.gate.stop_now("node toy failed")))
    robot.run(4.0)
    assert set(robot.commands_after(2.05)) == {STILL}
    assert robot.person.replies[-1].is_done is False
    assert robot.person.states[-1].state is GateState.EMERGENCY_STOP


def test_the_command_has_a_heartbeat() -> None:
    robot = Robot([], is_armed=False).run(2.0)
    stamps = [ns for ns, _ in robot.base.heard]
    assert max(np.diff(stamps)) <= 20_000_000
    assert len(stamps) >= 98
