"""The explorer on the bus with stations: they are held on the way, and whatever becomes of them, the place is explored and the robot comes home."""

from __future__ import annotations

from typing import Any

import pytest

from ambler.core.messages import PoseStamped, Status
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.exploration.grid_world import GridWorld
from ambler.exploration.strategies import strategy_named
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.missions.explore_commands import ExploreConfig
from ambler.missions.stations import StationsConfig
from ambler.nodes.explorer import ExplorerNode
from ambler.planning.distance import distance_field
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import GoalHandle, Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import CLICKED_GOAL_OVER, SCAN_STATION, ScanStationGoal, ScanStationResult
from ambler.runtime.topics import GOAL, STATUS
from tests.missions.test_explorer_node import Client, IdealRobot, two_rooms

SPACING, S = 3.0, 1_000_000_000


class TimedRobot(IdealRobot):
    """Remembers when it was sent somewhere."""

    def __init__(self, world: GridWorld) -> None:
        super().__init__(world)
        self.goals_ns: list[int] = []

    def _on_goal(self, handle: GoalHandle[Any, Any, Any]) -> None:
        self.goals_ns.append(self.ctx.now_ns)
        super()._on_goal(handle)


class Collector(Node):
    """Ends every station after the time that is asked for, with a code; remembers where the robot was when it began and ended. With `other` somebody else asks for
    a station, too, and takes the place of the explorer's."""

    name = "stations"
    serves = (SCAN_STATION,)

    def __init__(self, robot: IdealRobot, code: str, *, other: bool = False) -> None:
        self.robot, self.code = robot, code
        self.calls = (SCAN_STATION,) if other else ()
        self.places: list[tuple[float, float]] = []
        self.moved: list[float] = []
        self.goals: list[ScanStationGoal] = []
        self.begun_ns: list[int] = []

    def start(self) -> None:
        self.ctx.serve_task(SCAN_STATION, self._on_goal, lambda handle: handle.cancelled())

    def _on_goal(self, handle: GoalHandle[Any, Any, Any]) -> None:
        pose = self.robot.world.pose
        self.goals.append(handle.goal)
        self.begun_ns.append(self.ctx.now_ns)
        self.places.append((pose.x, pose.y))
        if self.calls and len(self.goals) % 2:
            self.ctx.after(1.0, lambda: self.ctx.send_goal(SCAN_STATION, ScanStationGoal(1.0), lambda outcome: None))
        self.ctx.after(handle.goal.seconds, lambda: self._over(handle, pose))

    def _over(self, handle: GoalHandle[Any, Any, Any], begun: Any) -> None:
        if handle.is_active:
            self.moved.append(begun.distance_to(self.robot.world.pose))
        if self.code == "SUCCEEDED":
            handle.succeed(ScanStationResult(len(self.places), handle.goal.seconds, 50, 1000))
        else:
            handle.fail(self.code, "it was not to be", ScanStationResult(0, 0.0, 0, 0))


def explored(
    code: str = "SUCCEEDED", *, other: bool = False, cancel_after: float | None = None, others: tuple[Node, ...] = ()
) -> Any:
    config = ExploreConfig(stations=StationsConfig(spacing=SPACING, hold=4.0))
    explorer = ExplorerNode(
        config, FrontierSurvey(SurveyConfig(), distance_field), strategy_named("tour", distance_field)
    )
    robot, client = TimedRobot(two_rooms()), Client(cancel_after)
    collector = Collector(robot, code, other=other)
    executor = LockstepExecutor(Stack([robot, explorer, client, collector, *others]))
    try:
        executor.run(400.0)
    finally:
        executor.close()
    return robot, client, collector


def test_it_stands_at_every_station_and_tells_their_number() -> None:
    _, client, collector = explored()
    assert client.outcome is not None
    assert client.outcome.code == "SUCCEEDED"
    assert client.outcome.result.is_home
    assert len(collector.places) >= 3
    assert {(goal.seconds, goal.level) for goal in collector.goals} == {(4.0, 0)}
    assert max(collector.moved) == 0.0
    for k, (x, y) in enumerate(collector.places):
        assert all((x - a) ** 2 + (y - b) ** 2 >= SPACING**2 for a, b in collector.places[:k])
    told = [s.text for s in client.status if s.code == "SCANNING"]
    assert told == [f"scanning station {k + 1}" for k in range(len(collector.places))]
    assert client.feedback[-1].stations == len(collector.places)
    assert any(f.state == "SCANNING" and f.stations == 1 for f in client.feedback)


@pytest.mark.parametrize("code", ["MOVED", "NOT_AT_REST", "LOST"])
def test_without_a_single_station_it_explores_all_the_same(code: str) -> None:
    _, client, collector = explored(code)
    assert client.outcome is not None
    assert client.outcome.code == "SUCCEEDED"
    assert client.outcome.result.is_home
    assert 3 <= len(collector.places) <= 40
    assert client.feedback[-1].stations == 0


def test_somebody_else_who_asks_for_stations_does_not_hold_it_up() -> None:
    _, client, _ = explored(other=True)
    assert client.outcome is not None
    assert client.outcome.code == "SUCCEEDED"


class Person(Node):
    """Clicks a goal in the middle of the first station, and drives there for 20 s."""

    name = "navigator"
    outputs = (GOAL, STATUS)

    def start(self) -> None:
        pose = SE3.from_se2(SE2(2.0, 2.0))
        self.ctx.after(3.0, lambda: self.ctx.publish(GOAL, PoseStamped(self.ctx.now_ns, "map", pose)))
        self.ctx.after(23.0, self._arrive)

    def _arrive(self) -> None:
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, CLICKED_GOAL_OVER, "SUCCEEDED"))


def test_who_clicks_a_goal_during_a_station_drives_first() -> None:
    robot, client, collector = explored(others=(Person(),))
    assert client.outcome is not None
    assert client.outcome.code == "SUCCEEDED"
    begun, again = collector.begun_ns[:2]
    assert begun < 3 * S
    assert again > 23 * S
    assert not [t for t in robot.goals_ns if begun < t < 23 * S]


def test_cancelling_the_exploration_cancels_the_station() -> None:
    robot, client, collector = explored(cancel_after=4.5)
    assert client.outcome is not None
    assert client.outcome.code == "CANCELLED"
    assert len(collector.places) == 1
    assert collector.moved == []
    assert robot.handle is None
