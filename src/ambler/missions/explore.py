"""The exploration mission: a state machine that drives to frontiers until it can prove that none is left, then goes home.

It knows neither bus nor clock. `begin`, `update` (about once a second), `drive_ended` and `cancel` return commands for
the caller to carry out. The proof is a last survey in which no frontier is open, made after a final sweep: costs cleared,
the whole map searched afresh, and, once, every refused frontier given one more attempt.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ambler.core.messages import Frontier, FrontierState
from ambler.core.se2 import SE2
from ambler.exploration.choice import ChoiceConfig, choose, find_again
from ambler.exploration.strategies import Strategy
from ambler.exploration.survey import FrontierSurvey, Survey
from ambler.missions.company import Company
from ambler.missions.drive_to import DriveTo
from ambler.missions.explore_commands import (
    ChangeLevel,
    ClearCosts,
    Command,
    DoubtTerrain,
    Ended,
    ExploreConfig,
    ExploreState,
    ExploreView,
    HoldStation,
    StopDriving,
    TurnAround,
)
from ambler.missions.left_levels import LeftLevels, nearest_level
from ambler.missions.progress import FailedDrives, Progress
from ambler.missions.stations import Stations
from ambler.missions.trail import Trail
from ambler.runtime.node import PREEMPTED
from ambler.runtime.tasks import NEAREST_REACHED, ExploreFeedback, ExploreGoal, ExploreResult

_ON_THE_WAY = (ExploreState.DRIVING, ExploreState.RETURNING, ExploreState.CHANGING_LEVEL)
_OVER = (ExploreState.IDLE, ExploreState.FINISHED, ExploreState.FAILED, ExploreState.CANCELLED)


class ExploreMission:
    """One exploration at a time. `state`, `text`, `survey` and `target` may be read by anyone."""

    def __init__(self, config: ExploreConfig, survey: FrontierSurvey, strategy: Strategy) -> None:
        self.config = config
        self.state = ExploreState.IDLE
        self.text = ""
        self.survey: Survey | None = None
        self.target: int | None = None
        self._surveyor = survey
        self._strategy = strategy
        self._stations = Stations(config.stations)
        self._drive = 0
        self._held = ""
        self._held_ns = 0
        self._is_paused = self._is_taken = False
        self._doubt = ""
        self._doubt_ns = 0
        self._company = Company(config.company_time, config.company_looks)

    def begin(self, goal: ExploreGoal, now_ns: int) -> None:
        """Start a new exploration; the pose at the first update is home."""
        self._surveyor.reset()
        self._surveyors = {0: self._surveyor}
        self._level = self._home_level = 0
        self._left = LeftLevels(self.config.level_tries, self.config.near)
        self.survey = None
        self.target = None
        self._stations.begin()
        self._before = (ExploreState.STARTING, "")  # what a station interrupted
        self._way: DriveTo | None = None
        self._goal = goal
        self._home: SE2 | None = None
        self._trail = Trail()
        self._back = 0.0
        self._was_driving = False
        self._looked_ns = now_ns
        self._is_fresh = True
        self._is_home = False
        self._goals_reached = 0
        self._begun_ns = self._held_ns = now_ns
        self._is_taken = False
        self._look_until_ns = 0
        self._has_turned = False
        self._turns_there = False
        self._has_swept = False
        self._has_pardoned = False
        self._returns = 0
        self._company.forget()
        self._shut_ns: int | None = None
        self._pause_until_ns = 0
        self._resumes = 0
        self._failed = FailedDrives(self.config.near, self.config.stuck_distance)
        self._progress = Progress(self.config.progress_distance, now_ns)
        self._switches = 0
        self._arrived = False
        self._drive_code: str | None = None
        self._drive_text = ""
        self._enter(ExploreState.STARTING, "waiting for a map, a costmap and a pose")

    @property
    def is_active(self) -> bool:
        return self.state not in _OVER

    @property
    def feedback(self) -> ExploreFeedback:
        """How far the exploration is."""
        survey = self.survey
        return ExploreFeedback(
            self.state.name,
            0 if survey is None else len(survey.open),
            self._goals_reached,
            0.0 if survey is None else survey.known_area,
            self._stations.count,
        )

    def frontiers(self) -> tuple[Frontier, ...]:
        """Return the frontiers of the last survey with the target marked."""
        if self.survey is None:
            return ()
        marked = list(self.survey.frontiers)
        if self.target is not None:
            marked[self.target] = replace(marked[self.target], state=FrontierState.TARGET)
        return tuple(marked)

    def cancel(self) -> list[Command]:
        """End the exploration on request."""
        if not self.is_active:
            return []
        return self._end(ExploreState.CANCELLED, "CANCELLED", "cancelled on request")

    def resume(self, now_ns: int) -> None:
        """Go on after somebody else drove the robot: progress counts from now."""
        if self.is_active:
            self._progress.resume(now_ns)

    def hold(self, reason: str, now_ns: int) -> None:
        """Take why the robot may not move at all, empty when it may. What lasts ends the exploration with that reason."""
        if reason and not self._held:
            self._held_ns = now_ns
        if self._held and not reason:
            self.resume(now_ns)
        self._held = reason

    def pause(self, now_ns: int, *, is_paused: bool) -> None:
        """Take whether a person lets the robot wait: nothing is decided meanwhile, and nobody asks for progress."""
        if self._is_paused and not is_paused:
            self.resume(now_ns)
        self._is_paused = is_paused

    def take_over(self) -> None:
        """Take that another program drives the robot now: the exploration ends with the next update, and takes it away from nobody."""
        self._is_taken = True

    def doubt(self, reason: str, now_ns: int) -> None:
        """Take why the robot's place in its map is in doubt, empty when it is not any more."""
        if reason and not self._doubt:
            self._doubt_ns = now_ns
        self._doubt = reason

    def meet(self, now_ns: int, *, is_here: bool) -> None:
        """Take whether anybody who moves is near the robot."""
        self._company.meet(now_ns, is_here=is_here)

    def drive_ended(self, drive: int, code: str, text: str) -> bool:
        """Take the end of a drive; returns whether it is news, so that an update should follow. Earlier drives are not."""
        is_news = drive == self._drive and self.is_active
        if is_news:
            self._drive_code, self._drive_text = code, text
        return is_news

    def update(self, view: ExploreView | None, now_ns: int) -> list[Command]:
        """Look at the map and decide; `view` is None while map, costmap or pose are missing."""
        if not self.is_active:
            return []
        if self._drive_code == "LOST" and self.state is not ExploreState.SCANNING:
            return self._end(ExploreState.FAILED, "LOST", self._drive_text)
        if self._is_taken:
            return self._end(ExploreState.FAILED, PREEMPTED, "another program drives the robot")
        if self._held and now_ns - self._held_ns > self.config.held_timeout * 1e9:
            text = f"not allowed to move for {self.config.held_timeout:.0f} s: {self._held}"
            return self._end(ExploreState.FAILED, "STUCK", text)
        if view is None:
            if self.state is ExploreState.STARTING and now_ns - self._begun_ns > self.config.start_timeout * 1e9:
                missing = f"no map, costmap or pose within {self.config.start_timeout:.0f} s"
                return self._end(ExploreState.FAILED, "STUCK", missing)
            return []
        if self._is_paused:
            return []
        if self._home is None:
            self._home, self._home_level = view.map_from_base, view.level
        if view.level != self._level:
            return self._come_to_level(view)
        if self._doubt or self.state is ExploreState.DOUBTING:
            return self._doubting(view)
        if self.state is ExploreState.SCANNING:
            return self._scanning(view)
        self._trail.add(view.map_from_base)
        if self._is_station_due(view):
            return self._hold_station(view)
        self._look(view, must=self._drive_code is not None or self.state is not ExploreState.DRIVING)
        steps = {
            ExploreState.STARTING: self._starting,
            ExploreState.CHOOSING: self._choosing,
            ExploreState.DRIVING: self._driving,
            ExploreState.LOOKING: self._looking,
            ExploreState.RETURNING: self._returning,
            ExploreState.CHANGING_LEVEL: self._changing_level,
        }
        return steps[self.state](view)

    # One method per state; each returns the commands of this update.

    def _starting(self, view: ExploreView) -> list[Command]:
        """Turn once when nothing is open: the scanner may have blind sectors."""
        if self._now.open or self._has_turned:
            return self._choosing(view)
        self._has_turned = True
        self._next_drive()
        self._enter(ExploreState.LOOKING, "nothing open at the start: turning once")
        self._look_until_ns = view.now_ns + int(30e9)
        return [TurnAround(self._drive, 2.0 * math.pi)]

    def _choosing(self, view: ExploreView) -> list[Command]:
        self._switches = 0
        best = choose(self._now, self._strategy, view.map_from_base, None, self.config.choice)
        if best is None and not self._surveyor.is_strict:
            self._surveyor.is_strict = True
            self._look(view)
            best = choose(self._now, self._strategy, view.map_from_base, None, self.config.choice)
        if best is not None:
            self._has_swept = False
            return self._drive_to_frontier(view, best)
        unfinished = nearest_level(view.level, view.passages, self._left.unfinished())
        if unfinished is not None:
            return self._change_level(view, *unfinished)
        if not self._has_swept:
            return self._sweep(view)
        shut = [self._now.frontiers[k] for k in self._now.shut]
        if not self._is_home and self._company.look(view.now_ns, self._now.known_area, is_shut=bool(shut)):
            return self._look_past_people(view, shut)
        if not self._is_home and (place := self._surveyor.look_at_speck(self._now, view.map_from_base)) is not None:
            return self._look_at_speck(view, place)
        if self._goal.return_to_start and not self._is_home:
            return self._go_home(view)
        self.survey = self._surveyor.explained(self._now, view.map, view.map_from_base)
        if self._now.reachable_area < self.config.min_reachable_area:
            text = f"boxed in: only {self._now.reachable_area:.2f} m² can be reached"
            return self._end(ExploreState.FAILED, "STUCK", text)
        return self._end(ExploreState.FINISHED, "SUCCEEDED", self._proof())

    def _change_level(self, view: ExploreView, level: int, following: int) -> list[Command]:
        """Drive to where the present level meets the next one on the way to another."""
        self._left.set_out(level, self._now.frontiers)
        is_way = (view.passages[:, 0] == view.level) & (view.passages[:, 1] == following)
        places = [SE2(*row) for row in view.passages[is_way, 2:].tolist()]
        place = min(places, key=view.map_from_base.distance_to)
        self._next_drive()
        self.target, self._is_home = None, False
        self._enter(ExploreState.CHANGING_LEVEL, f"from level {view.level} to level {following}")
        drive = self._send(DriveTo(self._drive, place, self.config.xy_tolerance, math.pi))
        return [ChangeLevel(following), drive]

    def _changing_level(self, view: ExploreView) -> list[Command]:
        """A drive between levels that ended without one: look around, and try again."""
        code, self._drive_code = self._drive_code, None
        if code is None:
            return []
        return [ClearCosts(), *self._turn_and_wait(view, f"between two levels ({code})")]

    def _come_to_level(self, view: ExploreView) -> list[Command]:
        """Another level: what was chosen on the last one is not on it."""
        if self.survey is not None:
            self._left.leave(self._level, self.survey.frontiers)
        self._level = view.level
        self._left.come_to(view.level)
        if view.level not in self._surveyors:
            self._surveyors[view.level] = self._surveyors[0].another()
        self._surveyor = self._surveyors[view.level]
        self._surveyor.forget_map()
        self.survey, self.target, self._trail = None, None, Trail()
        self._arrived, self._has_swept, self._drive_code = False, False, None
        self._failed.forget()
        self._next_drive()
        self._look(view)
        return [StopDriving(), *self._wait(view, self.config.look_time, f"on level {view.level}")]

    def _driving(self, view: ExploreView) -> list[Command]:
        code, self._drive_code = self._drive_code, None
        again = find_again(self._target_frontier, self._now, self.config.choice)
        if code in (
            "SUCCEEDED",
            NEAREST_REACHED,
        ):  # as near as possible will do: how much was seen from there is judged anyway
            self._goals_reached += 1
            self._failed.forget()
            self._arrived = True
            return self._wait(view, self.config.look_time, "arrived, waiting for the map")
        if again is None and self._surveyor.hides(self._target_frontier, view.map):
            return self._drive_on(view, code)
        if again is None:
            if find_again(self._target_frontier, self._now, self.config.choice, is_open=False) is None:
                self._goals_reached += 1
                self._failed.forget()
                self._remember(view, self._target_frontier, "it closes and opens again", has_looked=True)
            elif _nearest(self._target_frontier, view.map_from_base) <= self.config.visit_range:
                self._surveyor.memory.visit(self._target_frontier, view.map)
            return self._choosing_or_stop(view)
        self._track(again, view)
        if (given_up := self._given_up(view, code, self._progress.since_ns)) is not None:
            return given_up
        if not self._is_fresh:
            return []
        best = choose(self._now, self._strategy, view.map_from_base, again, self._choice_while_driving())
        goal = self._target_frontier.goal
        assert best is not None
        assert goal is not None
        has_moved = math.hypot(goal[0] - self._sent.x, goal[1] - self._sent.y) > self.config.goal_shift
        self._switches += best != again
        if best != again or has_moved:
            return self._drive_to_frontier(view, best)
        return []

    def _drive_on(self, view: ExploreView, code: str | None) -> list[Command]:
        """The target closed because the ground around the robot is assumed: only where the robot was sent to does it see what is there."""
        self._progress.note_motion(view.map_from_base, view.now_ns)
        return self._given_up(view, code, self._progress.moved_ns) or []

    def _given_up(self, view: ExploreView, code: str | None, progress_ns: int) -> list[Command] | None:
        """Give up a drive that ended with a code, or made no progress for long; None while it is neither."""
        if code is not None:
            return self._give_up(view, f"{code}: {self._drive_text}" if self._drive_text else code)
        if view.now_ns - progress_ns <= self.config.progress_timeout * 1e9:
            return None
        return [StopDriving(), *self._give_up(view, f"no progress for {self.config.progress_timeout:.0f} s")]

    def _choice_while_driving(self) -> ChoiceConfig:
        """Ask for twice the saving after each change of mind, so that a robot between two targets decides for one."""
        choice, factor = self.config.choice, 2.0**self._switches
        return replace(choice, hysteresis=choice.hysteresis * factor, min_saving=choice.min_saving * factor)

    def _looking(self, view: ExploreView) -> list[Command]:
        if self._drive_code is not None and not self._arrived:
            self._drive_code = None
            if self._turns_there:
                self._next_drive()
                return self._turn_and_wait(view, self.text)
            soon = max(self._pause_until_ns, view.now_ns + int(self.config.look_time * 1e9))
            self._look_until_ns = min(self._look_until_ns, soon)
        if view.now_ns < self._look_until_ns:
            return []
        if self._arrived:
            self._arrived = False
            again = find_again(self._target_frontier, self._now, self.config.choice)
            if again is not None:
                self._judge_look(view, self._now.frontiers[again])
            elif self._surveyor.hides(self._target_frontier, view.map):
                self._remember(view, self._target_frontier, "its ground is only assumed", has_looked=True)
        self.target = None
        return self._choosing(view)

    def _returning(self, view: ExploreView) -> list[Command]:
        code, self._drive_code = self._drive_code, None
        if self._now.open and self._resumes < self.config.max_resumes:
            self._resumes += 1
            self._shut_ns = None
            return self._choosing(view)
        if code == "SUCCEEDED" or (code == NEAREST_REACHED and self._is_near_home(view)):
            self._is_home = True
            return self._wait(view, self.config.look_time, "home, looking once more")
        if code is None:
            return []
        if self._shut_ns is None:
            self._shut_ns = view.now_ns
        if view.now_ns - self._shut_ns < self._patience_ns(view, self.config.return_time):
            doubts = [DoubtTerrain(self.config.doubted)] if code == "RECOVERIES_EXHAUSTED" else []
            return [ClearCosts(), *doubts, *self._watch_the_way(view, code)]
        return self._end(ExploreState.FAILED, "RETURN_FAILED", f"{code}: {self._drive_text}")

    def _doubting(self, view: ExploreView) -> list[Command]:
        """Go back along the way until the map is believed again, then leave alone what led here; the map does not change meanwhile."""
        if not self._doubt:
            if self.survey is not None and self._was_driving:
                self._remember(view, self._target_frontier, "the robot lost its map on the way there", has_looked=False)
            return [StopDriving(), *self._wait(view, self.config.look_time, "the map is believed again")]
        if view.now_ns - self._doubt_ns > self.config.doubt_time * 1e9:
            return self._end(ExploreState.FAILED, "LOST", f"for {self.config.doubt_time:.0f} s: {self._doubt}")
        code = self._drive_code
        is_new = self.state is not ExploreState.DOUBTING
        if not is_new and code is None:
            return []
        if is_new:
            self._was_driving = self.state is ExploreState.DRIVING
            self._back = 0.0
        self._back += self.config.doubt_way
        self._enter(ExploreState.DOUBTING, f"going back along the way: {self._doubt}")
        self._next_drive()
        place = self._trail.back(self._back)
        if place is None:  # in doubt from the first moment on: there is no way to go back
            return [StopDriving()]
        return [StopDriving(), DriveTo(self._drive, place, self.config.xy_tolerance, math.pi)]

    def _is_station_due(self, view: ExploreView) -> bool:
        """Only on a way, or where the robot stands and waits for the map anyway; how a drive ended is judged first."""
        stands = self.state is ExploreState.LOOKING and self._arrived
        can = (stands or self.state in _ON_THE_WAY) and self._drive_code is None and not self._held
        return can and self._stations.is_due(view.level, view.map_from_base, view.tilt, view.passages)

    def _hold_station(self, view: ExploreView) -> list[Command]:
        self._before = (self.state, self.text)
        number = self._stations.start(view.level, view.map_from_base)
        self._next_drive()
        self._enter(ExploreState.SCANNING, f"scanning station {number}")
        return [StopDriving(), HoldStation(self._drive, self.config.stations.hold, view.level)]

    def _scanning(self, view: ExploreView) -> list[Command]:
        """When the station is over, go on with what it interrupted, as if it had not been."""
        code = self._drive_code
        if code is None:
            return []
        self._stations.end(is_held=code == "SUCCEEDED")
        self._drive_code = None
        self._enter(*self._before)
        self.resume(view.now_ns)
        if self.state not in _ON_THE_WAY or self._way is None:
            return []
        self._next_drive()
        return [self._send(replace(self._way, drive=self._drive))]

    def _watch_the_way(self, view: ExploreView, code: str) -> list[Command]:
        """Go to where the way that the robot came is shut, and look; there, turn, because a map renews itself only where scans move, or make room: who
        stands there may wait for the robot to leave."""
        self._next_drive()
        text = f"the way home is shut ({code})"
        if (place := self._trail.lookout(view.costs, view.map_from_base)) is not None:
            return self._go_and_wait(view, place, f"{text}, going to where it is")
        if self._returns % 2 == 0 and (place := self._room(view, self._returns // 2)) is not None:
            return self._go_and_wait(view, place, f"{text}, making room")
        return self._turn_and_wait(view, f"{text}, waiting")

    def _is_near_home(self, view: ExploreView) -> bool:
        """Somebody stands where the robot started: right beside is home as well."""
        return self._home is not None and self._home.distance_to(view.map_from_base) <= self.config.home_near

    # Steps that several states share.

    @property
    def _now(self) -> Survey:
        assert self.survey is not None
        return self.survey

    def _look(self, view: ExploreView, *, must: bool = True) -> None:
        """Look at the map; in wide places not at every update, because a look takes time with the map's size."""
        wide = view.map.data.size / self.config.wide_cells
        if not must and self.survey is not None and view.now_ns - self._looked_ns < (wide - 0.5) * 1e9:
            self.target, self._is_fresh = None, False
            return
        self._is_fresh = True
        self._looked_ns = view.now_ns
        self.survey = self._surveyor.update(view.map, view.costs, view.map_from_base, self._goal.boundary)
        self.target = None

    def _enter(self, state: ExploreState, text: str) -> None:
        self.state, self.text = state, text

    def _send(self, way: DriveTo) -> DriveTo:
        """Remember a drive, to go on with it after a station."""
        self._way = way
        return way

    def _next_drive(self) -> None:
        self._drive += 1
        self._drive_code = None
        self._turns_there = False

    def _wait(self, view: ExploreView, seconds: float, text: str) -> list[Command]:
        self._look_until_ns = view.now_ns + int(seconds * 1e9)
        self._enter(ExploreState.LOOKING, text)
        return []

    def _track(self, index: int, view: ExploreView) -> None:
        """Take frontier `index` as the present shape of the target, and note progress: towards it, and of the robot at all, because
        a change of the target begins the former anew."""
        self._progress.note_motion(view.map_from_base, view.now_ns)
        self.target = index
        self._target_frontier = self._now.frontiers[index]
        self._progress.note_distance(self._target_frontier.path_distance, view.now_ns)

    def _drive_to_frontier(self, view: ExploreView, index: int) -> list[Command]:
        frontier = self._now.frontiers[index]
        assert frontier.goal is not None
        if self.target != index:
            self._progress.aim(view.now_ns)
        self._track(index, view)
        self._sent = SE2(*frontier.goal)
        self._is_home = False
        self._next_drive()
        if self.state is not ExploreState.DRIVING:
            self._progress.set_out(view.map_from_base, view.now_ns)
        self._enter(ExploreState.DRIVING, f"to a frontier {frontier.path_distance:.1f} m away")
        return [self._send(DriveTo(self._drive, self._sent, self.config.xy_tolerance, self.config.yaw_tolerance))]

    def _choosing_or_stop(self, view: ExploreView) -> list[Command]:
        """Choose anew because the target is gone; a running drive is replaced, or stopped when nothing replaces it."""
        commands = self._choosing(view)
        is_replaced = any(isinstance(c, DriveTo | StopDriving) for c in commands)
        return commands if is_replaced else [StopDriving(), *commands]

    def _give_up(self, view: ExploreView, reason: str) -> list[Command]:
        """Remember a drive that failed. Where drives to several places fail, it is where they begin and not where they lead: the robot
        waits, turns, makes room for people who may wait for it, and tries again; one that fails for long without moving is stuck."""
        c = self.config
        self._failed.add(self._sent, view.map_from_base, view.now_ns)
        stood_ns = view.now_ns - self._failed.since_ns
        if self._failed.count >= c.stuck_failures and stood_ns >= self._patience_ns(view, c.stuck_time):
            text = f"{self._failed.count} drives failed at one place, the last one: {reason}"
            return self._end(ExploreState.FAILED, "STUCK", text)
        if self._failed.goals < c.shut_failures:
            self._remember(view, self._target_frontier, reason, has_looked=False)
            return self._wait(view, c.look_time, f"gave up a frontier ({reason})")
        self._next_drive()
        attempt = (self._failed.count - c.shut_failures) // 2 + 1
        is_turn = self._failed.count % 2 == 0 and self._company.is_about(view.now_ns)
        if is_turn and (place := self._room(view, attempt)) is not None:
            return [ClearCosts(), *self._go_and_wait(view, place, f"shut in, making room ({reason})")]
        doubts = (ClearCosts(), DoubtTerrain(c.doubted))
        return [*doubts, *self._turn_and_wait(view, f"shut in, waiting ({reason})")]

    def _room(self, view: ExploreView, attempt: int) -> SE2 | None:
        """Return a place to make room at: farther away with each attempt, as far as the robot came from; None if it came from nowhere."""
        c = self.config
        distances = (min(k * c.give_way, c.give_way_most) for k in range(attempt, 0, -1))
        places = (self._trail.away(view.map_from_base, distance) for distance in distances)
        return next((place for place in places if place is not None), None)

    def _patience_ns(self, view: ExploreView, seconds: float) -> float:
        """How long to try what fails: longer while people are about, who may stand in the way and leave."""
        return seconds * 1e9 * (self.config.company_patience if self._company.is_about(view.now_ns) else 1.0)

    def _turn_and_wait(self, view: ExploreView, text: str) -> list[Command]:
        """Turn once, because a map renews itself only where scans move, and wait for who stands in the way."""
        self._pause_until_ns = view.now_ns + int(self.config.return_pause * 1e9)
        self._wait(view, 3.0 * self.config.return_pause, text)
        return [TurnAround(self._drive, 2.0 * math.pi)]

    def _go_and_wait(self, view: ExploreView, place: SE2, text: str) -> list[Command]:
        """Drive to a place, as long as that takes, and wait there."""
        self._pause_until_ns = view.now_ns + int(self.config.return_pause * 1e9)
        self._wait(view, self.config.lookout_time, text)
        return [DriveTo(self._drive, place, self.config.xy_tolerance, self.config.yaw_tolerance)]

    def _judge_look(self, view: ExploreView, frontier: Frontier) -> None:
        """The robot arrived and the frontier is still there: count it as looked at, or as a goal that was not reached."""
        away, planned = (_nearest(frontier, place) for place in (view.map_from_base, self._sent))
        has_looked = away <= max(planned + self.config.near, self._surveyor.config.goal_reach)
        reason = "nothing changed" if has_looked else f"the drive ended {away:.1f} m away"
        place = (view.map_from_base.x, view.map_from_base.y) if has_looked else None
        self._remember(view, frontier, reason, has_looked=has_looked, place=place)

    def _remember(
        self,
        view: ExploreView,
        frontier: Frontier,
        reason: str,
        *,
        has_looked: bool,
        place: tuple[float, float] | None = None,
    ) -> None:
        self._surveyor.memory.refuse(frontier, reason, view.map, has_looked=has_looked, place=place)
        self._look(view)

    def _sweep(self, view: ExploreView) -> list[Command]:
        """Doubt the end: clear costs, search the whole map afresh, and, once, give refused frontiers one more attempt."""
        self._has_swept = True
        self._surveyor.forget_map()
        if not self._has_pardoned:
            self._has_pardoned = True
            self._surveyor.memory.pardon()
        self._wait(view, self.config.sweep_time, "final sweep")
        return [ClearCosts()]

    def _look_past_people(self, view: ExploreView, shut: list[Frontier]) -> list[Command]:
        """Go to where the robot was nearest to what is shut, one after the other; there, or where nothing is, turn and wait."""
        self._surveyor.memory.pardon()
        self._next_drive()
        self._is_home, self._shut_ns = False, None  # what it takes is no time in which the way home was shut
        cells = shut[self._company.looks // 2 % len(shut)].cells if shut else np.empty((0, 2))
        place = self._trail.nearest(cells)
        if place is None or place.distance_to(view.map_from_base) <= self.config.near:
            return [StopDriving(), ClearCosts(), *self._turn_and_wait(view, "people are about: looking once more")]
        return [ClearCosts(), *self._go_and_wait(view, place, "people are about: looking at what is shut")]

    def _look_at_speck(self, view: ExploreView, place: SE2) -> list[Command]:
        """Go to where a small thing is seen well that alone shuts a way, and turn there: a map renews itself only where scans move."""
        self._next_drive()
        self._turns_there = True
        self._pause_until_ns = view.now_ns
        self._wait(view, self.config.lookout_time, "looking at a small thing that shuts a way")
        return [DriveTo(self._drive, place, self.config.xy_tolerance, self.config.yaw_tolerance)]

    def _go_home(self, view: ExploreView) -> list[Command]:
        assert self._home is not None
        if view.level != self._home_level:
            way = nearest_level(view.level, view.passages, {self._home_level})
            if way is None or self._left.is_hopeless(self._home_level, times=3):
                text = f"no way from level {view.level} to level {self._home_level}"
                return self._end(ExploreState.FAILED, "RETURN_FAILED", text)
            return self._change_level(view, *way)
        self._returns += 1
        self._next_drive()
        self._enter(ExploreState.RETURNING, f"to the start, attempt {self._returns}")
        c = self.config
        return [self._send(DriveTo(self._drive, self._home, c.home_xy_tolerance, c.home_yaw_tolerance))]

    def _proof(self) -> str:
        remaining = len(self._now.frontiers) + len(self._left.frontiers)
        left_out = self._now.left_out
        text = "no frontier is left" if remaining == 0 else f"{remaining} frontiers are left, each with its reason"
        if self._company.looks and self._now.shut:
            text += f"; {len(self._now.shut)} could not be reached among people, and nobody knows what is behind them"
        return f"{text}; {left_out:.1f} m of frontier were left out on purpose" if left_out else text

    def _end(self, state: ExploreState, code: str, text: str) -> list[Command]:
        self._enter(state, text)
        self.target = None
        seen = () if self.survey is None else self.survey.frontiers
        remaining = seen + self._left.frontiers
        result = ExploreResult(remaining, self._goals_reached, self._is_home)
        return [StopDriving(), Ended(code, text, result)]


def _nearest(frontier: Frontier, place: SE2) -> float:
    """Return how far a place is from the nearest cell of a frontier, in metres."""
    return float(((frontier.cells - (place.x, place.y)) ** 2).sum(axis=1).min() ** 0.5)
