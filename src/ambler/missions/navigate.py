"""Driving to one goal: plan, follow, replan, recover, and end with a named state. It knows no bus.

PLANNING -> FOLLOWING -> SUCCEEDED, or NEAREST_REACHED when the goal itself cannot be reached; a failed plan or drive leads to RECOVERING and back to PLANNING, or, where somebody is in the way,
to GIVING_WAY: the robot stands aside until he is past. WAITING bridges moments without a pose or fresh input. A goal on another level of a map of ground is driven to in legs: to a passage, until the robot is on the next level, and on from there. Everything that takes time is asked of a `Driver` and answered by a callback; an answer that
comes after the state has moved on is ignored.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ParamSpec, Protocol

import numpy as np

from ambler.core.errors import AmblerError, StaleInputError, TransformError
from ambler.core.grid import COST_INSCRIBED, COST_UNKNOWN
from ambler.core.messages import CostGrid, GroundLevels, Path
from ambler.core.se2 import SE2, wrap_angle
from ambler.missions.blocked_ways import BlockedWaysConfig
from ambler.missions.giving_way import GivingWayConfig
from ambler.missions.level_route import Hop, LevelRoute
from ambler.missions.recovery import DEFAULT_SEQUENCE, RecoveryAction, RecoverySequence, RecoveryStep
from ambler.runtime.tasks import LEVEL_NOT_REACHED, NEAREST_REACHED, NO_SUCH_LEVEL, NavigateGoal, PlanReply

P = ParamSpec("P")
Cancel = Callable[[], None]


class NavigationState(enum.Enum):
    """Where a drive stands; those of `ENDS` are its ends."""

    PLANNING = "PLANNING"
    FOLLOWING = "FOLLOWING"
    RECOVERING = "RECOVERING"
    WAITING = "WAITING"
    GIVING_WAY = "GIVING_WAY"
    SUCCEEDED = "SUCCEEDED"
    NEAREST_REACHED = NEAREST_REACHED
    FAILED = "FAILED"
    CANCELLED = "CANCELLED"


ENDS = (
    NavigationState.SUCCEEDED,
    NavigationState.NEAREST_REACHED,
    NavigationState.FAILED,
    NavigationState.CANCELLED,
)
MISSING = (TransformError.code, StaleInputError.code)
TICK_PERIOD = 1.0
BLOCKED_REST = 3.0
HELD = "HELD"
ASIDE_XY, ASIDE_YAW = 0.15, 0.3  # metres and radians within which the robot stands aside
IN_THE_WAY = ("NO_VALID_CONTROL", "FAILED_TO_MAKE_PROGRESS", HELD)
HOPELESS = ("GOAL_OUTSIDE_MAP", "START_OUTSIDE_MAP")


class Driver(Protocol):
    """What a drive needs of the rest of the robot. `done` of a motion gets its outcome's code and sentence."""

    def plan(self, map_from_goal: SE2, done: Callable[[PlanReply | Exception], None]) -> None: ...

    def follow(
        self, path: Path, goal: NavigateGoal, done: Callable[[str, str], None], left: Callable[[float], None]
    ) -> Cancel: ...

    def replace_path(self, path: Path) -> None: ...

    def recover(self, step: RecoveryStep, done: Callable[[str, str], None]) -> Cancel: ...

    def clear_costmaps(self, done: Callable[[], None]) -> None: ...

    def costmap(self) -> CostGrid | None: ...

    def map_from_base(self) -> SE2 | None: ...

    def levels(self) -> GroundLevels | None:
        """Return the levels of the map of ground; None on a planar map, which is level 0."""
        ...

    def choose_level(self, level: int) -> None:
        """Ask for a level to be taken for the one that the robot is on, as soon as what it sees fits it."""
        ...

    def mark_blocked(self, path: Path, *, is_held: bool) -> bool:
        """Take that a path could not be followed from here, `is_held` where something holds the robot; say whether the place is marked now, so that planning goes around it."""
        ...

    def is_in_company(self) -> bool:
        """Return whether people are about, or were lately."""
        ...

    def is_held_up(self, path: Path | None) -> bool:
        """Return whether somebody right before the robot, on its path, has not let it get on for some time."""
        ...

    def find_refuge(self, path: Path | None, done: Callable[[SE2 | None], None]) -> None:
        """Seek where to stand aside for him; `done` gets None where there is no such place."""
        ...

    def is_let_by(self) -> bool:
        """Return whether he is past, or has gone elsewhere."""
        ...

    def report(self, state: str, text: str) -> None: ...

    def finish(self, code: str, text: str) -> None: ...


