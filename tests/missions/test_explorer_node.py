"""The explorer on the bus, in lockstep, with a node that plays SLAM, costmap and navigator in an ideal world."""

import json
import re
from typing import Any

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.messages import Frontiers, FrontierState, GateState, GateStatus, Status, Transforms, TransformStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.exploration.grid_world import GridWorld
from ambler.exploration.strategies import strategy_named
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.missions.explore_commands import ExploreConfig
from ambler.nodes.explorer import ExplorerNode
from ambler.planning.distance import distance_field
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import GoalHandle, GoalTicket, Node, TaskOutcome
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import (
    CLEAR_GLOBAL_COSTMAP,
    EXPLORE,
    NAVIGATE,
    RECOVER,
    ExploreFeedback,
    ExploreGoal,
    ExploreResult,
    NavigateResult,
    Nothing,
)
from ambler.runtime.topics import FRONTIERS, GATE_STATUS, GLOBAL_COSTMAP, MAP, STATUS, TERRAIN_CLEARING, TRANSFORMS


def two_rooms(door: int = 10, sees: float = 3.5) -> GridWorld:
    """Two rooms and a door of so many cells of 0.1 m, for a robot of 0.5 m."""
    grid = np.full((60, 110), 100, np.int8)
    grid[5:55, 5:50] = 0
    grid[5:55, 53:105] = 0
    grid[25 : 25 + door, 50:53] = 0
    spec = GridSpec(0.1, 110, 60, 0.0, 0.0)
    return GridWorld(spec, grid, SE2(1.05, 1.05), distance_field, sensor_range=sees, rays=360)


class IdealRobot(Node):
    """Publishes the map, costs and pose of a grid world twice a second, and drives in it at 0.8 m/s."""

    name = "ideal_robot"
    outputs = (MAP, GLOBAL_COSTMAP, TRANSFORMS)
    serves = (NAVIGATE, RECOVER, CLEAR_GLOBAL_COSTMAP)

    def __init__(self, world: GridWorld) -> None:
        self.world = world
        self.handle: GoalHandle[Any, Any, Any] | None = None
        self.goals: list[SE2] = []
        self.cleared = 0

    def start(self) -> None:
        self.ctx.serve_task(NAVIGATE, self._on_goal, self._on_cancel)
        self.ctx.serve_task(RECOVER, lambda handle: handle.succeed(Nothing()), lambda handle: handle.cancelled())
        self.ctx.serve(CLEAR_GLOBAL_COSTMAP, self._clear)
        self.ctx.timer(0.5, self._tick)

    def _clear(self, request: Nothing) -> Nothing:
        self.cleared += 1
        return request

    def _on_goal(self, handle: GoalHandle[Any, Any, Any]) -> None:
        self.handle = handle
        self.goals.append(handle.goal.map_from_goal)

    def _on_cancel(self, handle: GoalHandle[Any, Any, Any]) -> None:
        handle.cancelled()
        self.handle = None if handle is self.handle else self.handle

    def _tick(self) -> None:
        now_ns, handle = self.ctx.now_ns, self.handle
        if handle is not None and handle.is_active:
            has_arrived = self.world.drive(handle.goal.map_from_goal, 0.4)
            if has_arrived is None:
                handle.fail("NO_VALID_PATH", "no path")
            elif has_arrived:
                handle.succeed(NavigateResult(self.world.pose, 0.0, 0))
        self.ctx.publish(MAP, self.world.map(now_ns))
        self.ctx.publish(GLOBAL_COSTMAP, self.world.costs(now_ns))
        pose = TransformStamped(now_ns, "map", "base", SE3.from_se2(self.world.pose))
        self.ctx.publish(TRANSFORMS, Transforms(now_ns, (pose,)))


