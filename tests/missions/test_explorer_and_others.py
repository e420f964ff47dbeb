"""Whoever else drives the robot, or lets it wait: the exploration goes on afterwards, or says that it does not."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.messages import (
    CostGrid,
    GateState,
    GateStatus,
    Path,
    PoseStamped,
    Status,
    Transforms,
    TransformStamped,
)
from ambler.core.requests import PlanReply, PlanRequest
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.exploration.strategies import strategy_named
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.missions.explore_commands import ExploreConfig
from ambler.nodes.explorer import ExplorerNode
from ambler.nodes.navigator import NavigatorNode
from ambler.planning.distance import distance_field
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    CLEAR_GLOBAL_COSTMAP,
    CLEAR_LOCAL_COSTMAP,
    CLICKED_GOAL_OVER,
    COMPUTE_PATH,
    FOLLOW_PATH,
    NAVIGATE,
    RECOVER,
    NavigateGoal,
)
from ambler.runtime.topics import GATE_STATUS, GLOBAL_COSTMAP, GOAL, STATUS, TRANSFORMS
from tests.missions.test_explorer_node import Client, IdealRobot, two_rooms


class Steered(IdealRobot):
    """Stands while the gate does not let it move."""

    may_move = True

    def _tick(self) -> None:
        handle = self.handle
        if not self.may_move:
            self.handle = None
        super()._tick()
        self.handle = handle if not self.may_move else self.handle


class Pauser(Node):
    """A person lets the robot wait between two instants, seconds."""

    name = "gate"
    outputs = (GATE_STATUS,)

    def __init__(self, robot: Steered, state: GateState, between: tuple[float, float]) -> None:
        self.robot, self.state, self.between = robot, state, between

    def start(self) -> None:
        self.ctx.timer(0.5, self._tell)

    def _tell(self) -> None:
        is_paused = self.between[0] <= self.ctx.now_ns * 1e-9 < self.between[1]
        self.robot.may_move = not is_paused
        state = self.state if is_paused else GateState.ARMED
        self.ctx.publish(GATE_STATUS, GateStatus(self.ctx.now_ns, state, "a person" if is_paused else "", ""))


class Clicker(Node):
    """Clicks a goal at some times, and says `over` 20 s after each, as the navigator does when it is over; nothing, if that is empty."""

    name = "clicker"
    outputs = (GOAL, STATUS)

    def __init__(self, over: str, *at: float) -> None:
        self.over, self.at = over, at

    def start(self) -> None:
        pose = PoseStamped(0, "map", SE3.from_se2(SE2(2.0, 2.0)))
        told = Status(0, self.name, CLICKED_GOAL_OVER, self.over)
        for at in self.at:
            self.ctx.after(at, lambda: self.ctx.publish(GOAL, pose))
            if self.over:
                self.ctx.after(at + 20.0, lambda: self.ctx.publish(STATUS, told))


class Program(Node):
    """Sends the robot somewhere at a time, as another program or a dock does."""

    name = "program"
    calls = (NAVIGATE,)

    def __init__(self, at: float) -> None:
        self.at = at

    def start(self) -> None:
        goal = NavigateGoal(SE2(1.5, 4.0, 0.0))
        self.ctx.after(self.at, lambda: self.ctx.send_goal(NAVIGATE, goal, lambda _: None))


def run(seconds: float, *nodes: Node) -> None:
    """Run nodes for some seconds."""
    executor = LockstepExecutor(Stack(nodes))
    try:
        executor.run(seconds)
    finally:
        executor.close()


def explored(seconds: float, robot: Steered, *others: Node) -> Client:
    """Explore both rooms for some seconds among others."""
    client, survey = Client(), FrontierSurvey(SurveyConfig(), distance_field)
    run(seconds, robot, ExplorerNode(ExploreConfig(), survey, strategy_named("tour", distance_field)), client, *others)
    return client


@pytest.mark.parametrize("state", [GateState.PAUSED, GateState.EMERGENCY_STOP])
def test_who_pauses_the_robot_for_minutes_gets_the_whole_map(state: GateState) -> None:
    robot = Steered(two_rooms())
    client = explored(450.0, robot, Pauser(robot, state, (5.0, 305.0)))
    assert client.outcome is not None
    assert client.outcome.code == "SUCCEEDED"
    assert robot.world.coverage() > 0.99
    said = [s for s in client.status if s.node == "explorer" and 7.0 < s.stamp_ns * 1e-9 < 305.0]
    assert said == [], "nothing is given up meanwhile"


@pytest.mark.parametrize("at", [2.0, 4.0, 6.5, 9.0])
def test_a_clicked_goal_goes_first_whatever_the_exploration_does(at: float) -> None:
    robot = Steered(two_rooms())
    client = explored(200.0, robot, Clicker("SUCCEEDED", at))
    assert client.outcome is not None
    assert client.outcome.code == "SUCCEEDED"
    assert robot.world.coverage() > 0.99
    said = [s for s in client.status if s.node == "explorer" and at + 1.0 < s.stamp_ns * 1e-9 < at + 20.0]
    assert said == [], "the robot is his"


def test_a_robot_that_another_program_drives_is_not_taken_from_it() -> None:
    """The exploration ends and says why; the other goal is reached."""
    robot = Steered(two_rooms())
    client = explored(60.0, robot, Program(3.3))
    assert client.outcome is not None
    assert client.outcome.code == "PREEMPTED"
    assert robot.world.pose.distance_to(SE2(1.5, 4.0)) < 0.3


def test_a_clicked_goal_that_another_program_displaced_ends_the_exploration_too() -> None:
    client = explored(60.0, Steered(two_rooms()), Clicker("PREEMPTED: a newer goal took its place", 5.0))
    assert client.outcome is not None
    assert client.outcome.code == "PREEMPTED"


class Roads(Node):
    """Knows a straight path to anywhere, which nobody ever drives to its end."""

    name = "roads"
    outputs = (GLOBAL_COSTMAP, TRANSFORMS)
    serves = (COMPUTE_PATH, FOLLOW_PATH, RECOVER, CLEAR_GLOBAL_COSTMAP, CLEAR_LOCAL_COSTMAP)

    def start(self) -> None:
        self.ctx.serve(COMPUTE_PATH, self._path)
        for forget in (CLEAR_GLOBAL_COSTMAP, CLEAR_LOCAL_COSTMAP):
            self.ctx.serve(forget, lambda request: request)
        self.ctx.serve_task(FOLLOW_PATH, lambda _: None, lambda handle: handle.cancelled())
        self.ctx.serve_task(RECOVER, lambda _: None, lambda handle: handle.cancelled())
        self.ctx.timer(0.5, self._tell)

    def _path(self, request: PlanRequest) -> PlanReply:
        goal = request.map_from_goal
        return PlanReply(
            Path(self.ctx.now_ns, "map", np.array([[0.0, 0.0, 0.0], [goal.x, goal.y, goal.yaw]])), 1.0, 0.0
        )

    def _tell(self) -> None:
        pose = TransformStamped(self.ctx.now_ns, "map", "base", SE3.from_se2(SE2()))
        self.ctx.publish(TRANSFORMS, Transforms(self.ctx.now_ns, (pose,)))
        spec = GridSpec(0.1, 100, 100, -5.0, -5.0)
        self.ctx.publish(GLOBAL_COSTMAP, CostGrid(self.ctx.now_ns, "map", spec, np.zeros(spec.shape, np.uint8)))


class Listener(Node):
    """Keeps what is said for a client."""

    name = "listener"
    inputs = (STATUS,)

    def __init__(self, client: Client) -> None:
        self.client = client

    def start(self) -> None:
        self.ctx.subscribe(STATUS, self.client.status.append)


@pytest.mark.parametrize("is_click", [True, False])
def test_a_clicked_goal_is_over_when_a_program_displaces_it_not_when_the_next_click_does(is_click: bool) -> None:
    client = Client()
    others = (Clicker("", 2.0, 4.0),) if is_click else (Clicker("", 2.0), Program(4.0))
    run(10.0, Roads(), NavigatorNode(), Listener(client), *others)
    said = [s.text for s in client.status if s.node == "navigator" and s.code == CLICKED_GOAL_OVER]
    assert bool(said) is not is_click
    assert all(text.startswith("PREEMPTED") for text in said)
