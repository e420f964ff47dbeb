"""Exploring a place of several levels: what is open on one is gone back to, and the way home leads through their passages."""

from __future__ import annotations

import numpy as np

from ambler.core.messages import CostGrid, FrontierState, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.exploration.strategies import NearestStrategy
from ambler.missions.drive_to import DriveTo
from ambler.missions.explore import ExploreMission
from ambler.missions.explore_commands import (
    ChangeLevel,
    Command,
    Ended,
    ExploreConfig,
    ExploreState,
    ExploreView,
    StopDriving,
    TurnAround,
)
from ambler.runtime.tasks import ExploreGoal
from tests.missions.test_explore import SPEC, S, ScriptedSurveyor, frontier

UP, DOWN = (0.0, 1.0, 18.0, 18.0, 0.0), (1.0, 0.0, 17.0, 18.0, 3.0)


class Levels(ScriptedSurveyor):
    """The surveyor of the first level, who makes those of the others."""

    def __init__(self) -> None:
        super().__init__()
        self.others: list[ScriptedSurveyor] = []

    def another(self) -> ScriptedSurveyor:
        self.others.append(ScriptedSurveyor())
        return self.others[-1]


class House:
    """A robot on level 0 of a house with two; it comes to the other level where it is asked to, at the passage."""

    def __init__(self, *, is_shut: bool = False) -> None:
        self.surveyor = Levels()
        self.surveyor.frontiers = [frontier(12, 10, 2.0)]
        self.mission = ExploreMission(ExploreConfig(), self.surveyor, NearestStrategy())  # type: ignore[arg-type]
        self.pose, self.level, self.now_ns, self.is_shut = SE2(10.0, 10.0), 0, 0, is_shut
        self.passages = np.zeros((0, 5))
        self.wanted: int | None = None
        self.changes: list[int] = []
        self.mission.begin(ExploreGoal(), 0)

    def step(self) -> list[Command]:
        self.now_ns += S
        grid = OccupancyGrid(self.now_ns, "map", SPEC, np.zeros(SPEC.shape, np.int8))
        costs = CostGrid(self.now_ns, "map", SPEC, np.zeros(SPEC.shape, np.uint8))
        view = ExploreView(self.now_ns, grid, costs, self.pose, self.level, self.passages)
        return self.mission.update(view, self.now_ns)

    def come_to(self, level: int) -> list[Command]:
        self.level, self.passages = level, np.array([UP, DOWN])
        return self.step()

    def live(self) -> Ended:
        """Drive wherever it is told; every frontier closes when it is reached."""
        for _ in range(400):
            for command in self.step():
                match command:
                    case Ended():
                        return command
                    case ChangeLevel():
                        self.wanted = command.level
                        self.changes.append(command.level)
                    case DriveTo():
                        self.pose = command.map_from_goal
                        here = [self.surveyor, *self.surveyor.others][self.level]
                        here.frontiers = [f for f in here.frontiers if f.goal != (*self.pose.as_array(),)]
                        ways = self.passages[self.passages[:, 0] == self.level] if self.wanted is not None else []
                        if not self.is_shut and any(np.allclose(w[2:], self.pose.as_array()) for w in ways):
                            self.level, self.wanted = int(self.wanted or 0), None
                        self.mission.drive_ended(command.drive, "SUCCEEDED", "")
                    case TurnAround():
                        self.mission.drive_ended(command.drive, "SUCCEEDED", "")
        raise AssertionError("it does not end")


def test_a_level_that_was_left_with_something_open_is_gone_back_to_and_home_is_where_it_was() -> None:
    house = House()
    house.step()
    assert house.mission.state is ExploreState.DRIVING
    commands = house.come_to(1)
    assert any(isinstance(c, StopDriving) for c in commands), "the goal is on the other level"
    house.surveyor.others[0].frontiers = [frontier(5, 5, 3.0)]
    ended = house.live()
    assert ended.code == "SUCCEEDED"
    assert ended.result.is_home
    assert house.changes == [0]
    assert house.level == 0
    assert ended.result.remaining == ()


def test_what_is_open_on_another_level_is_explored_before_the_end_on_the_level_of_the_start() -> None:
    house = House()
    house.surveyor.frontiers = []
    house.step()
    house.come_to(1)
    house.surveyor.others[0].frontiers = [frontier(5, 5, 3.0)]
    house.step()
    house.step()
    house.come_to(0)
    ended = house.live()
    assert (ended.code, house.changes) == ("SUCCEEDED", [1, 0])
    assert house.surveyor.others[0].frontiers == []


def test_home_on_another_level_is_reached_through_the_passage_when_nothing_is_open_there() -> None:
    house = House()
    house.surveyor.frontiers = []
    house.step()
    house.come_to(1)
    ended = house.live()
    assert (ended.code, house.changes, house.level) == ("SUCCEEDED", [0], 0)
    assert ended.result.is_home


def test_a_passage_that_leads_nowhere_ends_with_a_reason_and_what_is_left() -> None:
    house = House(is_shut=True)
    house.step()
    house.come_to(1)
    ended = house.live()
    assert ended.code == "RETURN_FAILED"
    assert "level 1 to level 0" in ended.text
    assert [f.state for f in ended.result.remaining] == [FrontierState.OPEN], "what is open on the other level is told"
    assert not ended.result.is_home


def left_behind(*open_on_the_way: tuple[float, float]) -> dict[int, tuple[FrontierState, ...]]:
    """Leave level 0 with one refused frontier at (5, 5) for what is open on level 1, and see others open on the way."""
    house = House()
    house.come_to(0)
    house.come_to(1)
    house.surveyor.others[0].frontiers = []
    house.surveyor.frontiers = [frontier(5.0, 5.0, 3.0)]
    house.mission._left.leave(1, (frontier(3.0, 3.0, 1.0),))
    house.come_to(0)
    house.mission._left.leave(1, (frontier(3.0, 3.0, 1.0),))
    for _ in range(2):
        empty = OccupancyGrid(0, "map", SPEC, np.zeros(SPEC.shape, np.int8))
        house.surveyor.memory.refuse(house.surveyor.frontiers[0], "-", empty, has_looked=True)
    while not any(isinstance(c, ChangeLevel) for c in house.step()):
        assert house.now_ns < 100 * S
    house.surveyor.reset()
    house.surveyor.frontiers = [frontier(*place, 3.0) for place in open_on_the_way]
    house.step()
    house.come_to(1)
    return {0: tuple(f.state for f in house.mission._left.frontiers)}


def test_what_was_judged_before_a_level_was_left_does_not_call_the_robot_back():
    assert left_behind((5.2, 5.0)) == {0: (FrontierState.UNREACHABLE,)}


def test_what_opens_elsewhere_on_the_way_does():
    assert left_behind((15.0, 15.0)) == {0: (FrontierState.OPEN,)}
