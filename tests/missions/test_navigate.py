"""The navigator's state machine against a scripted driver: every way a drive can end, and cancelling in every state."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from ambler.core.errors import (
    AmblerError,
    GoalOutsideMapError,
    NoValidPathError,
    StartOccupiedError,
    StartOutsideMapError,
    TransformError,
)
from ambler.core.grid import GridSpec
from ambler.core.messages import CostGrid, GroundLevels, Path
from ambler.core.se2 import SE2
from ambler.missions.navigate import TICK_PERIOD, Navigation, NavigationConfig, NavigationState, is_path_free
from ambler.missions.recovery import DEFAULT_SEQUENCE, RecoveryAction, RecoverySequence, RecoveryStep
from ambler.runtime.tasks import NAVIGATE, NavigateGoal, PlanReply

GOAL = NavigateGoal(SE2(5.0, 0.0, 0.0))
SPEC = GridSpec(0.1, 100, 100, -5.0, -5.0)


def path_to(x: float) -> Path:
    xs = np.linspace(0.0, x, max(2, round(abs(x) / 0.1)))
    return Path(0, "map", np.stack((xs, np.zeros_like(xs), np.zeros_like(xs)), axis=1))


def plan_to(x: float, goal_distance: float = 0.0) -> PlanReply:
    return PlanReply(path_to(x), x, goal_distance)


class Script:
    """A driver that remembers what was asked and answers when the test says so. `moving` is the motion under way."""

    def __init__(self) -> None:
        self.plans: list[Callable[[PlanReply | Exception], None]] = []
        self.follows: list[tuple[NavigateGoal, Callable[[str, str], None], Callable[[float], None]]] = []
        self.recoveries: list[tuple[RecoveryStep, Callable[[str, str], None]]] = []
        self.clears: list[Callable[[], None]] = []
        self.paths: list[Path] = []
        self.moving: str | None = None
        self.ends: list[tuple[str, str]] = []
        self.grid: CostGrid | None = None
        self.states: list[str] = []
        self.texts: list[str] = []
        self.base: SE2 | None = None
        self.is_marked = self.has_company = False
        self.somebody = self.is_past = False
        self.seeking: list[Callable[[SE2 | None], None]] = []
        self.blocked: list[Path] = []
        self.held: list[bool] = []

    def plan(self, map_from_goal: SE2, done: Callable[[PlanReply | Exception], None]) -> None:
        assert map_from_goal == GOAL.map_from_goal
        self.plans.append(done)

    def follow(
        self, path: Path, goal: NavigateGoal, done: Callable[[str, str], None], left: Callable[[float], None]
    ) -> Callable[[], None]:
        self.moving = "follow"
        self.follows.append((goal, self._ending(done), left))
        return self._stop

    def replace_path(self, path: Path) -> None:
        self.paths.append(path)

    def recover(self, step: RecoveryStep, done: Callable[[str, str], None]) -> Callable[[], None]:
        self.moving = "recover"
        self.recoveries.append((step, self._ending(done)))
        return self._stop

    def clear_costmaps(self, done: Callable[[], None]) -> None:
        self.clears.append(done)

    def costmap(self) -> CostGrid | None:
        return self.grid

    def map_from_base(self) -> SE2 | None:
        return self.base

    def levels(self) -> GroundLevels | None:
        return None

    def choose_level(self, level: int) -> None:
        raise AssertionError("a planar map has one level")

    def mark_blocked(self, path: Path, *, is_held: bool) -> bool:
        self.blocked.append(path)
        self.held.append(is_held)
        return self.is_marked

    def is_in_company(self) -> bool:
        return self.has_company

    def is_held_up(self, path: Path | None) -> bool:
        return self.somebody

    def find_refuge(self, path: Path | None, done: Callable[[SE2 | None], None]) -> None:
        self.seeking.append(done)

    def is_let_by(self) -> bool:
        return self.is_past

    def report(self, state: str, text: str) -> None:
        assert text
        self.states.append(state)
        self.texts.append(text)

    def finish(self, code: str, text: str) -> None:
        self.ends.append((code, text))

    def _stop(self) -> None:
        self.moving = None

    def _ending(self, done: Callable[[str, str], None]) -> Callable[[str, str], None]:
        def end(code: str, text: str) -> None:
            self.moving = None
            done(code, text)

        return end


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def drive(script: Script) -> Navigation:
    navigation = Navigation(NavigationConfig(), script, GOAL)
    navigation.start()
    return navigation


def fail_follow(script: Script, code: str = "NO_VALID_CONTROL") -> None:
    script.follows[-1][1](code, "blocked")


def test_plan_follow_succeed(script: Script, drive: Navigation) -> None:
    assert drive.state is NavigationState.PLANNING
    script.plans[-1](plan_to(5.0))
    assert drive.state is NavigationState.FOLLOWING
    assert script.follows[-1][0] == GOAL
    assert len(script.paths) == 1
    script.follows[-1][2](3.2)
    assert drive.distance_remaining == 3.2
    script.follows[-1][1]("SUCCEEDED", "")
    assert drive.state is NavigationState.SUCCEEDED
    assert drive.is_over
    assert script.ends[0][0] == "SUCCEEDED"
    assert script.moving is None
    drive.tick()
    drive.cancel()
    assert len(script.ends) == 1
    assert drive.state is NavigationState.SUCCEEDED


@pytest.mark.parametrize("error", [GoalOutsideMapError("far"), StartOutsideMapError("lost")])
def test_hopeless_plans_fail_at_once(script: Script, drive: Navigation, error: AmblerError) -> None:
    script.plans[-1](error)
    assert script.ends == [(error.code, str(error))]
    assert not script.clears


def test_no_path_clears_once_then_fails_with_its_name(script: Script, drive: Navigation) -> None:
    script.plans[-1](NoValidPathError("walled in"))
    assert drive.state is NavigationState.RECOVERING
    script.clears[-1]()
    assert drive.state is NavigationState.PLANNING
    script.plans[-1](NoValidPathError("still walled in"))
    assert script.ends == [("NO_VALID_PATH", "still walled in")]
    assert drive.recoveries == 1
    assert not script.recoveries


def test_a_patient_drive_waits_for_a_way(script: Script) -> None:
    drive = Navigation(NavigationConfig(blocked_patience=6.0), script, GOAL)
    drive.start()
    script.plans[-1](NoValidPathError("somebody stands in the door"))
    script.clears[-1]()
    for _ in range(2):
        script.plans[-1](NoValidPathError("somebody stands in the door"))
        assert script.texts[-1] == "wait because of somebody stands in the door"
        rest(drive, 3.0)
    script.plans[-1](plan_to(5.0))
    assert drive.state is NavigationState.FOLLOWING
    script.follows[-1][2](4.0)  # it drives, so its patience is fresh
    fail_follow(script, "NO_VALID_CONTROL")
    script.recoveries[-1][1]("SUCCEEDED", "")
    for _ in range(2):
        script.plans[-1](NoValidPathError("another one"))
        rest(drive, 3.0)
    script.plans[-1](NoValidPathError("a wall"))
    assert script.ends == [("NO_VALID_PATH", "a wall")]


def try_everything(script: Script, drive: Navigation) -> None:
    """Fail until every recovery was tried in vain, and once more."""
    for step in DEFAULT_SEQUENCE:
        fail_follow(script, "NO_VALID_CONTROL")
        if step.action is RecoveryAction.CLEAR:
            script.clears[-1]()
        elif step.action is RecoveryAction.WAIT:
            rest(drive, step.amount)
        else:
            script.recoveries[-1][1]("SUCCEEDED", "")
        script.plans[-1](plan_to(5.0))
    fail_follow(script, "NO_VALID_CONTROL")


@pytest.mark.parametrize("is_known_way", [True, False])
def test_among_people_everything_is_tried_again(script: Script, *, is_known_way: bool) -> None:
    drive = Navigation(NavigationConfig(company_patience=60.0), script, GOAL)
    script.has_company = True
    drive.start()
    if not is_known_way:
        script.plans[-1](NoValidPathError("somebody stands in the door"))
        script.clears[-1]()
        script.plans[-1](NoValidPathError("somebody stands in the door"))
        rest(drive, 3.0)
    script.plans[-1](plan_to(5.0))
    script.follows[-1][2](5.0)
    try_everything(script, drive)
    assert script.ends == []
    rest(drive, 3.0)
    script.plans[-1](plan_to(5.0))
    for _ in range(60):
        drive.tick()
    script.follows[-1][2](4.4)  # it gets on, so its patience is fresh
    try_everything(script, drive)
    assert script.ends == []
    rest(drive, 3.0)
    script.plans[-1](plan_to(5.0))
    script.follows[-1][2](4.0)  # less than half a metre is no progress
    for _ in range(60):
        drive.tick()
    try_everything(script, drive)
    assert [code for code, _ in script.ends] == ["RECOVERIES_EXHAUSTED"]


def test_without_people_nothing_is_tried_again(script: Script) -> None:
    drive = Navigation(NavigationConfig(company_patience=60.0), script, GOAL)
    drive.start()
    script.plans[-1](plan_to(5.0))
    try_everything(script, drive)
    assert [code for code, _ in script.ends] == ["RECOVERIES_EXHAUSTED"]


def rest(drive: Navigation, seconds: float) -> None:
    """Tick until just before the end of a wait, then once more."""
    for _ in range(math.ceil(seconds / TICK_PERIOD)):
        assert drive.state is NavigationState.RECOVERING
        drive.tick()
    assert drive.state is NavigationState.PLANNING


def test_every_kind_of_recovery_is_tried_and_tells_its_reason(script: Script, drive: Navigation) -> None:
    tried: list[RecoveryAction] = []
    for step in DEFAULT_SEQUENCE:
        script.plans[-1](plan_to(5.0))
        script.follows[-1][1]("NO_VALID_CONTROL", f"a chair stands there ({len(tried)})")
        assert (
            script.texts[-1] == f"{step.action.value} because of NO_VALID_CONTROL: a chair stands there ({len(tried)})"
        )
        tried.append(step.action)
        if step.action is RecoveryAction.CLEAR:
            script.clears[-1]()
        elif step.action is RecoveryAction.WAIT:
            assert script.moving is None
            rest(drive, step.amount)
        else:
            script.recoveries[-1][1]("SUCCEEDED", "")
    assert set(tried) == set(RecoveryAction)


def test_recoveries_escalate_and_run_out(script: Script, drive: Navigation) -> None:
    for step in DEFAULT_SEQUENCE:
        script.plans[-1](plan_to(5.0))
        fail_follow(script)
        assert drive.state is NavigationState.RECOVERING
        if step.action is RecoveryAction.CLEAR:
            script.clears.pop()()
        elif step.action is RecoveryAction.WAIT:
            rest(drive, step.amount)
        else:
            assert script.recoveries[-1][0] == step
            script.recoveries[-1][1]("SUCCEEDED", "")
    assert drive.recoveries == len(DEFAULT_SEQUENCE) == 7
    script.plans[-1](plan_to(5.0))
    fail_follow(script, "FAILED_TO_MAKE_PROGRESS")
    assert script.ends[0][0] == "RECOVERIES_EXHAUSTED"
    assert "FAILED_TO_MAKE_PROGRESS" in script.ends[0][1]
    assert script.moving is None


def test_a_recovery_that_fails_leads_to_the_next_at_once(script: Script, drive: Navigation) -> None:
    script.plans[-1](StartOccupiedError("inside a wall"))
    script.clears[-1]()
    script.plans[-1](StartOccupiedError("inside a wall"))
    for code in ("COLLISION_AHEAD", "TIMEOUT"):
        assert drive.state is NavigationState.RECOVERING
        script.recoveries[-1][1](code, "no room")
    assert len(script.recoveries) == 2
    rest(drive, 3.0)
    script.plans[-1](StartOccupiedError("inside a wall"))
    script.clears[-1]()
    script.plans[-1](StartOccupiedError("inside a wall"))
    script.recoveries[-1][1]("COLLISION_AHEAD", "no room")
    script.recoveries[-1][1]("COLLISION_AHEAD", "no room")
    assert script.ends[0][0] == "START_OCCUPIED"


def test_progress_starts_the_sequence_anew(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(5.0))
    script.follows[-1][2](5.0)
    fail_follow(script)
    script.clears[-1]()
    script.plans[-1](plan_to(5.0))
    script.follows[-1][2](4.0)
    fail_follow(script)
    assert len(script.clears) == 2, "half a metre of progress begins with clearing again"
    assert drive.recoveries == 2


def test_no_progress_does_not(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(5.0))
    script.follows[-1][2](5.0)
    fail_follow(script)
    script.clears[-1]()
    script.plans[-1](plan_to(5.0))
    script.follows[-1][2](4.6)
    script.follows[-1][2](6.0)
    fail_follow(script)
    assert script.recoveries[-1][0].action is RecoveryAction.ROTATE


@pytest.mark.parametrize("code", ["STALE_INPUT", "TRANSFORM_MISSING"])
def test_missing_input_waits_then_is_lost(script: Script, drive: Navigation, code: str) -> None:
    script.plans[-1](plan_to(5.0))
    fail_follow(script, code)
    for _ in range(NavigationConfig().wait_patience):
        assert drive.state is NavigationState.WAITING
        drive.tick()
        script.plans[-1](TransformError("map_from_base is missing"))
    assert script.ends == [("LOST", "map_from_base is missing")]


def test_input_that_comes_back_goes_on(script: Script, drive: Navigation) -> None:
    script.plans[-1](TransformError("map_from_odom is missing"))
    assert drive.state is NavigationState.WAITING
    drive.tick()
    script.plans[-1](plan_to(5.0))
    assert drive.state is NavigationState.FOLLOWING
    script.follows[-1][1]("SUCCEEDED", "")
    assert script.ends[0][0] == "SUCCEEDED"


def test_replanning_replaces_the_path_and_bears_two_failures(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(5.0))
    drive.tick()
    assert len(script.plans) == 2
    drive.tick()
    assert len(script.plans) == 2, "one question at a time"
    script.plans[-1](plan_to(4.9))
    assert len(script.paths) == 2
    assert script.moving == "follow"
    for _ in range(2):
        drive.tick()
        script.plans[-1](NoValidPathError("closed"))
        assert drive.state is NavigationState.FOLLOWING
    drive.tick()
    script.plans[-1](NoValidPathError("closed"))
    assert drive.state is NavigationState.RECOVERING
    assert script.moving is None
    assert script.follows[-1][1] is not None


def test_a_free_path_near_the_goal_is_kept(script: Script, drive: Navigation) -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    script.grid = CostGrid(0, "map", SPEC, costs)
    script.plans[-1](plan_to(4.5))
    script.follows[-1][2](4.5)
    drive.tick()
    assert len(script.plans) == 2
    script.plans[-1](plan_to(4.5))
    script.follows[-1][2](3.0)
    drive.tick()
    assert len(script.plans) == 2
    blocked = costs.copy()
    blocked[50, 80] = 254
    script.grid = CostGrid(0, "map", SPEC, blocked)
    drive.tick()
    assert len(script.plans) == 3


def test_new_costs_are_planned_on_at_once_but_once_between_two_ticks(script: Script, drive: Navigation) -> None:
    """A plan made on the tick that comes a moment before them would be on those of a second before."""
    script.plans[-1](plan_to(9.0))
    script.follows[-1][2](9.0)
    for _ in range(3):
        drive.see_costs()
        assert len(script.plans) == 2
        drive.see_costs()
        script.plans[-1](plan_to(9.0))
        drive.see_costs()
        drive.tick()
        assert len(script.plans) == 2, "no tick plans again what was planned on new costs"
        script.plans.pop()
    drive.tick()
    assert len(script.plans) == 2, "without new costs the tick does"
    drive.cancel()
    drive.see_costs()
    assert len(script.plans) == 2


def test_what_lies_behind_does_not_block_a_path() -> None:
    costs = np.zeros(SPEC.shape, np.uint8)
    costs[50, 60] = 253
    grid = CostGrid(0, "map", SPEC, costs)
    assert is_path_free(path_to(4.5), grid, 3.0)
    assert not is_path_free(path_to(4.5), grid, 4.0)
    assert not is_path_free(path_to(6.0), grid, 1.5), "outside of the map"


def test_a_substitute_counts_when_nothing_nearer_is_left(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(3.0, goal_distance=2.0))
    goal = script.follows[-1][0]
    assert goal.yaw_tolerance == math.pi
    assert goal.xy_tolerance == NavigationConfig().loose_tolerance
    script.follows[-1][2](1.0)
    drive.tick()
    assert len(script.plans) == 2, "while the goal is out of reach a path is never kept"
    script.plans[-1](plan_to(4.0, goal_distance=1.0))
    script.follows[-1][1]("SUCCEEDED", "")
    assert drive.state is NavigationState.PLANNING
    script.base = SE2(3.97, 0.1, 1.0)
    script.plans[-1](plan_to(4.1, goal_distance=0.9))
    assert drive.state is NavigationState.NEAREST_REACHED
    assert drive.is_over
    assert drive.goal_distance == pytest.approx(math.hypot(1.03, 0.1)), (
        "where the robot stands, not where the path ended"
    )
    code, text = script.ends[0]
    assert code == "NEAREST_REACHED"
    assert code in NAVIGATE.failures
    assert "cannot be reached" in text
    assert "1.03 m" in text


def reach_a_substitute(script: Script, base: SE2 | None, goal_distance: float) -> None:
    script.plans[-1](plan_to(5.0 - goal_distance, goal_distance=goal_distance))
    script.follows[-1][1]("SUCCEEDED", "")
    script.base = base
    script.plans[-1](plan_to(5.0 - goal_distance, goal_distance=goal_distance))


def test_a_robot_that_stands_at_an_unreachable_goal_has_reached_it(script: Script, drive: Navigation) -> None:
    """The goal's own cell is shut, but the robot came within the tolerances of the goal."""
    reach_a_substitute(script, SE2(4.9, 0.05, GOAL.yaw_tolerance - 0.01), 0.3)
    assert script.ends == [("SUCCEEDED", "the goal is reached")]
    assert drive.goal_distance == pytest.approx(math.hypot(0.1, 0.05))


