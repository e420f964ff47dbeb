"""The exploration mission on scripted surveys: every way to end, what it refuses, when it switches, and that it can be cancelled."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.messages import CostGrid, Frontier, FrontierState, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.exploration.memory import FrontierMemory
from ambler.exploration.strategies import NearestStrategy
from ambler.exploration.survey import Survey, SurveyConfig
from ambler.missions.company import Company
from ambler.missions.drive_to import DriveTo
from ambler.missions.explore import ExploreMission
from ambler.missions.explore_commands import (
    ClearCosts,
    Command,
    DoubtTerrain,
    Ended,
    ExploreConfig,
    ExploreState,
    ExploreView,
    StopDriving,
    TurnAround,
)
from ambler.runtime.tasks import ExploreGoal

SPEC = GridSpec(0.1, 200, 200, 0.0, 0.0)
S = 1_000_000_000


def frontier(x: float, y: float, distance: float) -> Frontier:
    """A frontier one metre long whose goal is its middle."""
    cells = np.stack([np.linspace(x - 0.5, x + 0.5, 11), np.full(11, y)], axis=1).astype(np.float32)
    return Frontier(cells, (x, y), (x, y, 0.0), distance, FrontierState.OPEN)


class ScriptedSurveyor:
    """Shows the frontiers that the test puts there, and consults the real memory."""

    def __init__(self) -> None:
        self.config = SurveyConfig()
        self.frontiers: list[Frontier] = []
        self.full_searches = 0
        self.reachable_area = 50.0
        self.is_strict = False
        self.is_hiding = False
        self.left_when_strict: list[Frontier] = []
        self.looks: list[SE2] = []
        self.reset()

    def reset(self) -> None:
        self.memory = FrontierMemory(self.config.memory, self.config.free_below)

    def forget_map(self) -> None:
        self.full_searches += 1

    def hides(self, frontier: Frontier, occupancy: OccupancyGrid) -> bool:
        return self.is_hiding

    def explained(self, survey: Survey, occupancy: OccupancyGrid, map_from_base: SE2) -> Survey:
        return survey

    def look_at_speck(self, survey: Survey, map_from_base: SE2) -> SE2 | None:
        return self.looks.pop(0) if self.looks else None

    def update(self, occupancy: OccupancyGrid, costs: CostGrid, base: SE2, boundary: object = ()) -> Survey:
        judged: list[Frontier] = []
        for f in [*self.frontiers, *(self.left_when_strict if self.is_strict else [])]:
            reason = self.memory.reason_against(f, occupancy)
            judged.append(replace(f, state=FrontierState.UNREACHABLE, reason=reason) if reason else f)
        is_open = tuple(i for i, f in enumerate(judged) if f.state is FrontierState.OPEN)
        shut = tuple(i for i, f in enumerate(judged) if f.state is FrontierState.UNREACHABLE)
        return Survey(tuple(judged), np.ones(len(judged)), is_open, 100.0, self.reachable_area, costs, shut=shut)


class Play:
    """A mission, its surveyor, and a clock that moves by hand."""

    def __init__(self, *frontiers: Frontier, goal: ExploreGoal | None = None, **config: float) -> None:
        self.surveyor = ScriptedSurveyor()
        self.surveyor.frontiers = list(frontiers)
        self.mission = ExploreMission(ExploreConfig(**config), self.surveyor, NearestStrategy())  # type: ignore[arg-type]
        self.map = np.zeros(SPEC.shape, np.int8)
        self.costs = np.zeros(SPEC.shape, np.uint8)
        self.pose = SE2(10.0, 10.0)
        self.now_ns = 0
        self.mission.begin(goal or ExploreGoal(), 0)

    def view(self) -> ExploreView:
        costs = CostGrid(self.now_ns, "map", SPEC, self.costs.copy())
        return ExploreView(self.now_ns, OccupancyGrid(self.now_ns, "map", SPEC, self.map.copy()), costs, self.pose)

    def step(self, seconds: float = 1.0) -> list[Command]:
        self.now_ns += round(seconds * S)
        return self.mission.update(self.view(), self.now_ns)

    def drive(self, seconds: float = 1.0) -> DriveTo:
        """Step and return the drive that is commanded now."""
        drives = [c for c in self.step(seconds) if isinstance(c, DriveTo)]
        assert len(drives) == 1
        return drives[0]

    def end(self, drive: DriveTo | TurnAround, code: str = "SUCCEEDED", text: str = "") -> list[Command]:
        self.mission.drive_ended(drive.drive, code, text)
        return self.step(0.01)

    def until_ended(self, code: str = "SUCCEEDED") -> Ended:
        """Step on, ending every drive with a code, until the mission is over."""
        for _ in range(300):
            for command in self.step():
                match command:
                    case Ended():
                        return command
                    case DriveTo() | TurnAround():
                        self.mission.drive_ended(command.drive, code, "")
                        if isinstance(command, DriveTo) and code == "SUCCEEDED":
                            self.pose = command.map_from_goal
        raise AssertionError("the mission does not end")


def test_nothing_to_explore_turns_sweeps_goes_home_and_ends_with_proof() -> None:
    play = Play()
    (turn,) = play.step()
    assert isinstance(turn, TurnAround)
    assert turn.angle == pytest.approx(2 * math.pi)
    play.end(turn)
    assert play.mission.state is ExploreState.LOOKING
    ended = play.until_ended()
    assert (ended.code, ended.text) == ("SUCCEEDED", "no frontier is left")
    assert ended.result.is_home
    assert ended.result.remaining == ()
    assert play.surveyor.full_searches >= 1


def test_it_drives_to_the_nearest_and_counts_what_it_reached() -> None:
    play = Play(frontier(5, 5, 8.0), frontier(12, 10, 2.0))
    drive = play.drive()
    assert (drive.map_from_goal.x, drive.map_from_goal.y) == (12.0, 10.0)
    marked = [f.state for f in play.mission.frontiers()]
    assert marked == [FrontierState.OPEN, FrontierState.TARGET]
    play.surveyor.frontiers = [frontier(5, 5, 8.0)]
    play.end(drive)
    assert play.mission.feedback.goals_reached == 1
    assert play.drive(2.0).map_from_goal.x == 5.0


def test_it_turns_to_the_next_as_soon_as_the_target_is_gone() -> None:
    play = Play(frontier(12, 10, 2.0), frontier(5, 5, 8.0))
    play.drive()
    play.surveyor.frontiers = [frontier(5, 5, 7.0)]
    assert play.drive().map_from_goal.x == 5.0
    assert play.mission.state is ExploreState.DRIVING
    assert play.mission.feedback.goals_reached == 1


def test_a_target_that_closed_by_assumption_is_driven_to_and_counts_as_looked_at() -> None:
    play = Play(frontier(12, 10, 2.0), frontier(5, 5, 8.0))
    drive = play.drive()
    play.surveyor.is_hiding = True
    play.surveyor.frontiers = [frontier(5, 5, 7.0)]
    for _ in range(3):
        assert play.step() == [], "it is not known yet what is there"
    assert play.mission.feedback.goals_reached == 0
    play.pose = drive.map_from_goal
    play.end(drive)
    assert play.drive(2.0).map_from_goal.x == 5.0
    refusal = play.surveyor.memory.find(frontier(12, 10, 2.0))
    assert refusal is not None
    assert (refusal.looks, refusal.reason) == (1, "its ground is only assumed")


@pytest.mark.parametrize(("away", "is_given_up"), [(4.0, True), (9.0, False)])
def test_a_place_that_shuts_whenever_the_robot_comes_near_is_given_up(away: float, *, is_given_up: bool) -> None:
    play = Play(frontier(12, 10, 20.0), frontier(5, 5, 40.0), progress_timeout=500.0)
    play.surveyor.memory = FrontierMemory(play.surveyor.config.memory, 50, assumed=25)
    for _ in range(3):
        play.pose = SE2(12.0, 10.0 - away)
        play.surveyor.frontiers[0] = frontier(12, 10, 20.0)
        assert play.drive(20.0).map_from_goal.x == 12.0
        play.surveyor.frontiers[0] = replace(frontier(12, 10, 20.0), state=FrontierState.UNREACHABLE)
        assert play.drive().map_from_goal.x == 5.0
    play.surveyor.frontiers[0] = frontier(12, 10, 2.0)
    play.step(20.0)
    assert (play.mission.frontiers()[0].reason == "given up after 3 visits: it closes and opens again") == is_given_up


def test_a_drive_to_what_closed_by_assumption_ends_when_it_fails_or_stands_still() -> None:
    play = Play(frontier(12, 10, 2.0), frontier(5, 5, 8.0), progress_timeout=10.0)
    drive = play.drive()
    play.surveyor.is_hiding = True
    play.surveyor.frontiers = [frontier(5, 5, 7.0)]
    for k in range(10):
        play.pose = SE2(10.0 + 0.4 * k, 10.0)
        assert play.step() == [], "it moves on"
    for _ in range(20):
        if StopDriving() in play.step():
            break
    else:
        raise AssertionError("it stands still for ever")
    play = Play(frontier(12, 10, 2.0), frontier(5, 5, 8.0))
    drive = play.drive()
    play.surveyor.is_hiding = True
    play.surveyor.frontiers = [frontier(5, 5, 7.0)]
    play.step()
    play.end(drive, "NO_VALID_PATH")
    assert play.drive(2.0).map_from_goal.x == 5.0


def test_hysteresis_keeps_the_target_unless_another_is_clearly_better() -> None:
    play = Play(frontier(5, 5, 5.0), frontier(15, 15, 5.5))
    play.drive()
    play.surveyor.frontiers = [frontier(5, 5, 5.0), frontier(15, 15, 4.2)]
    assert play.step() == []
    play.surveyor.frontiers = [frontier(5, 5, 5.0), frontier(15, 15, 3.9)]
    assert play.drive().map_from_goal.x == 15.0


def test_a_goal_that_moved_with_the_map_is_sent_again() -> None:
    play = Play(frontier(5, 5, 5.0))
    first = play.drive()
    play.surveyor.frontiers = [frontier(5.1, 5.2, 5.0)]
    assert play.step() == []
    play.surveyor.frontiers = [frontier(5.2, 5.4, 5.0)]
    second = play.drive()
    assert second.map_from_goal.y == pytest.approx(5.4)
    assert not play.mission.drive_ended(first.drive, "PREEMPTED", "")
    assert play.step() == []
    assert play.mission.state is ExploreState.DRIVING


def test_a_failed_frontier_is_refused_with_its_reason_and_others_come_first() -> None:
    play = Play(frontier(12, 10, 2.0), frontier(5, 5, 8.0))
    play.end(play.drive(), "NO_VALID_PATH", "no way through")
    assert play.drive(2.0).map_from_goal.x == 5.0
    refused = play.mission.frontiers()[0]
    assert refused.state is FrontierState.UNREACHABLE
    assert refused.reason == "attempt 1 failed: NO_VALID_PATH: no way through"


def test_a_refused_frontier_is_tried_again_when_the_map_near_it_changes_but_three_times_at_most() -> None:
    play = Play(frontier(12, 10, 2.0), frontier(5, 5, 8.0))
    for attempt in range(3):
        drive = play.drive(2.0)
        assert drive.map_from_goal.x == 12.0, f"attempt {attempt}"
        play.end(drive, "RECOVERIES_EXHAUSTED")
        play.map[95 + attempt, 110:130] = 100
        play.map[105 - attempt, 100:130] = 100
    assert play.drive(2.0).map_from_goal.x == 5.0
    assert play.mission.frontiers()[0].reason == "given up after 3 attempts: RECOVERIES_EXHAUSTED"


def test_a_frontier_that_stays_after_two_looks_from_near_is_left() -> None:
    play = Play(frontier(12, 10, 2.0), goal=ExploreGoal(return_to_start=False))
    play.pose = SE2(12.0, 9.6)
    for _ in range(2):
        play.end(play.drive(2.0))
    ended = play.until_ended()
    assert ended.code == "SUCCEEDED"
    assert ended.result.goals_reached == 2
    (left,) = ended.result.remaining
    assert left.reason == "looked at 2 times: nothing changed"


def test_an_arrival_far_from_the_frontier_is_an_attempt_not_a_look() -> None:
    play = Play(frontier(12, 10, 2.0))
    play.pose = SE2(12.0, 7.0)
    play.end(play.drive())
    play.step(2.0)
    assert play.mission.frontiers()[0].reason == "attempt 1 failed: the drive ended 3.0 m away"


def test_an_arrival_at_a_viewpoint_far_from_the_frontier_is_a_look() -> None:
    play = Play(replace(frontier(12, 10, 2.0), goal=(12.0, 4.5, 1.57)))
    play.pose = SE2(12.0, 4.3)
    for _ in range(2):
        play.end(play.drive(2.0))
    play.step(2.0)
    assert play.mission.frontiers()[0].reason == "looked at 2 times: nothing changed"


def test_before_it_is_over_it_asks_for_what_is_only_assumed() -> None:
    play = Play(frontier(12, 10, 2.0), goal=ExploreGoal(return_to_start=False))
    play.surveyor.left_when_strict = [frontier(5, 10, 5.0)]
    assert play.drive().map_from_goal.x == 12.0
    play.surveyor.frontiers.clear()
    assert play.drive().map_from_goal.x == 5.0


def test_the_final_sweep_pardons_each_refused_frontier_once() -> None:
    play = Play(frontier(12, 10, 2.0), goal=ExploreGoal(return_to_start=False))
    play.end(play.drive(), "NO_VALID_PATH")
    commands = play.step(2.0)
    assert commands == [ClearCosts()]
    assert play.surveyor.full_searches == 1
    play.end(play.drive(3.0), "NO_VALID_PATH")
    ended = play.until_ended("NO_VALID_PATH")
    assert ended.code == "SUCCEEDED"
    assert ended.result.remaining[0].reason == "given up after 3 attempts: NO_VALID_PATH"


def test_no_progress_stops_the_drive_and_refuses_the_frontier() -> None:
    play = Play(frontier(12, 10, 2.0), progress_timeout=10.0)
    play.drive()
    for _ in range(10):
        assert play.step() == []
    assert play.step() == [StopDriving()]
    assert play.mission.state is ExploreState.LOOKING
    play.step(2.0)
    assert play.mission.frontiers()[0].reason == "attempt 1 failed: no progress for 10 s"


def test_a_slow_robot_that_makes_progress_is_left_alone() -> None:
    play = Play(frontier(12, 10, 9.0), progress_timeout=10.0)
    play.drive()
    for k in range(40):
        play.surveyor.frontiers = [frontier(12, 10, 9.0 - 0.05 * k)]
        assert play.step() == []


def test_a_target_that_changes_for_ever_does_not_hide_that_the_robot_stands_still() -> None:
    near, far = 2.0, 3.5
    play = Play(frontier(12, 10, near), frontier(8, 10, far), progress_timeout=10.0)
    play.drive()
    for k in range(30):
        a, b = (near, far) if k % 2 else (far, near)
        play.surveyor.frontiers = [frontier(12, 10, a), frontier(8, 10, b)]
        if any(isinstance(c, StopDriving) for c in play.step()):
            break
    assert 9 <= k <= 11


def test_a_robot_between_two_targets_decides_for_one() -> None:
    play = Play(frontier(12, 10, 6.0), frontier(8, 10, 8.0))
    play.drive()
    changes = 0
    for k in range(60):
        near, far = (6.0, 8.0) if k % 2 else (8.0, 6.0)  # each look makes the other one seem nearer
        play.surveyor.frontiers = [frontier(12, 10, near), frontier(8, 10, far)]
        play.pose = SE2(10.0 + 0.4 * (k % 2), 10.0)
        changes += sum(isinstance(c, DriveTo) for c in play.step())
    assert changes <= 2


def test_failing_everywhere_at_one_place_is_stuck() -> None:
    frontiers = [frontier(2.0 + 2 * k, 5.0, 3.0 + k) for k in range(8)]
    play = Play(*frontiers)
    ended = play.until_ended("RECOVERIES_EXHAUSTED")
    assert ended.code == "STUCK"
    assert int(ended.text.split()[0]) >= 8
    assert "drives failed at one place" in ended.text
    assert play.now_ns >= 120 * S, "whoever stands in the way may leave"
    assert len(ended.result.remaining) == 8


def test_who_is_held_by_people_is_stuck_only_after_much_longer() -> None:
    play = Play(*[frontier(2.0 + 2 * k, 5.0, 3.0 + k) for k in range(8)], stuck_time=20.0, company_patience=5.0)
    play.mission.meet(0, is_here=True)
    assert play.until_ended("RECOVERIES_EXHAUSTED").code == "STUCK"
    assert 100 * S <= play.now_ns < 150 * S


def test_a_look_past_people_that_takes_too_long_is_broken_off_before_the_robot_turns() -> None:
    """A turn beside a drive that goes on would displace it, as a person's own drive does."""
    shut = replace(frontier(16, 10, math.inf), goal=None, state=FrontierState.UNREACHABLE, reason="no way")
    play = Play(frontier(12, 10, 2.0), shut, lookout_time=20.0)
    play.mission.meet(0, is_here=True)
    drive = play.drive()
    for x in np.arange(10.0, 13.0, 0.5):
        play.pose = SE2(float(x), 10.0)
        play.step(0.1)
    play.pose, play.surveyor.frontiers = SE2(10.0, 10.0), [shut]
    play.end(drive)
    told = [command for _ in range(10) for command in play.step()]
    assert isinstance(told[-1], DriveTo), "which nobody ends"
    play.pose = SE2(12.4, 10.0)
    later = [command for _ in range(25) for command in play.step()]
    turn = next(k for k, command in enumerate(later) if isinstance(command, TurnAround))
    assert any(isinstance(command, StopDriving) for command in later[:turn])


