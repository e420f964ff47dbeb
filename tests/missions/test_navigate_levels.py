"""Goals on other levels of a place, with either planner: through passages, in their shortest chain, around those that are shut, and with a named end."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from ambler.core.errors import PlanningError
from ambler.core.grid import GridSpec
from ambler.core.messages import CostGrid, GroundLevels, Path
from ambler.core.protocols import GlobalPlanner, GraphPlanner
from ambler.core.se2 import SE2
from ambler.missions.level_route import LevelRoute
from ambler.missions.navigate import Navigation, NavigationConfig, NavigationState
from ambler.missions.recovery import RecoveryAction, RecoveryStep
from ambler.planning.grid_planner import GridPlanner
from ambler.planning.visibility_planner import VisibilityPlanner
from ambler.runtime.tasks import NAVIGATE, NavigateGoal, PlanReply

SPEC = GridSpec(0.1, 200, 120, 0.0, 0.0)  # 20 m by 12 m
NEAR = 1.0  # metres from a passage within which the map shows the other level
STAIR_A, STAIR_B = (18.0, 2.0), (10.0, 10.0)


class House:
    """A robot in a house of levels, each a grid of costs uint8 [iy, ix]; its map changes to the level that was chosen where a passage to it is near.
    A drive is followed to its end at once, unless the map changes on the way."""

    def __init__(
        self,
        planner: GlobalPlanner,
        floors: list[np.ndarray],
        passages: list[tuple[int, int, tuple[float, float]]],
        goal: NavigateGoal,
        at: tuple[float, float] = (2.0, 2.0),
    ) -> None:
        both = [(a, b, *place, 0.0) for a, b, place in passages] + [(b, a, *place, 0.0) for a, b, place in passages]
        self.passages = np.array(both, np.float64).reshape(-1, 5)
        self.planner, self.floors, self.level, self.pose = planner, floors, 0, SE2(*at)
        self.chosen: list[int] = []
        self.wanted: int | None = None
        self.is_blind = False  # whether its map never changes
        self.surprise: dict[int, int] = {}  # where the map changes by itself: after that many steps, to that level
        self.steps = self.turns = 0
        self.drive = Navigation(NavigationConfig(), self, goal)
        self.queue: list[Callable[[], None]] = []
        self.ends: list[tuple[str, str]] = []
        self.along: list[tuple[int, float, float]] = []
        self.is_moving = False

    def live(self, actions: int = 2000) -> str:
        """Let it drive to its end, or for so many actions; returns how it ended, empty when it has not."""
        self.drive.start()
        for _ in range(actions):
            if self.drive.is_over:
                break
            if self.queue:
                self.queue.pop(0)()
            else:
                self.drive.tick()
        return self.ends[-1][0] if self.ends else ""

    def plan(self, map_from_goal: SE2, done: Callable[[PlanReply | Exception], None]) -> None:
        if isinstance(self.planner, GraphPlanner):
            self.planner.enter_level(self.level)
        try:
            result = self.planner.plan(self.floors[self.level], SPEC, self.pose, map_from_goal)
            reply: PlanReply | Exception = PlanReply(Path(0, "map", result.path), result.cost, result.goal_distance)
        except PlanningError as error:
            reply = error
        self.queue.append(lambda: done(reply))

    def follow(
        self, path: Path, goal: NavigateGoal, done: Callable[[str, str], None], left: Callable[[float], None]
    ) -> Callable[[], None]:
        self.is_moving = True
        self.queue.append(lambda: self._walk(path, done, left))
        return self._stop

    def _stop(self) -> None:
        self.is_moving = False

    def _walk(self, path: Path, done: Callable[[str, str], None], left: Callable[[float], None]) -> None:
        steps = np.hypot(*np.diff(path.poses[:, :2], axis=0).T)
        to_end = np.concatenate((np.cumsum(steps[::-1])[::-1], [0.0])).tolist()
        for (x, y, yaw), metres in zip(path.poses.tolist(), to_end, strict=True):
            left(metres)
            self.pose, self.steps = SE2(x, y, yaw), self.steps + 1
            self.along.append((self.level, x, y))
            self._see()
            if not self.is_moving:
                return
        self.is_moving = False
        done("SUCCEEDED", "")

    def _see(self) -> None:
        """Change the level where the map would."""
        to = self.surprise.get(self.steps)
        ways = self.passages[(self.passages[:, 0] == self.level) & (self.passages[:, 1] == self.wanted)]
        is_near = np.hypot(ways[:, 2] - self.pose.x, ways[:, 3] - self.pose.y) <= NEAR
        if to is None and is_near.any() and not self.is_blind:
            to = self.wanted
        if to is not None:
            self.level, self.wanted = to, None
            self.drive.change_level()

    def replace_path(self, path: Path) -> None:
        pass

    def recover(self, step: RecoveryStep, done: Callable[[str, str], None]) -> Callable[[], None]:
        self.turns += step.action is RecoveryAction.ROTATE
        self.queue.append(lambda: done("SUCCEEDED", ""))
        return lambda: None

    def clear_costmaps(self, done: Callable[[], None]) -> None:
        self.queue.append(done)

    def costmap(self) -> CostGrid | None:
        return None

    def map_from_base(self) -> SE2 | None:
        return self.pose

    def levels(self) -> GroundLevels | None:
        return GroundLevels(0, "map", self.level, len(self.floors), self.passages)

    def choose_level(self, level: int) -> None:
        self.wanted = level
        self.chosen.append(level)

    def mark_blocked(self, path: Path, *, is_held: bool) -> bool:
        return False

    def is_held_up(self, path: Path | None) -> bool:
        return False

    def report(self, state: str, text: str) -> None:
        assert text

    def finish(self, code: str, text: str) -> None:
        assert code == "SUCCEEDED" or code in NAVIGATE.failures
        self.ends.append((code, text))


def floor(*walls: tuple[slice, slice]) -> np.ndarray:
    """Return the costs of a level: free, with walls around and those told of."""
    costs = np.zeros(SPEC.shape, np.uint8)
    costs[:3], costs[-3:], costs[:, :3], costs[:, -3:] = 254, 254, 254, 254
    for wall in walls:
        costs[wall] = 254
    return costs


ACROSS = (slice(0, 90), slice(118, 123))  # a wall at x = 12, with a way round its end at y > 9
SHUT = (slice(None), slice(148, 153))  # a wall at x = 15, without


@pytest.fixture(params=[GridPlanner, VisibilityPlanner], ids=["grid", "visibility_graph"])
def planner(request: pytest.FixtureRequest) -> GlobalPlanner:
    made: GlobalPlanner = request.param()
    return made


def test_a_goal_on_another_level_is_reached_through_the_passage_and_not_below_it(planner: GlobalPlanner) -> None:
    goal = NavigateGoal(SE2(2.0, 3.0), level=1)
    house = House(planner, [floor(ACROSS), floor()], [(0, 1, STAIR_A)], goal)
    assert house.live() == "SUCCEEDED"
    assert house.level == 1
    assert house.pose.distance_to(goal.map_from_goal) < 0.01
    on_level = [level for level, _, _ in house.along]
    assert on_level == sorted(on_level), "up, and not down again"
    x, y = next((x, y) for level, x, y in reversed(house.along) if level == 0)
    assert math.dist((x, y), STAIR_A) <= NEAR + 0.1


def test_levels_are_changed_one_after_the_other(planner: GlobalPlanner) -> None:
    goal = NavigateGoal(SE2(4.0, 10.0), level=2)
    house = House(planner, [floor(), floor(ACROSS), floor()], [(0, 1, STAIR_A), (1, 2, (4.0, 2.0))], goal)
    assert house.live() == "SUCCEEDED"
    assert list(dict.fromkeys(level for level, _, _ in house.along)) == [0, 1, 2]
    assert list(dict.fromkeys(house.chosen)) == [1, 2]


def test_a_passage_that_cannot_be_reached_is_left_for_another(planner: GlobalPlanner) -> None:
    goal = NavigateGoal(SE2(18.0, 3.0), level=1)
    house = House(planner, [floor(SHUT), floor()], [(0, 1, STAIR_A), (0, 1, STAIR_B)], goal)
    assert house.live() == "SUCCEEDED", "the nearer one lies behind a wall"
    assert house.level == 1


def test_no_passage_left_is_told_with_its_reason(planner: GlobalPlanner) -> None:
    house = House(planner, [floor(SHUT), floor()], [(0, 1, STAIR_A)], NavigateGoal(SE2(2.0, 2.0), level=1))
    assert house.live() == "LEVEL_NOT_REACHED"
    assert "no passage is left from level 0 to level 1" in house.ends[0][1]
    assert "no path leads" in house.ends[0][1]
    assert house.chosen == [], "it came to none"


def test_a_map_that_stays_on_its_level_at_the_passage_ends_the_drive_after_some_turns(planner: GlobalPlanner) -> None:
    house = House(planner, [floor(), floor()], [(0, 1, STAIR_A)], NavigateGoal(SE2(2.0, 2.0), level=1))
    house.is_blind = True
    assert house.live() == "LEVEL_NOT_REACHED"
    assert house.turns == NavigationConfig().level_tries
    assert "stayed on level 0" in house.ends[0][1]
    assert house.chosen[-1] == 0, "nobody is on the way to another level any more"


def test_a_map_that_changes_by_itself_on_the_way_is_driven_back_from(planner: GlobalPlanner) -> None:
    goal = NavigateGoal(SE2(17.0, 10.0), level=0)
    house = House(planner, [floor(), floor()], [(0, 1, STAIR_B)], goal)
    house.surprise = {60: 1}
    assert house.live() == "SUCCEEDED"
    assert house.level == 0
    assert list(dict.fromkeys(level for level, _, _ in house.along)) == [0, 1]


def test_a_map_that_always_changes_back_ends_the_drive(planner: GlobalPlanner) -> None:
    """It is on level 1 only for half a metre: the robot does not come and go for ever."""
    house = House(planner, [floor(), floor()], [(0, 1, STAIR_A)], NavigateGoal(SE2(2.0, 2.0), level=1))
    house.surprise = dict.fromkeys(range(100, 100_000, 25), 0)
    assert house.live(20_000) == "LEVEL_NOT_REACHED"


@pytest.mark.parametrize("level", [2, 7])
def test_a_level_that_the_map_does_not_have_is_refused_at_once(planner: GlobalPlanner, level: int) -> None:
    house = House(planner, [floor(), floor()], [(0, 1, STAIR_A)], NavigateGoal(SE2(2.0, 2.0), level=level))
    assert house.live() == "NO_SUCH_LEVEL"
    assert not house.along


@pytest.mark.parametrize("level", [0, None])
def test_a_planar_map_is_level_0(planner: GlobalPlanner, level: int | None) -> None:
    house = House(planner, [floor()], [], NavigateGoal(SE2(5.0, 5.0), level=level))
    house.levels = lambda: None  # type: ignore[method-assign]
    assert house.live() == "SUCCEEDED"
    assert not house.chosen


def test_a_goal_that_does_not_say_its_level_is_driven_to_on_whichever_the_robot_is(planner: GlobalPlanner) -> None:
    house = House(planner, [floor(), floor()], [(0, 1, STAIR_A)], NavigateGoal(SE2(5.0, 5.0)))
    house.surprise = {20: 1}
    assert house.live() == "SUCCEEDED"
    assert house.level == 1
    assert not house.chosen


def test_a_drive_that_is_cancelled_on_its_way_to_a_passage_asks_for_no_other_level_any_more() -> None:
    house = House(GridPlanner(), [floor(), floor()], [(0, 1, STAIR_A)], NavigateGoal(SE2(2.0, 2.0), level=1))
    house.is_blind = True
    house.live(2)
    house.drive.cancel()
    assert house.drive.state is NavigationState.CANCELLED
    assert house.chosen == [1, 0]


def test_the_next_level_is_asked_for_at_the_passage_and_not_before() -> None:
    """The map would change wherever a little of what it sees fits: at the edge of the level, where nothing can be planned."""
    house = House(GridPlanner(), [floor(), floor()], [(0, 1, STAIR_A)], NavigateGoal(SE2(2.0, 2.0), level=1))
    asked: list[SE2] = []
    choose = house.choose_level

    def listen(level: int) -> None:
        asked.append(house.pose)
        choose(level)

    house.choose_level = listen  # type: ignore[method-assign]
    house.is_blind = True
    house.live()
    assert 0.4 < asked[0].distance_to(SE2(*STAIR_A)) < 0.6


def levels(*passages: tuple[int, int, float, float], active: int = 0) -> GroundLevels:
    rows = [(a, b, x, y, 0.0) for a, b, x, y in passages]
    return GroundLevels(0, "map", active, 5, np.array(rows, np.float64).reshape(-1, 5))


def test_the_shortest_chain_of_passages_is_taken_not_the_one_with_the_fewest() -> None:
    site = levels((0, 3, 90.0, 0.0), (0, 1, 5.0, 0.0), (1, 2, 5.0, 5.0), (2, 3, 0.0, 5.0))
    hop = LevelRoute(3).next_hop(site, SE2(), 3, SE2())
    assert hop is not None
    assert (hop.to_level, hop.map_from_place.x) == (1, 5.0)
    near = LevelRoute(3).next_hop(site, SE2(80.0, 0.0), 3, SE2(85.0, 0.0))
    assert near is not None
    assert near.to_level == 3


def test_what_is_left_out_or_was_tried_often_is_not_taken_again_and_a_way_need_not_exist() -> None:
    site, route = levels((0, 1, 5.0, 0.0), (0, 1, 9.0, 0.0)), LevelRoute(2)
    first = route.next_hop(site, SE2(), 1, SE2())
    assert first is not None
    route.try_hop(first)
    assert route.next_hop(site, SE2(), 1, SE2()) == first
    route.try_hop(first)
    second = route.next_hop(site, SE2(), 1, SE2())
    assert second is not None
    assert second.map_from_place.x == 9.0
    route.leave_out(second)
    assert route.next_hop(site, SE2(), 1, SE2()) is None
    assert LevelRoute(2).next_hop(levels((1, 0, 0.0, 0.0)), SE2(), 1, SE2()) is None, "a way down is none up"