@pytest.mark.parametrize("base", [SE2(4.9, 0.05, GOAL.yaw_tolerance + 0.01), SE2(4.8, 0.0, 0.0), None])
def test_one_that_stands_askew_beside_it_or_nowhere_known_has_not(script: Script, drive: Navigation, base: SE2) -> None:
    reach_a_substitute(script, base, 0.3)
    assert script.ends[0][0] == "NEAREST_REACHED"
    assert ("0.30 m" in script.ends[0][1]) == (base is None)


def test_a_goal_that_is_shut_on_the_way_is_not_called_reached(script: Script, drive: Navigation) -> None:
    """Somebody steps onto the goal: the path is replaced by one that ends before it, and following that one succeeds."""
    script.plans[-1](plan_to(5.0))
    script.follows[-1][2](2.0)
    drive.tick()
    script.plans[-1](plan_to(4.2, goal_distance=0.8))
    script.follows[-1][1]("SUCCEEDED", "")
    assert not script.ends
    script.base = SE2(4.2, 0.0, 0.0)
    script.plans[-1](plan_to(4.2, goal_distance=0.8))
    assert script.ends[0][0] == "NEAREST_REACHED"


def test_a_goal_that_becomes_reachable_is_driven_to_exactly(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(3.0, goal_distance=2.0))
    script.follows[-1][1]("SUCCEEDED", "")
    script.plans[-1](plan_to(5.0))
    assert script.follows[-1][0] == GOAL
    script.follows[-1][1]("SUCCEEDED", "")
    assert script.ends[0][0] == "SUCCEEDED"
    assert drive.goal_distance == 0.0, "without a pose, that of the path's end"


