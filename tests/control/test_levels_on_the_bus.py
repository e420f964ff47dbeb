"""The navigator with a map of several levels, in lockstep with a toy robot: what it asks of the map, and what a click means."""

from __future__ import annotations

import numpy as np

from ambler.control.config import RolloutConfig
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.core.messages import GroundLevels, PoseStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.nodes.controller import ControllerNode
from ambler.nodes.gate import GateNode
from ambler.nodes.navigator import NavigatorNode
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import ARM, CHOOSE_LEVEL, NAVIGATE, GateRequest, LevelRequest, NavigateGoal, Nothing
from ambler.runtime.topics import GOAL, GROUND_LEVELS, TELEOP_REQUEST
from tests.control.test_nodes import OPEN, goal_at
from tests.control.toy_robot import MAP_FROM_ODOM, ROBOT, Person, ToyBase, ToyPlanner

STAIRS = goal_at(2.0, 0.0)


class ToyLevels(Node):
    """A map of two levels that changes to the one chosen within a metre of the stairs; `moves` are levels that it changes to by itself, at a time (s)."""

    name = "levels"
    outputs = (GROUND_LEVELS,)
    serves = (CHOOSE_LEVEL,)

    def __init__(self, base: ToyBase, moves: dict[float, int] | None = None) -> None:
        self._base, self._moves = base, moves or {}
        self.active, self.wanted = 0, 0
        self.chosen: list[int] = []
        self.places: list[tuple[int, SE2]] = []

    def start(self) -> None:
        self.ctx.serve(CHOOSE_LEVEL, self._choose)
        self.ctx.timer(0.1, self._look)
        self._tell(0)

    def _choose(self, request: LevelRequest) -> Nothing:
        self.wanted = request.level
        self.chosen.append(request.level)
        return Nothing()

    def _look(self) -> None:
        pose = MAP_FROM_ODOM @ self._base.pose
        self.places.append((self.active, pose))
        due = [t for t in self._moves if t <= self.ctx.now_ns * 1e-9]
        if due:
            self._tell(self._moves.pop(due[0]))
        elif self.wanted != self.active and pose.distance_to(STAIRS) < 1.0:
            self._tell(self.wanted)

    def _tell(self, level: int) -> None:
        self.active = self.wanted = level
        x, y, yaw = STAIRS.as_array()
        passages = np.array([[0.0, 1.0, x, y, yaw], [1.0, 0.0, x, y, yaw]])
        self.ctx.publish(GROUND_LEVELS, GroundLevels(self.ctx.now_ns, "map", level, 2, passages))


class House:
    """A running stack with a script."""

    def __init__(self, script: list[tuple[float, object]], moves: dict[float, int] | None = None) -> None:
        self.base = ToyBase(OPEN)
        self.levels = ToyLevels(self.base, moves)
        self.person = Person([(0.3, lambda p: p.ask(ARM, GateRequest("person", "test"))), *script])
        local = TrajectoryRollout(RolloutConfig(), ROBOT)
        controller = ControllerNode(ROBOT, local, LocalCostmap(LocalCostmapConfig(), ROBOT))
        gate = GateNode(ROBOT)
        navigator = NavigatorNode(has_levels=True)
        nodes = [self.base, ToyPlanner(self.base), controller, navigator, gate, self.person, self.levels]
        self.executor = LockstepExecutor(Stack(nodes, external=(TELEOP_REQUEST,)), on_failure=gate.stop_now)

    def run(self, seconds: float) -> House:
        self.executor.run(seconds)
        return self


def test_a_goal_on_the_other_level_leads_over_the_stairs() -> None:
    goal = goal_at(0.0, 1.5)
    house = House([(0.5, lambda p: p.send(NAVIGATE, NavigateGoal(goal, yaw_tolerance=3.2, level=1)))]).run(20.0)
    assert [o.code for o in house.person.outcomes] == ["SUCCEEDED"]
    assert house.levels.active == 1
    assert house.levels.chosen[0] == 1
    changed = next(pose for level, pose in house.levels.places if level == 1)
    assert changed.distance_to(STAIRS) < 1.1
    assert (MAP_FROM_ODOM @ house.base.pose).distance_to(goal) < 0.2


def test_a_click_means_the_level_that_the_map_shows() -> None:
    """The map changes by itself while the robot drives to what was clicked on level 0: it comes back to that."""
    click = PoseStamped(0, "map", SE3.from_se2(goal_at(3.0, 1.0)))
    house = House([(0.5, lambda p: p.ctx.publish(GOAL, click))], {1.5: 1}).run(25.0)
    assert house.levels.active == 0
    assert 0 in house.levels.chosen
    assert (MAP_FROM_ODOM @ house.base.pose).distance_to(goal_at(3.0, 1.0)) < 0.2


def test_without_a_level_a_goal_is_where_the_robot_gets_to() -> None:
    goal = NavigateGoal(goal_at(3.0, 1.0), yaw_tolerance=3.2)
    house = House([(0.5, lambda p: p.send(NAVIGATE, goal))], {1.5: 1}).run(15.0)
    assert [o.code for o in house.person.outcomes] == ["SUCCEEDED"]
    assert house.levels.active == 1
    assert house.levels.chosen == []