class Client(Node):
    """Asks for an exploration at the start, cancels it at a given time, and keeps what it hears."""

    name = "client"
    inputs = (FRONTIERS, STATUS)
    calls = (EXPLORE,)

    def __init__(self, cancel_after: float | None = None) -> None:
        self.cancel_after = cancel_after
        self.outcome: TaskOutcome[ExploreResult] | None = None
        self.frontiers: list[Frontiers] = []
        self.status: list[Status] = []
        self.feedback: list[ExploreFeedback] = []

    def start(self) -> None:
        self.ctx.subscribe(FRONTIERS, self.frontiers.append)
        self.ctx.subscribe(STATUS, self.status.append)
        self.ctx.after(0.1, self._begin)

    def _begin(self) -> None:
        self.ticket: GoalTicket = self.ctx.send_goal(EXPLORE, ExploreGoal(), self._done, self.feedback.append)
        if self.cancel_after is not None:
            self.ctx.after(self.cancel_after, self.ticket.cancel)

    def _done(self, outcome: TaskOutcome[ExploreResult]) -> None:
        self.outcome = outcome


class BrokenGate(Node):
    """Says from a time on that the robot may not move."""

    name = "gate"
    outputs = (GATE_STATUS,)

    def __init__(self, state: GateState) -> None:
        self.state = state

    def start(self) -> None:
        self.ctx.after(3.0, lambda: self.ctx.timer(1.0, self._tell))

    def _tell(self) -> None:
        self.ctx.publish(GATE_STATUS, GateStatus(self.ctx.now_ns, self.state, "STALE_POINTS: rear_left", ""))


def run(
    seconds: float, cancel_after: float | None = None, *others: Node, world: GridWorld | None = None
) -> tuple[IdealRobot, Client]:
    survey = FrontierSurvey(SurveyConfig(), distance_field)
    explorer = ExplorerNode(ExploreConfig(), survey, strategy_named("tour", distance_field))
    robot, client = IdealRobot(world or two_rooms()), Client(cancel_after)
    executor = LockstepExecutor(Stack([robot, explorer, client, *others]))
    try:
        executor.run(seconds)
    finally:
        executor.close()
    return robot, client


def test_it_explores_two_rooms_over_the_bus_and_comes_home() -> None:
    robot, client = run(120.0)
    assert client.outcome is not None
    assert client.outcome.is_success
    assert client.outcome.result is not None
    assert client.outcome.result.is_home
    assert "left" in client.outcome.text, "whoever asked is told what remains"
    assert robot.world.coverage() > 0.99
    assert robot.world.pose.distance_to(SE2(1.05, 1.05)) < 0.2
    assert robot.cleared >= 1
    states = [s.code for s in client.status if s.node == "explorer"]
    assert states[0] == "STARTING"
    assert states[-2:] == ["LOOKING", "FINISHED"]
    assert "RETURNING" in states
    assert json.loads(client.status[-1].fields_json)["frontiers_open"] == 0
    targets = [sum(f.state is FrontierState.TARGET for f in m.frontiers) for m in client.frontiers]
    assert max(targets) == 1
    areas = [f.known_area for f in client.feedback]
    assert areas == sorted(areas)


@pytest.mark.parametrize("seconds", [0.2, 4.0])
def test_a_cancelled_exploration_stops_the_robot(seconds: float) -> None:
    robot, client = run(12.0, cancel_after=seconds)
    assert client.outcome is not None
    assert client.outcome.code == "CANCELLED"
    assert robot.handle is None
    assert client.status[-1].code == "CANCELLED"


def test_a_fault_of_the_gate_that_lasts_ends_the_exploration_with_its_reason() -> None:
    _, client = run(17.0, None, BrokenGate(GateState.FAULT))
    assert client.outcome is not None
    assert client.outcome.code == "STUCK"
    assert client.outcome.text.endswith("STALE_POINTS: rear_left")


class Stuck(IdealRobot):
    """Fails every drive at once: something that it does not see any more shuts it in."""

    def _on_goal(self, handle: GoalHandle[Any, Any, Any]) -> None:
        handle.fail("RECOVERIES_EXHAUSTED", "every motion collides")