def cancelled_in_planning(script: Script, drive: Navigation) -> None:
    drive.cancel()
    script.plans[-1](plan_to(5.0))


def cancelled_in_following(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(5.0))
    drive.tick()
    drive.cancel()
    script.plans[-1](plan_to(4.0))


def cancelled_in_clearing(script: Script, drive: Navigation) -> None:
    script.plans[-1](NoValidPathError("closed"))
    drive.cancel()
    script.clears[-1]()


def cancelled_in_recovering(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(5.0))
    fail_follow(script)
    script.clears[-1]()
    script.plans[-1](plan_to(5.0))
    fail_follow(script)
    assert script.moving == "recover"
    drive.cancel()
    script.recoveries[-1][1]("CANCELLED", "")


def cancelled_in_waiting(script: Script, drive: Navigation) -> None:
    script.plans[-1](TransformError("nothing yet"))
    drive.cancel()
    drive.tick()


@pytest.mark.parametrize(
    "scene",
    [
        cancelled_in_planning,
        cancelled_in_following,
        cancelled_in_clearing,
        cancelled_in_recovering,
        cancelled_in_waiting,
    ],
)
def test_cancel_ends_every_state_without_motion(
    script: Script, drive: Navigation, scene: Callable[[Script, Navigation], None]
) -> None:
    scene(script, drive)
    asked = len(script.plans), len(script.follows), len(script.recoveries), len(script.clears)
    assert drive.state is NavigationState.CANCELLED
    assert script.moving is None
    assert not script.ends, "the outcome of a cancelled goal is not the navigator's to tell"
    drive.tick()
    assert asked == (len(script.plans), len(script.follows), len(script.recoveries), len(script.clears))


