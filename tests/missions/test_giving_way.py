"""Who holds a robot up, where it stands aside for him, and when it goes on."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from ambler.core.errors import BadInputError, NoValidPathError
from ambler.core.grid import COST_INSCRIBED, COST_LETHAL, GridSpec
from ambler.core.messages import CostGrid
from ambler.core.se2 import SE2
from ambler.missions.giving_way import GivingWay, GivingWayConfig
from ambler.missions.navigate import Navigation, NavigationConfig, NavigationState
from ambler.planning.refuge import RefugeConfig
from ambler.robots.catalog import robot_model
from ambler.runtime.tasks import PlanReply
from tests.missions.test_navigate import GOAL, Script, plan_to

ROBOT = robot_model("amr_omni")
AHEAD = np.column_stack((np.linspace(0.0, 6.0, 60), np.zeros(60), np.zeros(60)))
CONFIG = GivingWayConfig()


def met(
    *places: tuple[float, float], seconds: float = 14.0, begin: float = 0.0, giving: GivingWay | None = None
) -> GivingWay:
    """People who are at these places for so long, while the robot stands at the origin."""
    giving_way = GivingWay(CONFIG, ROBOT) if giving is None else giving
    for t in np.arange(begin, begin + seconds + 1e-9, 0.1):
        giving_way.meet(round(t * 1e9), np.array(places, np.float64).reshape(-1, 2), SE2())
    return giving_way


def walk(giving_way: GivingWay, begin: float, start: tuple[float, float], end: tuple[float, float]) -> float:
    """Somebody walks at 1 m/s; returns when he is there."""
    length = math.dist(start, end)
    for s in np.arange(0.0, length + 1e-9, 0.1):
        share = s / length
        place = np.array([[start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])]])
        giving_way.meet(round((begin + s) * 1e9), place, SE2())
    return begin + length


@pytest.mark.parametrize(
    ("place", "is_held"),
    [((1.0, 0.0), True), ((1.2, 0.6), True), ((-0.8, 0.0), False), ((1.2, 2.0), False), ((3.5, 0.0), False)],
    ids=["before it", "half beside its path", "behind it", "beside its path", "far ahead"],
)
def test_only_who_is_on_the_path_ahead_holds_a_robot_up(place: tuple[float, float], *, is_held: bool) -> None:
    assert met(place).is_held_up(round(14e9), SE2(), AHEAD) == is_held


def test_a_robot_that_gets_on_or_has_just_met_him_is_not_held_up() -> None:
    assert not met((1.0, 0.0), seconds=5.0).is_held_up(round(5e9), SE2(), AHEAD), "not for long enough"
    moving = GivingWay(CONFIG, ROBOT)
    for t in np.arange(0.0, 20.0, 0.1):
        here = SE2(0.15 * t, 0.0, 0.0)
        moving.meet(round(t * 1e9), np.array([[here.x + 1.0, 0.0]]), here)
    assert not moving.is_held_up(round(20e9), here, AHEAD), "it drives behind somebody slow"
    ponderous = GivingWay(CONFIG, ROBOT)
    for t in np.arange(0.0, 40.0, 0.1):
        here = SE2(1.4 * math.sin(0.3 * t), 0.0, 0.0)
        ponderous.meet(round(t * 1e9), np.array([[here.x + 1.0, 0.0]]), here)
    assert ponderous.is_held_up(round(40e9), here, AHEAD), "to and fro before him for half a minute"
    later = met((1.0, 0.0), begin=100.0, seconds=1.0, giving=met((1.0, 0.0)))
    assert not later.is_held_up(round(101e9), SE2(), AHEAD), "another meeting, long after"
    assert not met(seconds=10.0).is_held_up(round(14e9), SE2(), AHEAD), "nobody is there"


def test_a_robot_that_is_paused_is_held_up_by_nobody() -> None:
    giving_way = met((1.0, 0.0))
    giving_way.rest()
    assert not giving_way.is_held_up(round(14e9), SE2(), AHEAD)


@pytest.mark.parametrize(
    ("before", "idle", "after", "is_held"),
    [(6.0, 4.0, 4.0, True), (5.0, 6.0, 1.0, False), (14.0, 12.0, 1.0, False)],
    ids=["before and after together", "what was idle does not count", "long after is another meeting"],
)
def test_time_between_two_drives_does_not_count(before: float, idle: float, after: float, *, is_held: bool) -> None:
    """An explorer decides for some seconds, or holds still for a scan, while he stands there."""
    giving_way, end = met((1.0, 0.0), seconds=before), before + idle + after
    giving_way.take_idle(round(before * 1e9), is_idle=True)
    met((1.0, 0.0), begin=before, seconds=idle, giving=giving_way)
    giving_way.take_idle(round((before + idle) * 1e9), is_idle=False)
    met((1.0, 0.0), begin=before + idle, seconds=after, giving=giving_way)
    assert giving_way.is_held_up(round(end * 1e9), SE2(), AHEAD) == is_held


def test_who_comes_after_long_without_anybody_half_of_it_between_two_drives_is_somebody_new() -> None:
    giving_way = met((1.0, 0.0), seconds=8.0)
    giving_way.take_idle(round(17.5e9), is_idle=True)
    giving_way.take_idle(round(27.0e9), is_idle=False)
    met((1.0, 0.0), begin=27.0, seconds=1.0, giving=giving_way)
    assert not giving_way.is_held_up(round(28e9), SE2(), AHEAD)


def test_while_the_place_is_looked_for_it_is_not_over() -> None:
    giving_way = met((1.0, 0.0))
    assert giving_way.seek(round(14e9), SE2(), AHEAD, corridor_grid()) is not None
    assert not giving_way.is_over(round(14.1e9))


def test_who_comes_after_nobody_was_there_for_nine_seconds_holds_up_nobody_yet() -> None:
    giving_way = GivingWay(CONFIG, ROBOT)
    for t in np.arange(0.0, 1.0, 0.1):
        giving_way.meet(round(t * 1e9), np.array([[1.0, 0.0]]), SE2())
    for t in np.arange(9.5, 11.0, 0.1):
        here = SE2(0.5 * t, 0.0, 0.0)
        giving_way.meet(round(t * 1e9), np.array([[here.x + 1.0, 0.0]]), here)
        assert not giving_way.is_held_up(round(t * 1e9), here, None)


def test_what_was_not_spent_aside_is_not_lost() -> None:
    """The drive was cancelled while it stood aside, and the robot stood about for an hour."""
    giving_way = met((1.0, 0.0))
    aside(giving_way, 14.0)
    giving_way.end(round(16e9))
    met((1.0, 0.0), begin=3600.0, giving=giving_way)
    assert giving_way.is_held_up(round(3614e9), SE2(), None)


def test_on_another_level_nobody_of_the_first_is_there() -> None:
    giving_way = met((1.0, 0.0))
    giving_way.forget()
    assert not giving_way.is_held_up(round(14e9), SE2(), None)


def test_without_a_path_who_stands_anywhere_near_counts() -> None:
    assert met((-1.0, 0.0)).is_held_up(round(14e9), SE2(), None)
    assert not met((-4.0, 0.0)).is_held_up(round(14e9), SE2(), None)


def corridor_grid() -> CostGrid:
    """A corridor of 2 m along x, whose middle is y = 0, with a room behind a door at x = -3 in its left wall."""
    spec = GridSpec(0.05, 400, 140, -10.0, -3.5)
    walls = np.ones(spec.shape, np.bool_)
    walls[50:90] = False
    walls[90:125, 126:154] = False
    near = distance_transform_edt(~walls) * 0.05 < ROBOT.inscribed_radius
    return CostGrid(0, "map", spec, np.where(walls, COST_LETHAL, np.where(near, COST_INSCRIBED, 0)).astype(np.uint8))


def aside(giving_way: GivingWay, now: float) -> SE2:
    search = giving_way.seek(round(now * 1e9), SE2(), None, corridor_grid())
    assert search is not None
    refuge = search()
    assert refuge is not None
    giving_way.go_to(round(now * 1e9), SE2(), refuge)
    return refuge


def test_it_waits_until_he_is_past_and_not_until_he_has_turned_round() -> None:
    giving_way = GivingWay(CONFIG, ROBOT)
    now = walk(giving_way, 0.0, (5.0, 0.0), (0.9, 0.0))
    refuge = aside(giving_way, now)
    assert refuge.y > 1.0
    now = walk(giving_way, now, (0.9, 0.0), (3.0, 0.0))
    assert not giving_way.is_over(round(now * 1e9)), "he has turned round: he may come back"
    now = walk(giving_way, now, (3.0, 0.0), (refuge.x, 0.0))
    assert not giving_way.is_over(round(now * 1e9)), "he is before the door"
    now = walk(giving_way, now, (refuge.x, 0.0), (refuge.x - 2.0, 0.0))
    assert giving_way.is_over(round(now * 1e9))


def test_his_line_is_the_one_that_he_walked_not_the_one_to_the_robot() -> None:
    """At the robot's nose, half a metre aside, the line to its middle would lead through a wall."""
    giving_way = GivingWay(CONFIG, ROBOT)
    now = walk(giving_way, 0.0, (5.0, -0.5), (0.9, -0.5))
    aside(giving_way, now)
    assert giving_way.walk is not None
    assert giving_way.walk.along == pytest.approx((-1.0, 0.0), abs=0.02)
    stranger = met((0.9, -0.5), seconds=1.0)
    aside(stranger, 1.0)
    assert stranger.walk is not None
    assert stranger.walk.along[1] > 0.3, "who never walked is thought to come straight on"