@dataclass(frozen=True, slots=True)
class NavigationConfig:
    """`keep_path` metres before the goal a path that is still free is kept; `plan_patience` replans in a row may fail while a
    path is followed; after `wait_patience` ticks without pose or input the robot is lost. When nothing leads to the goal and
    clearing did not help, a way is waited for `blocked_patience` seconds: whoever stands there may leave. Where people were about within `company_time` seconds, a drive
    that has tried everything waits and tries it again, up to `company_patience` seconds after it last got on. The place nearest to a goal
    that cannot be reached counts as reached within `loose_tolerance` metres, at any heading; the drive then ends NEAREST_REACHED. A passage between two levels is tried `level_tries` times in
    one drive; the map is asked for the next level from `level_near` metres before it on; where the robot comes to it and is still on the level before, it turns once, for the map to see."""

    keep_path: float = 4.0
    plan_patience: int = 3
    wait_patience: int = 8
    blocked_patience: float = 0.0
    company_patience: float = 0.0
    company_time: float = 60.0
    loose_tolerance: float = 0.35
    level_tries: int = 3
    level_near: float = 0.5
    recoveries: tuple[RecoveryStep, ...] = DEFAULT_SEQUENCE
    blocked: BlockedWaysConfig = field(default_factory=BlockedWaysConfig)
    giving_way: GivingWayConfig = field(default_factory=GivingWayConfig)