def test_late_answers_are_ignored(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(5.0))
    drive.tick()
    late = script.plans[-1]
    fail_follow(script)
    late(plan_to(4.0))
    assert drive.state is NavigationState.RECOVERING
    assert len(script.paths) == 1


def test_the_sequence_gives_each_step_once() -> None:
    sequence = RecoverySequence((RecoveryStep(RecoveryAction.CLEAR), RecoveryStep(RecoveryAction.ROTATE, 1.0)))
    for _ in range(2):
        assert sequence.peek() is not None
        sequence.take()
    assert sequence.peek() is None
    sequence.update(4.0)
    assert sequence.peek() is None
    sequence.update(3.6)
    assert sequence.peek() is None
    sequence.update(3.4)
    assert sequence.peek() == RecoveryStep(RecoveryAction.CLEAR)
    assert sequence.count == 2


def test_a_way_that_is_marked_is_planned_around_without_another_recovery(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(5.0))
    fail_follow(script)
    assert drive.state is NavigationState.RECOVERING, "not marked yet: recover"
    script.clears[-1]()
    script.plans[-1](plan_to(5.0))
    script.is_marked = True
    fail_follow(script, "HELD")
    assert drive.state is NavigationState.PLANNING
    assert script.held == [False, True]
    assert drive.recoveries == 1
    script.plans[-1](plan_to(5.0))
    fail_follow(script, "STALE_INPUT")
    assert len(script.blocked) == 2, "missing input says nothing of the way"


def test_another_drive_from_where_one_failed_goes_on_with_the_next_cure(script: Script, drive: Navigation) -> None:
    script.plans[-1](plan_to(5.0))
    fail_follow(script)
    script.clears.pop()()
    drive.cancel()
    again = Navigation(NavigationConfig(), script, GOAL, drive.recoveries_left())
    again.start()
    script.plans[-1](plan_to(5.0))
    fail_follow(script)
    assert script.recoveries[-1][0] == DEFAULT_SEQUENCE[1], "clearing did not help before"
    assert again.recoveries == 1
    script.recoveries[-1][1]("SUCCEEDED", "")
    script.plans[-1](NoValidPathError("shut"))
    script.clears.pop()()
    script.plans[-1](plan_to(5.0))
    script.follows[-1][1]("SUCCEEDED", "")
    assert again.recoveries_left() is None, "it got on"


def test_one_that_stopped_short_of_the_nearest_place_says_how_far_that_is(script: Script, drive: Navigation) -> None:
    reach_a_substitute(script, SE2(4.4, 0.0, 0.0), 0.3)
    assert script.ends[0][0] == "NEAREST_REACHED"
    assert "stands 0.60 m from it, and the nearest place that it can reach lies 0.30 m from it" in script.ends[0][1]