@pytest.mark.parametrize("people", [True, False])
def test_a_robot_that_people_shut_in_makes_room_for_them_every_second_time(people: bool) -> None:
    """Who stands in a corridor may wait for the robot to leave: it goes back to where it was two metres away, then four, as far as it came."""
    frontiers = [frontier(18.0, 5.0 + 2 * k, 6.0 + k) for k in range(4)]
    play = Play(*frontiers, goal=ExploreGoal(return_to_start=False))
    play.drive()
    for x in np.arange(10.0, 14.1, 0.5):
        play.pose = SE2(float(x), 10.0)
        play.step(0.1)
    play.mission.meet(play.now_ns, is_here=people)
    told: list[str] = []
    places: list[float] = []
    for _ in range(120):
        for command in play.step():
            assert not isinstance(command, Ended)
            if isinstance(command, DriveTo) and "making room" in play.mission.text:
                places.append(command.map_from_goal.x)
                assert command.map_from_goal.yaw == pytest.approx(0.0, abs=0.1)
            if isinstance(command, DriveTo | TurnAround):
                told.append(play.mission.text)
                play.mission.drive_ended(command.drive, "NO_VALID_PATH", "")
    shut_in = [text for text in told if "shut in" in text]
    assert len(places) == (len(shut_in) // 2 if people else 0)
    assert len(shut_in) >= 6
    assert places[:3] == pytest.approx([12.0, 10.0, 10.0][: len(places)], abs=0.6)


def test_a_robot_that_is_shut_in_doubts_the_terrain_around_it_and_not_before() -> None:
    play = Play(*[frontier(2.0 + 2 * k, 5.0, 3.0 + k) for k in range(4)], goal=ExploreGoal(return_to_start=False))
    failed, doubts = 0, []
    while play.now_ns < 60 * S:
        for command in play.step():
            if isinstance(command, DoubtTerrain):
                doubts.append((failed, command.radius))
            if isinstance(command, DriveTo | TurnAround):
                failed += isinstance(command, DriveTo)
                play.mission.drive_ended(command.drive, "RECOVERIES_EXHAUSTED", "")
    assert doubts[0] == (3, play.mission.config.doubted), "drives to three places failed from here"
    assert len(doubts) >= 2


@pytest.mark.parametrize("code", ["NO_VALID_PATH", "RECOVERIES_EXHAUSTED"])
def test_who_cannot_move_on_the_way_home_doubts_the_terrain(code: str) -> None:
    play = Play(return_time=60.0)
    play.step()
    doubts = []
    for _ in range(40):
        for command in play.step():
            if isinstance(command, DoubtTerrain):
                doubts.append(command)
            if isinstance(command, DriveTo):
                play.mission.drive_ended(command.drive, code, "")
            if isinstance(command, TurnAround):
                play.mission.drive_ended(command.drive, "SUCCEEDED", "")
    assert bool(doubts) == (code == "RECOVERIES_EXHAUSTED")


def test_a_robot_that_was_shut_in_goes_on_when_it_is_let_out_and_blames_no_frontier() -> None:
    play = Play(*[frontier(2.0 + 2 * k, 5.0, 3.0 + k) for k in range(4)], goal=ExploreGoal(return_to_start=False))
    while play.now_ns < 60 * S:
        for command in play.step():
            assert not isinstance(command, Ended)
            if isinstance(command, DriveTo | TurnAround):
                play.mission.drive_ended(command.drive, "NO_VALID_PATH", "")
    assert "shut in" in play.mission.text
    reached = set()
    for _ in range(60):
        for command in play.step():
            if isinstance(command, DriveTo):
                play.pose = command.map_from_goal
                reached.add(command.map_from_goal.x)
                play.surveyor.frontiers = [f for f in play.surveyor.frontiers if f.goal != tuple(play.pose.as_array())]
            if isinstance(command, DriveTo | TurnAround):
                play.mission.drive_ended(command.drive, "SUCCEEDED", "")
    assert reached == {2.0, 4.0, 6.0, 8.0}, "all four, although two were refused before it knew that it was shut in"


def test_lost_ends_at_once() -> None:
    play = Play(frontier(12, 10, 2.0))
    commands = play.end(play.drive(), "LOST", "scan matching failed for 5 s")
    assert isinstance(commands[-1], Ended)
    assert (commands[-1].code, commands[-1].text) == ("LOST", "scan matching failed for 5 s")
    assert play.mission.state is ExploreState.FAILED


def test_without_a_map_it_gives_up_with_a_reason() -> None:
    play = Play(frontier(12, 10, 2.0), start_timeout=5.0)
    assert play.mission.update(None, 4 * S) == []
    (_, ended) = play.mission.update(None, 6 * S)
    assert isinstance(ended, Ended)
    assert ended.code == "STUCK"


def test_home_that_cannot_be_reached_fails_by_name() -> None:
    play = Play()
    play.step()
    ended = play.until_ended("NO_VALID_PATH")
    assert ended.code == "RETURN_FAILED"
    assert not ended.result.is_home


def test_the_place_nearest_to_a_frontier_will_do() -> None:
    play = Play(frontier(12, 10, 2.0))
    drive = play.drive()
    play.pose = SE2(11.8, 10.0)
    play.end(drive, "NEAREST_REACHED", "0.5 m from it")
    assert play.mission.state is ExploreState.LOOKING
    assert play.mission.feedback.goals_reached == 1


@pytest.mark.parametrize(("away", "is_home"), [(0.5, True), (0.7, False)])
def test_right_beside_an_occupied_home_is_home_and_farther_is_not(away: float, is_home: bool) -> None:
    play = Play()
    play.step()
    play.pose = SE2(10.0 + away, 10.0)
    ended = play.until_ended("NEAREST_REACHED")
    assert ended.code == ("SUCCEEDED" if is_home else "RETURN_FAILED")
    assert ended.result.is_home == is_home


def test_the_way_home_is_tried_again_after_a_while_because_people_move_on() -> None:
    play = Play(return_pause=8.0, return_time=100.0)
    play.step()
    drives, turns = [], 0
    for _ in range(240):
        for command in play.step():
            match command:
                case Ended():
                    assert command.code == "RETURN_FAILED"
                    assert play.now_ns / S - drives[0] >= 100.0, "who stands there may leave until then"
                    assert len(drives) >= 5
                    assert turns == len(drives) - 1, "the map renews itself only where scans move"
                    assert np.diff(drives).min() >= 8.0
                    return
                case DriveTo():
                    drives.append(play.now_ns / S)
                    play.mission.drive_ended(command.drive, "NO_VALID_PATH", "somebody stands there")
                case TurnAround():
                    turns += 1
                    play.mission.drive_ended(command.drive, "SUCCEEDED", "")
    raise AssertionError("the mission does not end")


@pytest.mark.parametrize(("is_about", "least", "most"), [(False, 100.0, 140.0), (True, 400.0, 460.0)])
def test_the_way_home_is_tried_for_longer_while_people_are_about(is_about: bool, least: float, most: float) -> None:
    play = Play(return_pause=8.0, return_time=100.0, company_patience=4.0, company_looks=0)
    play.step()
    drives: list[float] = []
    for _ in range(1200):
        play.mission.meet(play.now_ns, is_here=is_about)
        for command in play.step():
            match command:
                case Ended():
                    assert command.code == "RETURN_FAILED"
                    assert least <= play.now_ns / S - drives[0] <= most
                    return
                case DriveTo() if play.mission.state is ExploreState.RETURNING:
                    drives.append(play.now_ns / S)
                    play.mission.drive_ended(command.drive, "NO_VALID_PATH", "somebody stands there")
                case DriveTo() | TurnAround():
                    play.mission.drive_ended(command.drive, "SUCCEEDED", "")
    raise AssertionError("the mission does not end")


def test_the_time_that_looking_past_people_takes_is_none_of_the_way_home() -> None:
    shut = replace(frontier(16, 10, math.inf), goal=None, state=FrontierState.UNREACHABLE, reason="no way")
    play = Play(shut, return_time=100.0, company_looks=1, company_patience=1.0)
    homeward: list[float] = []
    for _ in range(600):
        for command in play.step():
            match command:
                case Ended():
                    assert command.code == "RETURN_FAILED"
                    assert len(homeward) > 2
                    assert play.now_ns / S - homeward[1] >= 100.0
                    return
                case DriveTo() if play.mission.state is ExploreState.RETURNING:
                    homeward.append(play.now_ns / S)
                    play.mission.drive_ended(command.drive, "NO_VALID_PATH", "somebody stands there")
                    if len(homeward) == 1:
                        play.mission.meet(play.now_ns, is_here=True)
                case DriveTo() | TurnAround():
                    if "people are about" in play.mission.text:
                        play.now_ns += 120 * S
                    play.mission.drive_ended(command.drive, "SUCCEEDED", "")
    raise AssertionError("the mission does not end")


@pytest.mark.parametrize("people", [False, True])
def test_what_is_shut_while_people_are_about_is_looked_at_again_and_in_an_empty_place_is_not(*, people: bool) -> None:
    """Somebody stands in a doorway: the way behind him is shut until he leaves."""
    shut = replace(frontier(16, 10, math.inf), goal=None, state=FrontierState.UNREACHABLE, reason="no way")
    play = Play(frontier(12, 10, 2.0), shut)
    play.mission.meet(0, is_here=people)
    drive = play.drive()
    for x in np.arange(10.0, 13.0, 0.5):
        play.pose = SE2(float(x), 10.0)
        play.step(0.1)
    play.pose = SE2(10.0, 10.0)
    play.surveyor.frontiers = [shut]
    looks, turns = [], 0
    play.end(drive)
    for _ in range(300):
        for command in play.step():
            match command:
                case Ended():
                    assert people is False, "it would have left without him"
                    assert (looks, turns) == ([], 0)
                    return
                case DriveTo():
                    if play.mission.state is ExploreState.DRIVING:
                        assert people, "the frontier opened when he had left"
                        assert len(looks) == 1
                        assert math.dist(looks[0], (12.5, 10.0)) < 0.3, (
                            "from the place that the robot knows nearest to it"
                        )
                        return
                    if "shut" in play.mission.text:
                        looks.append((command.map_from_goal.x, command.map_from_goal.y))
                        play.pose = command.map_from_goal
                    play.mission.drive_ended(command.drive, "SUCCEEDED", "")
                case TurnAround():
                    turns += people
                    play.mission.drive_ended(command.drive, "SUCCEEDED", "")
                    if turns == 2:
                        play.surveyor.frontiers = [frontier(16, 10, 4.0)]
    raise AssertionError("the mission does not end")


def test_looking_past_people_has_an_end() -> None:
    shut = replace(frontier(16, 10, math.inf), goal=None, state=FrontierState.UNREACHABLE, reason="no way")
    play = Play(shut, company_looks=4)
    play.mission.meet(0, is_here=True)
    ended = play.until_ended()
    assert ended.code == "SUCCEEDED"
    told = "1 frontiers are left, each with its reason"
    assert ended.text == f"{told}; 1 could not be reached among people, and nobody knows what is behind them"
    alone = Play(shut, company_looks=4).until_ended()
    assert alone.text == told


def test_who_comes_when_the_robot_is_home_again_does_not_send_it_off_once_more() -> None:
    shut = replace(frontier(16, 10, math.inf), goal=None, state=FrontierState.UNREACHABLE, reason="no way")
    play = Play(frontier(12, 10, 2.0))
    play.drive()
    play.surveyor.frontiers = [shut]
    play.step()
    home = play.drive(3.0)
    assert play.mission.state is ExploreState.RETURNING
    play.mission.meet(play.now_ns, is_here=True)
    play.pose = home.map_from_goal
    play.end(home)
    for _ in range(60):
        for command in play.step():
            assert not isinstance(command, DriveTo), "what was shut while nobody was about was not shut by people"
            if isinstance(command, Ended):
                assert command.result.is_home
                return
    raise AssertionError("the mission does not end")


@pytest.mark.parametrize(("news", "looks"), [(0.0, 2), (0.004, 2), (0.006, 4)])
def test_whoever_walks_off_shows_no_more_than_where_he_stood(news: float, looks: int) -> None:
    company = Company(60.0, 2)
    company.meet(0, is_here=True)
    counts = [company.look(0, 500.0, is_shut=True) for _ in range(3)]
    counts += [company.look(0, (1.0 + news) * 500.0, is_shut=True) for _ in range(3)]
    assert sum(counts) == looks


def test_a_robot_whose_way_home_is_shut_goes_to_where_it_is_and_tries_again_from_there() -> None:
    play = Play(frontier(12, 10, 2.0))
    play.drive()
    for x in np.arange(10.0, 16.0, 0.5):
        play.pose = SE2(float(x), 10.0)
        play.step(0.1)
    play.surveyor.frontiers = []
    play.step()
    home = play.drive(3.0)
    assert home.map_from_goal == SE2(10.0, 10.0)
    play.costs[:, SPEC.cell_of(12.0, 10.0)[1]] = COST_LETHAL
    watch = next(c for c in play.end(home, "NO_VALID_PATH") if isinstance(c, DriveTo))
    assert 12.5 < watch.map_from_goal.x < 14.5
    assert "the way home is shut" in play.mission.text
    play.pose = watch.map_from_goal
    play.end(watch)
    play.costs[:] = 0
    again = next(c for _ in range(12) for c in play.step() if isinstance(c, DriveTo))
    assert again.map_from_goal == home.map_from_goal
    play.pose = again.map_from_goal
    play.end(again)
    assert play.until_ended().result.is_home


def test_every_second_time_the_robot_makes_room_for_who_waits_for_it_to_leave() -> None:
    """Nothing shuts the way that it came: somebody stands between it and its home, and pushes."""
    play = Play(frontier(12, 10, 2.0), return_time=100.0)
    play.drive()
    for x in np.arange(16.0, 11.0, -0.5):
        play.pose = SE2(float(x), 10.0)
        play.step(0.1)
    play.surveyor.frontiers = []
    play.step()
    home, answers = play.drive(3.0), []
    for _ in range(4):
        answer = next(c for c in play.end(home, "NO_VALID_PATH") if isinstance(c, DriveTo | TurnAround))
        answers.append(answer)
        play.mission.drive_ended(answer.drive, "SUCCEEDED", "")
        home = next(c for _ in range(30) for c in play.step() if isinstance(c, DriveTo))
        assert home.map_from_goal == SE2(10.0, 10.0)
    assert [isinstance(a, DriveTo) for a in answers] == [False, True, False, True]
    assert 1.5 < answers[1].map_from_goal.distance_to(play.pose) < 2.6


@pytest.mark.parametrize("pause", [4.0, 9.0])
def test_a_robot_that_may_not_move_for_a_moment_goes_on(pause: float) -> None:
    play = Play(frontier(12, 10, 2.0), held_timeout=10.0, progress_timeout=12.0)
    play.drive()
    for _ in range(3):
        play.mission.hold("STALE_POINTS: laser", play.now_ns)
        assert play.step(pause) == []
        play.mission.hold("", play.now_ns)
        assert play.step() == [], "time in which it may not move is no lack of progress"


def test_a_robot_that_may_not_move_any_more_is_stuck_and_says_why() -> None:
    play = Play(frontier(12, 10, 2.0), held_timeout=10.0)
    play.drive()
    for _ in range(10):
        play.mission.hold("STALE_POINTS: laser", play.now_ns)
        assert play.step() == []
    stop, ended = play.step()
    assert isinstance(stop, StopDriving)
    assert isinstance(ended, Ended)
    assert (ended.code, ended.text) == ("STUCK", "not allowed to move for 10 s: STALE_POINTS: laser")


def test_home_is_the_pose_of_the_start() -> None:
    play = Play(frontier(12, 10, 2.0))
    play.drive()
    play.surveyor.frontiers = []
    play.pose = SE2(3.0, 4.0, 1.0)
    play.step()
    drive = play.drive(3.0)
    assert drive.map_from_goal == SE2(10.0, 10.0)
    assert play.mission.state is ExploreState.RETURNING


def test_a_frontier_that_opens_on_the_way_home_is_explored_first() -> None:
    play = Play(frontier(12, 10, 2.0))
    play.drive()
    play.surveyor.frontiers = []
    play.step()
    play.drive(3.0)
    assert play.mission.state is ExploreState.RETURNING
    play.surveyor.frontiers = [frontier(5, 5, 3.0)]
    assert play.drive().map_from_goal.x == 5.0
    play.surveyor.frontiers = []
    assert play.until_ended().result.is_home


def bring_to(state: ExploreState) -> Play:
    play = Play(frontier(12, 10, 2.0))
    if state is ExploreState.STARTING:
        return play
    drive = play.drive()
    if state is ExploreState.LOOKING:
        play.end(drive)
    if state is ExploreState.RETURNING:
        play.surveyor.frontiers = []
        play.step()
        play.drive(3.0)
    return play


@pytest.mark.parametrize(
    "state", [ExploreState.STARTING, ExploreState.DRIVING, ExploreState.LOOKING, ExploreState.RETURNING]
)
def test_it_can_be_cancelled_in_every_state_and_begun_again(state: ExploreState) -> None:
    play = bring_to(state)
    assert play.mission.state is state
    commands = play.mission.cancel()
    assert isinstance(commands[0], StopDriving)
    assert isinstance(commands[1], Ended)
    assert commands[1].code == "CANCELLED"
    assert play.mission.state is ExploreState.CANCELLED
    assert play.step() == []
    assert play.mission.cancel() == []
    play.mission.begin(ExploreGoal(), play.now_ns)
    play.surveyor.frontiers = [frontier(12, 10, 2.0)]
    assert play.drive().map_from_goal.x == 12.0


def test_time_in_which_a_person_drives_is_no_lack_of_progress() -> None:
    play = Play(frontier(12, 10, 2.0), progress_timeout=10.0)
    play.drive()
    play.now_ns += 60 * S
    play.mission.resume(play.now_ns)
    assert play.step() == []
    assert play.mission.state is ExploreState.DRIVING


@pytest.mark.parametrize(("area", "code"), [(0.3, "STUCK"), (3.0, "SUCCEEDED")])
def test_a_robot_that_can_reach_next_to_nothing_has_not_explored_but_is_boxed_in(area: float, code: str) -> None:
    """No frontier is open, but only because it stands between obstacles: that is no proof."""
    play = Play(goal=ExploreGoal(return_to_start=False))
    play.surveyor.reachable_area = area
    ended = play.until_ended()
    assert ended.code == code
    assert ("boxed in" in ended.text) == (code == "STUCK")


def along(play: Play, x_from: float, x_to: float) -> None:
    """Drive along y = 10 m in small steps."""
    for x in np.linspace(x_from, x_to, 1 + round(abs(x_to - x_from) / 0.25)):
        play.pose = SE2(float(x), 10.0)
        play.step(0.3)


def test_a_robot_that_lost_its_map_goes_back_along_its_way_and_leaves_what_led_there() -> None:
    play = Play(frontier(19, 10, 9.0), frontier(5, 5, 30.0), doubt_way=4.0)
    play.drive()
    along(play, 10.0, 17.0)
    play.mission.doubt("3 returns, too few", play.now_ns)
    stop, back = play.step()
    assert isinstance(stop, StopDriving)
    assert isinstance(back, DriveTo)
    assert (back.map_from_goal.x, back.map_from_goal.y) == pytest.approx((13.0, 10.0), abs=0.3)
    assert play.mission.state is ExploreState.DOUBTING
    assert "3 returns" in play.mission.text
    along(play, 17.0, 14.0)
    assert play.mission.state is ExploreState.DOUBTING, "nothing is decided on a map that is in doubt"
    play.mission.doubt("", play.now_ns)
    assert StopDriving() in play.step()
    assert play.drive(2.0).map_from_goal.x == 5.0
    assert "lost its map on the way there" in play.mission.frontiers()[0].reason


def test_it_goes_back_farther_when_that_did_not_help_and_ends_lost_when_nothing_does() -> None:
    play = Play(frontier(19, 10, 9.0), doubt_way=4.0, doubt_time=60.0)
    play.drive()
    along(play, 10.0, 17.0)
    play.mission.doubt("all returns lie where the map is free", play.now_ns)
    first = next(c for c in play.step() if isinstance(c, DriveTo))
    farther = next(c for c in play.end(first) if isinstance(c, DriveTo))
    assert farther.map_from_goal.x == pytest.approx(10.0, abs=0.3)
    ended = play.until_ended("NO_VALID_PATH")
    assert ended.code == "LOST"
    assert "all returns lie" in ended.text


def test_in_doubt_from_the_first_moment_there_is_no_way_back() -> None:
    play = Play(frontier(12, 10, 2.0), doubt_time=5.0)
    play.mission.doubt("0 returns", 0)
    assert play.step() == [StopDriving()]
    assert play.until_ended().code == "LOST"


def test_in_a_wide_place_frontiers_are_searched_less_often_while_driving_and_at_once_when_a_drive_ends() -> None:
    play = Play(frontier(12, 10, 9.0), wide_cells=SPEC.width * SPEC.height // 4)
    looks = 0
    search = play.surveyor.update

    def counted(*args: object) -> Survey:
        nonlocal looks
        looks += 1
        return search(*args)  # type: ignore[arg-type]

    play.surveyor.update = counted  # type: ignore[method-assign, assignment]
    drive = play.drive()
    looks = 0
    for _ in range(12):
        assert play.step() == []
    assert looks == 3
    play.step()
    before = looks
    play.end(drive)
    assert looks > before
    assert play.mission.state is ExploreState.LOOKING


def test_in_an_office_frontiers_are_searched_at_every_update() -> None:
    play = Play(frontier(12, 10, 9.0))
    play.drive()
    play.surveyor.frontiers = [frontier(5, 5, 2.0)]
    assert play.drive().map_from_goal.x == 5.0


def test_what_a_speck_shuts_is_looked_at_before_going_home_and_explored_when_it_opens() -> None:
    play = Play()
    play.mission._has_turned = True
    play.surveyor.looks = [SE2(5.0, 5.0, 1.0), SE2(6.0, 6.0, 2.0)]
    play.step()  # the sweep
    look = play.drive(5.0)
    assert look.map_from_goal == SE2(5.0, 5.0, 1.0)
    (turn,) = play.end(look)
    assert isinstance(turn, TurnAround)
    assert turn.drive > look.drive
    assert turn.angle == pytest.approx(2 * math.pi)
    play.surveyor.frontiers = [frontier(12, 10, 2.0)]  # the turn opened it
    play.end(turn)
    drive = play.drive(10.0)
    assert drive.map_from_goal.x == 12.0
    play.surveyor.frontiers = []
    play.end(drive)
    play.step(5.0)  # another sweep
    look = play.drive(5.0)
    assert look.map_from_goal == SE2(6.0, 6.0, 2.0)
    (turn,) = play.end(look, "FAILED_TO_MAKE_PROGRESS")  # turned where the drive ended
    assert isinstance(turn, TurnAround)
    play.end(turn)
    ended = play.until_ended()
    assert ended.code == "SUCCEEDED"
    assert ended.result.is_home


def test_a_look_at_a_speck_that_takes_too_long_ends_with_the_way_home() -> None:
    play = Play(lookout_time=20.0)
    play.mission._has_turned = True
    play.surveyor.looks = [SE2(5.0, 5.0, 1.0)]
    play.step()
    look = play.drive(5.0)
    home = play.drive(25.0)
    assert home.drive > look.drive
    assert play.mission.state is ExploreState.RETURNING
    assert not play.mission.drive_ended(look.drive, "SUCCEEDED", "")  # late: the robot is on its way home