class Navigation:
    """One drive. Call `start` once and `tick` every `TICK_PERIOD`; `cancel` at any time.

    `goal_distance`: while driving, how far the end of the path lies from the goal; at the end, how far the robot stands from it.
    """

    def __init__(
        self, config: NavigationConfig, driver: Driver, goal: NavigateGoal, recoveries: RecoverySequence | None = None
    ) -> None:
        self._config = config
        self._driver = driver
        self._goal = goal
        self._leg = goal  # what is driven to now: the goal, or on another level the passage that leads on, `_hop`
        self._hop: Hop | None = None
        self._asked: Hop | None = None
        self._route = LevelRoute(config.level_tries)
        self._recoveries = recoveries or RecoverySequence(config.recoveries)
        self._cancel_motion: Cancel | None = None
        self._epoch = 0
        self._is_replanning = False
        self._has_seen = False  # whether new costs were planned on since the last tick
        self._is_loose = False
        self._has_cleared = False
        self._failed_plans = 0
        self._waits = 0
        self._rest = 0.0
        self._blocked = 0.0
        self._seconds = 0.0
        self._got_on_at = 0.0
        self._asides = 0
        self._refuge: SE2 | None = None  # where it could not go yet to stand aside
        self._path: Path | None = None
        self._arrived_at: Path | None = None
        self._lost_hop = ""
        self.state = NavigationState.PLANNING
        self.detail = ""
        self.goal_distance = 0.0
        self.distance_remaining = 0.0

    @property
    def is_over(self) -> bool:
        """Whether the drive has ended."""
        return self.state in ENDS

    @property
    def recoveries(self) -> int:
        """How many recoveries were tried."""
        return self._recoveries.count

    def recoveries_left(self) -> RecoverySequence | None:
        """Return how another drive from where this one ended should recover; None when this one got on."""
        has_arrived = self.state in (NavigationState.SUCCEEDED, NavigationState.NEAREST_REACHED)
        return None if has_arrived else self._recoveries.continued()

    def start(self) -> None:
        """Begin with a plan."""
        self._plan()

    def cancel(self) -> None:
        """End at once; a motion that is under way is cancelled, which stops the robot."""
        if not self.is_over:
            self._stop_motion()
            self._enter(NavigationState.CANCELLED, "cancelled on request")

    def tick(self) -> None:
        """Replan while driving, unless new costs were planned on since the last tick; try again while waiting."""
        has_seen, self._has_seen = self._has_seen, False
        self._seconds += TICK_PERIOD
        if self.state is NavigationState.WAITING:
            self._plan()
        elif self.state is NavigationState.GIVING_WAY:
            self._stand_aside()
        elif self.state is NavigationState.FOLLOWING and self._gives_way("the robot does not get on", self._plan):
            return
        elif self.state is NavigationState.RECOVERING and self._rest > 0.0:
            self._rest -= TICK_PERIOD
            if self._rest <= 0.0:
                self._plan()
        elif not has_seen:
            self._replan()

    def see_costs(self) -> None:
        """Take that there are new costs: the first after a tick are planned on at once. A tick alone would plan on those of a second before, when map and ticks keep step."""
        if not self._has_seen:
            self._has_seen = True
            self._replan()

    def _replan(self) -> None:
        if self.state is NavigationState.FOLLOWING and not self._is_replanning and not self._keeps_path():
            self._is_replanning = True
            self._driver.plan(self._leg.map_from_goal, self._guarded(self._on_replan))

    def change_level(self) -> None:
        """Take that the robot is on another level now: a goal that says its level is planned to anew from there."""
        if self.is_over or self._goal.level is None:
            return
        if self._hop is not None:
            self._route.try_hop(self._hop)  # a robot that comes and goes through one passage gets nowhere
        self._stop_motion()
        self._begin_leg()

    # Planning

    def _plan(self) -> None:
        if self._choose_leg():
            where = "" if self._hop is None else f" to the passage to level {self._hop.to_level}"
            self._enter(NavigationState.PLANNING, f"asking for a path{where}")
            self._driver.plan(self._leg.map_from_goal, self._guarded(self._on_plan))

    def _choose_leg(self) -> bool:
        """Choose what is driven to now; say whether there is anything."""
        levels, level = self._driver.levels(), self._goal.level
        active, count = (0, 1) if levels is None else (levels.active, levels.count)
        self._leg, self._hop = self._goal, None
        if level is None or level == active:
            return True
        if levels is None or not 0 <= level < count:
            self._fail(NO_SUCH_LEVEL, f"the map has no level {level}: it has {count}, counted from 0")
            return False
        base = self._driver.map_from_base()
        if base is None:
            self._wait("the pose of the robot is not known")
            return False
        self._hop = self._route.next_hop(levels, base, level, self._goal.map_from_goal)
        if self._hop is None:
            why = f"; {self._lost_hop}" if self._lost_hop else ""
            self._fail(LEVEL_NOT_REACHED, f"no passage is left from level {active} to level {level}{why}")
            return False
        self._leg = NavigateGoal(self._hop.map_from_place, self._config.loose_tolerance, math.pi)
        return True

    def _ask_for_level(self, hop: Hop) -> None:
        """Ask for the level behind a passage: there and not before, because farther away the robot may stand at the edge of what that level knows."""
        if self._asked is not hop:
            self._asked = hop
            self._driver.choose_level(hop.to_level)

    def _begin_leg(self) -> None:
        """Plan from another level, or to another passage: what did not help before may help now."""
        self._arrived_at, self._blocked, self._has_cleared = None, 0.0, False
        self._recoveries.begin_anew()
        self._plan()

    def _leave_hop(self, hop: Hop, text: str) -> None:
        """A passage that cannot be reached: take the next best chain of them."""
        self._route.leave_out(hop)
        self._lost_hop = f"the last one, to level {hop.to_level}, failed: {text}"
        self._begin_leg()

    def _on_passage(self, hop: Hop) -> None:
        """The robot stands where it should be on the next level, too, and is not: turn, so that the map sees what is around."""
        self._ask_for_level(hop)
        self._route.try_hop(hop)
        self._lost_hop = (
            f"the robot came to the passage to level {hop.to_level}, and its map stayed on level {hop.of_level}"
        )
        self._enter(NavigationState.RECOVERING, f"rotate because {self._lost_hop}")
        step = RecoveryStep(RecoveryAction.ROTATE, 2.0 * math.pi)
        self._cancel_motion = self._driver.recover(step, self._guarded(lambda outcome, why: self._on_turned()))

    def _on_turned(self) -> None:
        self._cancel_motion = None
        self._plan()

    def _on_plan(self, reply: PlanReply | Exception) -> None:
        if isinstance(reply, PlanReply):
            if self._is_no_nearer(reply):
                self._end_near(reply)
            else:
                self._follow(reply)
            return
        code, text = _named(reply)
        if code in MISSING:
            self._wait(text)
        elif code in HOPELESS:
            self._fail(code, text)
        else:
            self._recover_or_fail(code, text)

    def _on_replan(self, reply: PlanReply | Exception) -> None:
        self._is_replanning = False
        if isinstance(reply, PlanReply):
            self._failed_plans = 0
            self._take(reply)
            self._driver.replace_path(reply.path)
            return
        self._failed_plans += 1
        if self._failed_plans >= self._config.plan_patience:
            self._stop_motion()
            self._on_plan(reply)

    def _keeps_path(self) -> bool:
        """Near the goal a path that is still free is better than a new one that differs a little."""
        costs = self._driver.costmap()
        is_substitute = self.goal_distance > self._leg.xy_tolerance
        if self._path is None or costs is None or is_substitute or self.distance_remaining > self._config.keep_path:
            return False
        return is_path_free(self._path, costs, self.distance_remaining)

    def _take(self, reply: PlanReply) -> None:
        self._path, self.goal_distance = reply.path, reply.goal_distance

    # Driving

    def _follow(self, reply: PlanReply) -> None:
        self._failed_plans = 0
        self._is_replanning = False
        self._take(reply)
        self._enter(NavigationState.FOLLOWING, "driving")
        self._driver.replace_path(reply.path)
        self._is_loose = reply.goal_distance > self._leg.xy_tolerance
        goal = self._loose_goal() if self._is_loose else self._leg
        done = self._guarded(self._on_followed)
        self._cancel_motion = self._driver.follow(reply.path, goal, done, self._on_left)

    def _loose_goal(self) -> NavigateGoal:
        """The end of a path to a substitute: it often lies at the edge of what is free, and its heading means nothing."""
        return replace(
            self._leg, xy_tolerance=max(self._leg.xy_tolerance, self._config.loose_tolerance), yaw_tolerance=math.pi
        )

    def _on_left(self, distance: float) -> None:
        if self.state is NavigationState.FOLLOWING:
            self._waits = 0
            self._blocked = 0.0
            self.distance_remaining = distance
            if self._hop is not None and distance <= self._config.level_near:
                self._ask_for_level(self._hop)
            if self._recoveries.update(distance):
                self._got_on_at, self._asides = self._seconds, 0

    def _on_followed(self, code: str, text: str) -> None:
        self._cancel_motion = None
        if code == "SUCCEEDED" and (self._is_loose or self.goal_distance > self._leg.xy_tolerance):
            self._arrived_at = self._path  # seen from here, the wanted goal may have become reachable
            self._plan()
        elif code == "SUCCEEDED":
            self._arrive()
        elif code in MISSING:
            self._wait(text)
        elif code in IN_THE_WAY and self._gives_way(f"{code}: {text}", partial(self._on_followed, code, text)):
            return
        elif code in IN_THE_WAY and self._path is not None and self._marks(self._path, code):
            self._plan()  # around what is marked now
        else:
            self._recover_or_fail("RECOVERIES_EXHAUSTED", f"{code}: {text}")

    def _marks(self, path: Path, code: str) -> bool:
        return self._driver.mark_blocked(path, is_held=code == HELD)

    # Trouble

    def _wait(self, text: str) -> None:
        self._waits += 1
        if self._waits > self._config.wait_patience:
            self._fail("LOST", text)
        else:
            self._enter(NavigationState.WAITING, text)

    def _gives_way(self, why: str, otherwise: Callable[[], None]) -> bool:
        """Where somebody holds the robot up, seek a place to stand aside, and do `otherwise` where there is none; say whether it is sought."""
        if self._asides >= self._config.giving_way.tries or not self._driver.is_held_up(self._path):
            return False
        self._asides += 1
        self._refuge = None
        self._stop_motion()
        self._enter(NavigationState.GIVING_WAY, f"somebody holds the robot up: {why}")
        self._driver.find_refuge(self._path, self._guarded(partial(self._on_refuge, otherwise)))
        return True

    def _on_refuge(self, otherwise: Callable[[], None], refuge: SE2 | None) -> None:
        if refuge is None:
            self._asides = self._config.giving_way.tries  # until the robot has got on
            otherwise()
        else:
            self._go_aside(refuge)

    def _go_aside(self, refuge: SE2) -> None:
        self._refuge = None
        self._driver.plan(refuge, self._guarded(partial(self._follow_aside, refuge)))

    def _follow_aside(self, refuge: SE2, reply: PlanReply | Exception) -> None:
        # What is nearest to a place that cannot be reached may be right before him.
        if not isinstance(reply, PlanReply) or reply.goal_distance > ASIDE_XY:
            self._go_on()
            return
        self._driver.replace_path(reply.path)
        done = self._guarded(partial(self._on_aside, refuge))
        goal = NavigateGoal(refuge, ASIDE_XY, ASIDE_YAW)
        self._cancel_motion = self._driver.follow(reply.path, goal, done, lambda left: None)

    def _on_aside(self, refuge: SE2, code: str, text: str) -> None:
        self._cancel_motion = None
        if code in MISSING:
            self._wait(text)
        elif code != "SUCCEEDED":
            self._refuge = refuge  # he, or the gate because of him, holds the robot where it is

    def _stand_aside(self) -> None:
        """Wait until he is past; try again to get there where that failed."""
        if self._driver.is_let_by():
            self._go_on()
        elif self._refuge is not None:
            self._go_aside(self._refuge)

    def _go_on(self) -> None:
        """Go on after somebody was let by, or because the place to stand aside cannot be reached."""
        self._stop_motion()
        self._has_cleared = False  # where he walked, what was seen of him may be left
        self._plan()

    def _recover_or_fail(self, code: str, text: str) -> None:
        if self._gives_way(text, partial(self._recover_or_fail, code, text)):
            return
        step = self._recoveries.peek()
        # Moving does not open a way that the map denies; forgetting obstacles may, or whoever stands there leaves.
        is_denied = code == "NO_VALID_PATH" and (step is None or step.action is not RecoveryAction.CLEAR)
        if is_denied and not self._has_cleared:
            self._clear(text)
            return
        if is_denied and self._blocked < self._config.blocked_patience:
            self._blocked += BLOCKED_REST
            self._rest_because(text)
            return
        if step is None or is_denied:
            if self._seconds - self._got_on_at < self._config.company_patience and self._driver.is_in_company():
                self._recoveries.try_again()
                self._has_cleared = False  # they may have left marks where they stood
                self._rest_because(text)
            else:
                self._fail(code, text)
            return
        self._recoveries.take()
        if step.action is RecoveryAction.CLEAR:
            self._clear(text)
            return
        self._enter(NavigationState.RECOVERING, f"{step.action.value} because of {text}")
        if step.action is RecoveryAction.WAIT:
            self._rest = step.amount
        else:
            done = self._guarded(lambda outcome, why: self._on_recovered(outcome, why, code, text))
            self._cancel_motion = self._driver.recover(step, done)

    def _rest_because(self, text: str) -> None:
        self._enter(NavigationState.RECOVERING, f"{RecoveryAction.WAIT.value} because of {text}")
        self._rest = BLOCKED_REST

    def _clear(self, text: str) -> None:
        self._has_cleared = True
        self._enter(NavigationState.RECOVERING, f"{RecoveryAction.CLEAR.value} because of {text}")
        self._driver.clear_costmaps(self._guarded(self._plan))

    def _on_recovered(self, outcome: str, why: str, code: str, text: str) -> None:
        self._cancel_motion = None
        if outcome == "SUCCEEDED":
            self._plan()
        elif outcome in MISSING:
            self._wait(why)
        else:
            self._recover_or_fail(code, f"{text}; {outcome}: {why}")

    def _is_no_nearer(self, reply: PlanReply) -> bool:
        if self._arrived_at is None or reply.goal_distance <= self._leg.xy_tolerance:
            return False
        gap = reply.path.poses[-1, :2] - self._arrived_at.poses[-1, :2]
        return math.hypot(gap[0], gap[1]) <= self._config.loose_tolerance

    def _end_near(self, reply: PlanReply) -> None:
        """The goal cannot be reached and nothing is nearer: say how far the robot stands from it, unless that is near enough."""
        base, goal = self._driver.map_from_base(), self._leg
        away = reply.goal_distance if base is None else base.distance_to(goal.map_from_goal)
        turn = 0.0 if base is None else abs(wrap_angle(base.yaw - goal.map_from_goal.yaw))
        if away <= goal.xy_tolerance and turn <= goal.yaw_tolerance:
            self._arrive()
            return
        if self._hop is not None:
            self._leave_hop(self._hop, f"it cannot be reached, the robot stands {away:.2f} m from it")
            return
        text = f"the goal cannot be reached; the robot stands {away:.2f} m from it"
        if reply.goal_distance < away - 0.01:
            text += f", and the nearest place that it can reach lies {reply.goal_distance:.2f} m from it"
        self._finish(NavigationState.NEAREST_REACHED, NEAREST_REACHED, text)

    def _arrive(self) -> None:
        """The robot is where the leg ends."""
        if self._hop is not None:
            self._on_passage(self._hop)
        else:
            self._finish(NavigationState.SUCCEEDED, "SUCCEEDED", "the goal is reached")

    def _fail(self, code: str, text: str) -> None:
        if self._hop is not None and code != "LOST":
            self._leave_hop(self._hop, text)
        else:
            self._finish(NavigationState.FAILED, code, text)

    def _finish(self, state: NavigationState, code: str, text: str) -> None:
        base = self._driver.map_from_base()
        if base is not None:
            self.goal_distance = base.distance_to(self._goal.map_from_goal)
        self._enter(state, text)
        self._driver.finish(code, text)

    def _stop_motion(self) -> None:
        if self._cancel_motion is not None:
            cancel, self._cancel_motion = self._cancel_motion, None
            cancel()

    def _enter(self, state: NavigationState, detail: str) -> None:
        self._epoch += 1
        self._rest = 0.0
        self._is_replanning = False
        levels = self._driver.levels() if state in ENDS and self._asked is not None else None
        if levels is not None:
            self._driver.choose_level(levels.active)  # nobody is on the way to another one any more
        self.state, self.detail = state, detail
        self._driver.report(state.value, detail)

    def _guarded(self, handler: Callable[P, None]) -> Callable[P, None]:
        """An answer counts only in the state that asked for it."""
        epoch = self._epoch

        def answer(*args: P.args, **kwargs: P.kwargs) -> None:
            if epoch == self._epoch:
                handler(*args, **kwargs)

        return answer


def _named(error: Exception) -> tuple[str, str]:
    return (error.code, str(error)) if isinstance(error, AmblerError) else ("PLANNING_FAILED", str(error))


def is_path_free(path: Path, costs: CostGrid, length: float) -> bool:
    """Say whether the last `length` metres of a path lie in known cells where the robot's centre may be."""
    step = np.hypot(np.diff(path.poses[:, 0]), np.diff(path.poses[:, 1]))
    to_end = np.concatenate((np.cumsum(step[::-1])[::-1], [0.0]))
    cells = costs.spec.cells_of(path.poses[to_end <= length, :2])
    iy, ix = cells[:, 0], cells[:, 1]
    is_inside = (iy >= 0) & (iy < costs.spec.height) & (ix >= 0) & (ix < costs.spec.width)
    if not is_inside.all():
        return False
    values = costs.data[iy, ix]
    return not bool(((values >= COST_INSCRIBED) & (values <= COST_UNKNOWN)).any())