class TerrainEar(Node):
    """Hears what terrain is to be forgotten."""

    name = "ear"
    inputs = (TERRAIN_CLEARING,)

    def __init__(self) -> None:
        self.radii: list[float] = []

    def start(self) -> None:
        self.ctx.subscribe(TERRAIN_CLEARING, lambda radius: self.radii.append(radius.value))


def test_who_is_shut_in_tells_to_forget_the_terrain_around() -> None:
    survey, config = FrontierSurvey(SurveyConfig(), distance_field), ExploreConfig(shut_failures=1)
    explorer = ExplorerNode(config, survey, strategy_named("tour", distance_field))
    client, ear = Client(), TerrainEar()
    executor = LockstepExecutor(Stack([Stuck(two_rooms()), explorer, client, ear]))
    try:
        executor.run(20.0)
    finally:
        executor.close()
    assert ear.radii
    assert set(ear.radii) == {config.doubted}


def test_a_paused_gate_is_a_persons_wish() -> None:
    _, client = run(17.0, None, BrokenGate(GateState.PAUSED))
    assert client.outcome is None


def test_a_door_that_is_too_narrow_is_named_with_its_width() -> None:
    _, client = run(200.0, world=two_rooms(door=4, sees=8.0))
    assert client.outcome is not None
    assert client.outcome.code == "SUCCEEDED"
    long = [frontier for frontier in client.outcome.result.remaining if len(frontier.cells) > 10]
    assert long
    for frontier in long:
        words = re.search(r"about (\S+) m wide at \((\S+), (\S+)\)", frontier.reason)
        assert words is not None
        width, x, y = map(float, words.groups())
        assert width == pytest.approx(0.4, abs=0.11)
        assert (x, y) == pytest.approx((5.15, 2.7), abs=0.25)


@pytest.mark.parametrize("door", [7, 10])
def test_a_door_that_is_wide_enough_is_gone_through_and_nothing_is_narrow(door: int) -> None:
    robot, client = run(200.0, world=two_rooms(door, sees=3.5))
    assert client.outcome is not None
    assert robot.world.coverage() == pytest.approx(1.0, abs=0.01)
    assert not any("wide" in frontier.reason for frontier in client.outcome.result.remaining)


class Courteous(IdealRobot):
    """Stands aside for somebody from 3 s on, for 45 s, and says so, or does not."""

    name = "navigator"
    outputs = (MAP, GLOBAL_COSTMAP, TRANSFORMS, STATUS)

    def __init__(self, *, says_so: bool) -> None:
        super().__init__(two_rooms())
        self.says_so, self.is_aside = says_so, False

    def start(self) -> None:
        super().start()
        self.ctx.after(3.0, lambda: self._stand(is_aside=True))
        self.ctx.after(48.0, lambda: self._stand(is_aside=False))

    def _stand(self, *, is_aside: bool) -> None:
        self.is_aside = is_aside
        if self.says_so:
            code = "GIVING_WAY" if is_aside else "FOLLOWING"
            self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, code, "somebody holds the robot up", "{}"))

    def _tick(self) -> None:
        handle = self.handle
        self.handle = None if self.is_aside else handle
        super()._tick()
        self.handle = handle


@pytest.mark.parametrize("says_so", [True, False])
def test_while_the_navigator_lets_somebody_by_nothing_is_given_up(*, says_so: bool) -> None:
    survey = FrontierSurvey(SurveyConfig(), distance_field)
    explorer = ExplorerNode(ExploreConfig(), survey, strategy_named("tour", distance_field))
    robot, client = Courteous(says_so=says_so), Client()
    executor = LockstepExecutor(Stack([robot, explorer, client]))
    try:
        executor.run(170.0)
    finally:
        executor.close()
    gave_up = [s for s in client.status if s.node == "explorer" and "no progress" in s.text]
    assert (gave_up == []) == says_so
    assert client.outcome is not None
    assert client.outcome.is_success
