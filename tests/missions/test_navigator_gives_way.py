"""The navigator on the bus: it hears of people and of the gate, and seeks a place to stand aside off its own time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from ambler.core.grid import COST_INSCRIBED, COST_LETHAL, GridSpec
from ambler.core.messages import CostGrid, GateState, GateStatus, Path, PointCloud, Transforms, TransformStamped
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.nodes.navigator import NavigatorNode
from ambler.robots.catalog import robot_model
from ambler.runtime.tasks import NAVIGATE, NavigateGoal
from ambler.runtime.topics import GATE_STATUS, GLOBAL_COSTMAP, MOVERS, TRANSFORMS
from tests.hand_made_context import HandMadeContext

ROBOT = robot_model("amr_omni")
MAP_FROM_ODOM = SE2(4.0, 1.0, 0.5)
AHEAD = Path(0, "map", np.column_stack((np.linspace(4.0, 9.0, 50), np.full(50, 1.0), np.zeros(50))))


def room() -> CostGrid:
    spec = GridSpec(0.05, 240, 240, -2.0, -5.0)
    walls = np.ones(spec.shape, np.bool_)
    walls[2:-2, 2:-2] = False
    near = distance_transform_edt(~walls) * 0.05 < ROBOT.inscribed_radius
    return CostGrid(0, "map", spec, np.where(walls, COST_LETHAL, np.where(near, COST_INSCRIBED, 0)).astype(np.uint8))


class Deaf(HandMadeContext):
    """Nobody answers what a drive asks for."""

    def call(self, service: Any, request: Any, done: Any) -> None:
        pass


def held_up(
    state: GateState | None, *, robot: bool = True, drives: bool = True
) -> tuple[HandMadeContext, NavigatorNode]:
    """A robot at the origin of odom, yawed along the map's x, that wants to drive, and before whom somebody stands a metre ahead for 14 s."""
    context, node = Deaf(), NavigatorNode(None, ROBOT if robot else None)
    context.start(node)
    if drives:
        begin, _ = context.tasks[NAVIGATE.name]
        begin(SimpleNamespace(goal=NavigateGoal(SE2(9.0, 1.0, 0.0)), feedback=lambda feedback: None))
    odom_from_base = SE2(0.0, 0.0, -0.5)
    edges = (("map", "odom", MAP_FROM_ODOM), ("odom", "base", odom_from_base))
    context.callbacks[TRANSFORMS.name](
        Transforms(0, tuple(TransformStamped(0, a, b, SE3.from_se2(t)) for a, b, t in edges))
    )
    context.callbacks[GLOBAL_COSTMAP.name](room())
    place = odom_from_base.transform(np.array([[1.0, 0.0]]))[0]
    point = np.array([[place[0], place[1], 0.0]], np.float32)
    for _ in range(140):
        context.run(0.1)
        zero = np.zeros(1, np.float32)
        context.callbacks[MOVERS.name](PointCloud(context.now_ns, "odom", point, zero, zero, zero.astype(np.uint16)))
        if state is not None:
            context.callbacks[GATE_STATUS.name](GateStatus(context.now_ns, state, "", ""))
    return context, node


@pytest.mark.parametrize(
    ("state", "is_held"),
    [(None, True), (GateState.ARMED, True), (GateState.PROTECTIVE_STOP, True), (GateState.PAUSED, False)],
)
def test_people_in_another_frame_hold_it_up_unless_it_is_paused(state: GateState | None, *, is_held: bool) -> None:
    _, node = held_up(state)
    assert node.is_held_up(AHEAD) == is_held


def test_who_stands_about_while_nothing_is_to_be_done_holds_up_nobody() -> None:
    """An operator clicks a goal behind himself: the robot first tries to get there."""
    _, node = held_up(None, drives=False)
    assert not node.is_held_up(AHEAD)


def test_people_and_paths_that_are_none_are_borne() -> None:
    context, node = held_up(None)
    nowhere = np.full((1, 3), np.nan, np.float32)
    zero = np.zeros(1, np.float32)
    context.callbacks[MOVERS.name](PointCloud(context.now_ns, "odom", nowhere, zero, zero, zero.astype(np.uint16)))
    assert not node.is_held_up(AHEAD)
    assert not node.is_held_up(Path(0, "map", np.zeros((0, 3))))


def test_the_place_is_handed_over_later_and_lies_beside_his_line() -> None:
    context, node = held_up(None)
    found: list[SE2 | None] = []
    node.find_refuge(AHEAD, found.append)
    assert not found
    context.run(0.2)
    (refuge,) = found
    assert refuge is not None
    assert np.abs(refuge.transform(np.asarray(ROBOT.footprint))[:, 1] - 1.0).min() > 0.44
    assert not node.is_let_by()


def test_a_navigator_that_knows_no_robot_stands_aside_for_nobody() -> None:
    context, node = held_up(None, robot=False)
    found: list[SE2 | None] = []
    assert not node.is_held_up(AHEAD)
    assert node.is_let_by()
    node.find_refuge(AHEAD, found.append)
    context.run(0.2)
    assert found == [None]