def test_who_has_gone_is_waited_for_twice_as_long_each_time() -> None:
    giving_way, now, waited = GivingWay(CONFIG, ROBOT), 0.0, []
    for _ in range(3):
        now = walk(giving_way, now, (3.0, 0.0), (0.9, 0.0))
        aside(giving_way, now)
        begun = now
        while not giving_way.is_over(round(now * 1e9)):
            now += 0.5
            giving_way.meet(round(now * 1e9), np.zeros((0, 2)), SE2())
        waited.append(now - begun)
    assert waited == pytest.approx([CONFIG.gone, 2.0 * CONFIG.gone, 4.0 * CONFIG.gone], abs=0.6)


def test_it_never_waits_longer_than_the_longest() -> None:
    giving_way = GivingWay(CONFIG, ROBOT)
    now = walk(giving_way, 0.0, (3.0, 0.0), (0.9, 0.0))
    refuge = aside(giving_way, now)
    most = CONFIG.longest + math.hypot(refuge.x, refuge.y) / 0.25
    met((1.2, 0.0), begin=now, seconds=most - 1.0, giving=giving_way)
    assert not giving_way.is_over(round((now + most - 1.0) * 1e9))
    assert giving_way.is_over(round((now + most + 1.0) * 1e9))


def test_among_many_people_it_stands_aside_for_a_share_of_the_time_only() -> None:
    """Somebody always comes, and holds it up again as soon as it goes on."""
    giving_way, now, is_aside, seconds = GivingWay(CONFIG, ROBOT), 0.0, False, 0.0
    for t in np.arange(0.0, 1000.0, 0.5):
        now = float(t)
        giving_way.meet(round(now * 1e9), np.array([[1.0, 0.0]]), SE2())
        if is_aside:
            seconds += 0.5
            is_aside = not giving_way.is_over(round(now * 1e9))
        elif giving_way.is_held_up(round(now * 1e9), SE2(), None):
            aside(giving_way, now)
            is_aside = True
    assert 0.15 * 1000.0 < seconds < CONFIG.share * 1000.0 + CONFIG.most


