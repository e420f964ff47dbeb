"""Exploring with stations: where the robot holds still, where not, and that nothing else becomes of the exploration."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.missions.drive_to import DriveTo
from ambler.missions.explore_commands import (
    Command,
    Ended,
    ExploreState,
    ExploreView,
    HoldStation,
    StopDriving,
    TurnAround,
)
from ambler.missions.stations import Stations, StationsConfig
from tests.missions.test_explore import Play, S, frontier

SPACING = 4.0
NOWHERE = np.zeros((0, 5))


class StationPlay(Play):
    """A mission with stations; the robot leans by `tilt`, on `level` with `passages`."""

    def __init__(self, *frontiers: object, spacing: float = SPACING, **config: float) -> None:
        super().__init__(*frontiers, stations=StationsConfig(spacing=spacing, hold=5.0), **config)  # type: ignore[arg-type]
        self.tilt, self.passages = 0.0, NOWHERE

    def view(self) -> ExploreView:
        return replace(super().view(), tilt=self.tilt, passages=self.passages)

    def hold(self) -> HoldStation:
        """Step and return the station that is begun now, after the drive was stopped."""
        stop, hold = self.step()
        assert isinstance(stop, StopDriving)
        assert isinstance(hold, HoldStation)
        return hold

    def held(self, hold: HoldStation, code: str = "SUCCEEDED") -> list[Command]:
        """End a station, five seconds later."""
        self.now_ns += 5 * S
        self.mission.drive_ended(hold.drive, code, "")
        return self.step(0.01)


def holds(commands: list[Command]) -> list[HoldStation]:
    return [c for c in commands if isinstance(c, HoldStation)]


def test_it_holds_still_on_its_way_and_then_goes_on_to_the_same_frontier() -> None:
    play = StationPlay(frontier(16, 10, 6.0), frontier(3, 10, 7.0))
    drive = play.drive()
    hold = play.hold()
    assert (hold.seconds, hold.level) == (5.0, 0)
    assert play.mission.state is ExploreState.SCANNING
    assert play.mission.text == "scanning station 1"
    assert play.step() == []  # nothing else meanwhile
    (again,) = play.held(hold)
    assert again == replace(drive, drive=again.drive)  # type: ignore[union-attr]
    assert again.drive > hold.drive > drive.drive  # type: ignore[union-attr]
    assert play.mission.state is ExploreState.DRIVING
    assert play.mission.feedback.stations == 1
    assert play.step() == []  # and it drives, to what it had chosen


def test_stations_are_as_far_apart_as_was_asked() -> None:
    play = StationPlay(frontier(16, 10, 6.0))
    play.drive()
    play.held(play.hold())
    for x in (11.0, 12.5, 13.9):
        play.pose = SE2(x, 10.0)
        assert holds(play.step()) == []
    play.pose = SE2(14.0, 10.0)
    hold = play.hold()
    assert play.mission.text == "scanning station 2"
    play.held(hold)
    play.pose = SE2(10.3, 10.3)  # back where one was
    assert holds(play.step()) == []
    assert play.mission.feedback.stations == 2


def test_without_a_spacing_there_are_none() -> None:
    play = StationPlay(frontier(16, 10, 6.0), spacing=0.0)
    play.drive()
    for x in np.arange(10.0, 16.0, 0.5):
        play.pose = SE2(float(x), 10.0)
        assert holds(play.step()) == []
    assert play.mission.feedback.stations == 0


def test_every_level_has_stations_of_its_own() -> None:
    stations = Stations(StationsConfig(spacing=SPACING))
    stations.start(0, SE2(1.0, 1.0))
    stations.end(is_held=True)
    assert not stations.is_due(0, SE2(2.0, 1.0), 0.0, NOWHERE)
    assert stations.is_due(1, SE2(2.0, 1.0), 0.0, NOWHERE)
    stations.begin()
    assert stations.is_due(0, SE2(2.0, 1.0), 0.0, NOWHERE)


def test_there_is_none_on_ramps_nor_at_passages() -> None:
    play = StationPlay(frontier(16, 10, 6.0))
    play.tilt = math.radians(9.0)  # as steep as car parks are
    play.drive()
    assert holds(play.step()) == []
    play.tilt = math.radians(3.0)
    play.passages = np.array([[0.0, 1.0, 11.0, 11.0, 0.0]])
    assert holds(play.step()) == []
    play.passages = np.array([[1.0, 0.0, 11.0, 11.0, 0.0]])  # of another level
    play.hold()


def test_a_place_where_none_was_to_be_had_is_left_for_half_the_spacing() -> None:
    play = StationPlay(frontier(16, 10, 6.0))
    play.drive()
    (again,) = play.held(play.hold(), "NOT_AT_REST")
    assert isinstance(again, DriveTo)
    assert play.mission.feedback.stations == 0
    play.pose = SE2(11.9, 10.0)
    assert holds(play.step()) == []
    play.pose = SE2(12.1, 10.0)
    play.hold()
    assert play.mission.text == "scanning station 1"


@pytest.mark.parametrize("code", ["NOT_AT_REST", "MOVED", "LOST", "STALE_INPUT", "PREEMPTED"])
def test_stations_that_fail_are_no_failure_of_the_exploration(code: str) -> None:
    play = StationPlay(*(frontier(x, 10, abs(x - 10.0)) for x in (2, 6, 14, 18)), spacing=1.0)
    tries, drives = 0, 0
    for _ in range(400):
        for command in play.step():
            match command:
                case HoldStation():
                    tries += 1
                    play.mission.drive_ended(command.drive, code, "")
                case DriveTo():
                    drives += 1
                    goal = command.map_from_goal
                    way = goal.x - play.pose.x
                    play.pose = SE2(play.pose.x + math.copysign(min(0.5, abs(way)), way), 10.0)
                    if abs(goal.x - play.pose.x) < 0.1:
                        play.surveyor.frontiers = [f for f in play.surveyor.frontiers if f.goal[0] != goal.x]  # type: ignore[index]
                        play.mission.drive_ended(command.drive, "SUCCEEDED", "")
                case TurnAround():
                    play.mission.drive_ended(command.drive, "SUCCEEDED", "")
                case Ended():
                    assert command.code == "SUCCEEDED"
                    assert command.result.is_home
                    assert tries > 3
                    return
        if play.mission.state in (ExploreState.DRIVING, ExploreState.RETURNING):
            way = play.mission._way.map_from_goal.x - play.pose.x  # type: ignore[union-attr]
            play.pose = SE2(play.pose.x + math.copysign(min(0.5, abs(way)), way), 10.0)
            if abs(way) < 0.6:
                play.surveyor.frontiers = [
                    f
                    for f in play.surveyor.frontiers
                    if abs(f.goal[0] - play.pose.x) > 0.6  # type: ignore[index]
                ]
                play.mission.drive_ended(play.mission._drive, "SUCCEEDED", "")
    raise AssertionError(f"the mission does not end: {play.mission.state} {play.mission.text}, {tries} tries")


def test_holding_still_for_long_is_not_being_stuck() -> None:
    play = StationPlay(frontier(16, 10, 6.0), progress_timeout=6.0)
    play.drive()
    play.step(4.0)
    assert play.mission.state is ExploreState.SCANNING
    hold = play.mission._drive
    for _ in range(20):
        assert play.step() == []
    play.mission.drive_ended(hold, "SUCCEEDED", "")
    (again,) = play.step(0.01)
    assert isinstance(again, DriveTo)
    assert play.step(5.0) == []  # time without progress counts from now


def test_in_doubt_of_its_map_it_begins_none_and_breaks_one_off() -> None:
    play = StationPlay(frontier(16, 10, 6.0), frontier(3, 10, 7.0))
    play.drive()
    play.mission.doubt("it fits nothing", play.now_ns)
    assert holds(play.step()) == []
    play.mission.doubt("", play.now_ns)
    play.step()
    assert play.mission.state is ExploreState.LOOKING
    play.drive(3.0)
    play.hold()
    play.mission.doubt("it fits nothing", play.now_ns)
    commands = play.step()
    assert isinstance(commands[0], StopDriving)
    assert play.mission.state is ExploreState.DOUBTING
    assert play.mission.feedback.stations == 0


def test_while_the_gate_holds_it_none_begins() -> None:
    play = StationPlay(frontier(16, 10, 6.0))
    play.drive()
    play.mission.hold("no scan", play.now_ns)
    assert holds(play.step()) == []
    play.mission.hold("", play.now_ns)
    play.hold()


def test_how_a_drive_ended_is_judged_before_a_station_begins() -> None:
    play = StationPlay(frontier(16, 10, 6.0))
    drive = play.drive()
    assert holds(play.end(drive)) == []
    assert play.mission.state is ExploreState.LOOKING
    hold = play.hold()  # it stands there anyway
    assert play.held(hold) == []
    assert play.mission.state is ExploreState.LOOKING
    assert play.mission.feedback.goals_reached == 1


def test_on_the_way_home_it_holds_where_none_is_near() -> None:
    play = StationPlay()
    (turn,) = play.step()
    assert isinstance(turn, TurnAround)
    assert holds(play.step()) == []  # not while it turns
    play.end(turn)
    while play.mission.state is not ExploreState.RETURNING:
        play.pose = SE2(15.0, 10.0)
        assert holds(play.step()) == []
    home = play.mission._way
    hold = play.hold()
    (again,) = play.held(hold)
    assert play.mission.state is ExploreState.RETURNING
    assert again == replace(home, drive=again.drive)  # type: ignore[type-var, union-attr]
    play.pose = SE2(14.0, 10.0)
    assert holds(play.step()) == []


def test_a_cancelled_exploration_stops_its_station() -> None:
    play = StationPlay(frontier(16, 10, 6.0))
    play.drive()
    play.hold()
    stop, ended = play.mission.cancel()
    assert isinstance(stop, StopDriving)
    assert isinstance(ended, Ended)
    assert ended.code == "CANCELLED"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"spacing": 0.3}, "spacing"),
        ({"spacing": -2.0}, "spacing"),
        ({"spacing": math.nan}, "spacing"),
        ({"hold": 0.0}, "hold"),
        ({"hold": 1e4}, "hold"),
        ({"tilt_most": 0.0}, "tilt_most"),
    ],
)
def test_what_cannot_be_is_refused(settings: dict[str, float], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        StationsConfig(**settings)