def test_nobody_is_given_way_to_before_anybody_was_seen() -> None:
    giving_way = GivingWay(CONFIG, ROBOT)
    assert giving_way.seek(0, SE2(), None, corridor_grid()) is None
    assert giving_way.is_over(0)


@pytest.mark.parametrize("wrong", [{"tries": -1}, {"held": ((0.0, 1.0),)}, {"gone": -1.0}])
def test_numbers_that_make_no_sense_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInputError, match="giving way"):
        GivingWayConfig(**wrong)
    with pytest.raises(BadInputError, match="refuge"):
        RefugeConfig(reach=0.0)


class Crowded(Script):
    """A driver with somebody in the way; plans to the refuge are told apart."""

    refuge = SE2(-3.0, 1.5, 1.5)

    def __init__(self) -> None:
        super().__init__()
        self.somebody = True
        self.aside_plans: list[Callable[[PlanReply | Exception], None]] = []

    def plan(self, map_from_goal: SE2, done: Callable[[PlanReply | Exception], None]) -> None:
        (self.aside_plans if map_from_goal == self.refuge else self.plans).append(done)


def begun(tries: int = 6) -> tuple[Crowded, Navigation]:
    script = Crowded()
    drive = Navigation(NavigationConfig(giving_way=GivingWayConfig(tries=tries)), script, GOAL)
    drive.start()
    script.plans[-1](plan_to(5.0))
    return script, drive


def test_a_drive_stands_aside_waits_and_goes_on() -> None:
    script, drive = begun()
    script.follows[-1][1]("NO_VALID_CONTROL", "blocked")
    assert drive.state is NavigationState.GIVING_WAY
    assert script.moving is None
    assert not script.blocked, "no way is marked for it"
    script.seeking[-1](script.refuge)
    script.aside_plans[-1](plan_to(-3.0))
    assert script.follows[-1][0].map_from_goal == script.refuge
    script.follows[-1][1]("SUCCEEDED", "")
    for _ in range(5):
        drive.tick()
    assert drive.state is NavigationState.GIVING_WAY
    assert len(script.aside_plans) == 1
    script.is_past = True
    drive.tick()
    assert drive.state is NavigationState.PLANNING
    script.plans[-1](plan_to(5.0))
    script.somebody = False
    script.follows[-1][1]("SUCCEEDED", "")
    assert script.ends[-1][0] == "SUCCEEDED"
    assert drive.recoveries == 0


def test_who_only_stands_in_the_way_of_a_moving_robot_is_noticed_too() -> None:
    script, drive = begun()
    drive.tick()
    assert drive.state is NavigationState.GIVING_WAY
    assert script.moving is None, "the robot stops before it looks for a place"
    script.is_past = True
    script.seeking[-1](script.refuge)
    script.aside_plans[-1](plan_to(-3.0))
    drive.tick()
    assert drive.state is NavigationState.PLANNING, "he has passed while the robot was still on its way"
    assert script.moving is None


def test_what_holds_it_on_its_way_aside_is_tried_again() -> None:
    script, drive = begun()
    drive.tick()
    script.seeking[-1](script.refuge)
    script.aside_plans[-1](plan_to(-3.0))
    script.follows[-1][1]("NO_VALID_CONTROL", "the gate holds it, because he leans on it")
    drive.tick()
    assert len(script.aside_plans) == 2
    script.aside_plans[-1](NoValidPathError("he stands in the door"))
    assert drive.state is NavigationState.PLANNING
    script.plans[-1](plan_to(5.0))
    assert drive.state is NavigationState.FOLLOWING


def test_a_way_to_somewhere_else_is_not_standing_aside() -> None:
    script, drive = begun()
    drive.tick()
    script.seeking[-1](script.refuge)
    script.aside_plans[-1](plan_to(-2.0, goal_distance=0.8))
    assert drive.state is NavigationState.PLANNING


def test_where_it_could_not_go_the_last_time_is_forgotten() -> None:
    script, drive = begun()
    drive.tick()
    script.seeking[-1](script.refuge)
    script.aside_plans[-1](plan_to(-3.0))
    script.follows[-1][1]("NO_VALID_CONTROL", "held")
    script.is_past = True
    drive.tick()
    script.plans[-1](plan_to(5.0))
    script.is_past = False
    script.follows[-1][1]("NO_VALID_CONTROL", "blocked")
    drive.tick()
    assert len(script.aside_plans) == 1, "the new place is still looked for"


def test_where_there_is_no_such_place_it_recovers_as_ever() -> None:
    script, drive = begun()
    script.follows[-1][1]("NO_VALID_CONTROL", "blocked")
    script.seeking[-1](None)
    assert drive.state is NavigationState.RECOVERING
    assert len(script.blocked) == 1
    script.clears[-1]()
    script.plans[-1](plan_to(5.0))
    script.follows[-1][1]("NO_VALID_CONTROL", "blocked")
    assert len(script.seeking) == 1, "it is not looked for again from the same place"
    script.recoveries[-1][1]("SUCCEEDED", "")
    script.plans[-1](plan_to(5.0))
    script.follows[-1][2](4.0)
    script.follows[-1][2](3.0)
    drive.tick()
    assert len(script.seeking) == 2, "but from another one"


def test_it_stands_aside_so_often_and_no_oftener() -> None:
    script, drive = begun(tries=2)
    script.is_past = True
    for _ in range(2):
        drive.tick()
        script.seeking[-1](script.refuge)
        script.aside_plans[-1](plan_to(-3.0))
        drive.tick()
        script.plans[-1](plan_to(5.0))
    drive.tick()
    assert drive.state is NavigationState.FOLLOWING
    script.follows[-1][1]("NO_VALID_CONTROL", "blocked")
    assert drive.state is NavigationState.RECOVERING


@pytest.mark.parametrize("when", ["seeking", "planning", "driving", "standing"])
def test_cancelling_while_it_stands_aside_stops_it(when: str) -> None:
    script, drive = begun()
    drive.tick()
    if when != "seeking":
        script.seeking[-1](script.refuge)
    if when in ("driving", "standing"):
        script.aside_plans[-1](plan_to(-3.0))
    if when == "standing":
        script.follows[-1][1]("SUCCEEDED", "")
    drive.cancel()
    assert drive.state is NavigationState.CANCELLED
    assert script.moving is None
    script.seeking[-1](script.refuge)
    drive.tick()
    assert drive.state is NavigationState.CANCELLED
