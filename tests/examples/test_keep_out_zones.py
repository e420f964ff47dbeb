"""The layer of examples/keep_out_zones.py in both costmaps and both nodes, put there by constructors only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from examples.keep_out_zones import KEEP_OUT, KeepOutLayer

from ambler.control.local_planners import local_planner
from ambler.core.errors import NoValidPathError
from ambler.core.grid import GridSpec
from ambler.core.messages import Message, OccupancyGrid, Odometry, Polygon, Transforms, TransformStamped
from ambler.core.robot import DriveKind, RobotModel, SensorMount, VelocityLimits
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig, global_layers
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig, local_layers
from ambler.nodes.controller import ControllerNode
from ambler.nodes.layer_inputs import LayerInput
from ambler.nodes.planner import GlobalPlannerNode
from ambler.planning.grid_planner import GridPlanner
from ambler.runtime.tasks import COMPUTE_PATH, PlanRequest
from ambler.runtime.topics import GLASS, GLOBAL_COSTMAP, LOCAL_COSTMAP, MAP, ODOMETRY, SCAN, TRANSFORMS, Topic
from tests.costmap.scans import empty_scan

FOOTPRINT = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
LASER = SensorMount("laser", "scan", SE3((0.1, 0.0, 0.3)))
ROBOT = RobotModel("test", DriveKind.DIFFERENTIAL, FOOTPRINT, VelocityLimits(), (LASER,))
SPEC = GridSpec(0.05, 120, 80, -1.0, -2.0)
L_SHAPE = np.array([[1.0, -1.0], [2.0, -1.0], [2.0, -0.5], [1.5, -0.5], [1.5, 1.0], [1.0, 1.0]])
WALL = np.array([[2.5, -2.1], [3.0, -2.1], [3.0, 0.6], [2.5, 0.6]], np.float32)


class Context:
    """A node's world by hand."""

    def __init__(self, node: Any) -> None:
        self.now_ns = 0
        self.hear: dict[str, Callable[[Any], Any]] = {}
        self.said: list[tuple[Topic[Any], Message]] = []
        self.timers: list[Callable[[], None]] = []
        self.delayed: list[Callable[[], None]] = []
        node.ctx = self
        node.start()

    def subscribe(self, topic: Topic[Any], callback: Callable[[Any], None]) -> None:
        self.hear[topic.name] = callback

    def serve(self, service: Any, handler: Callable[[Any], Any]) -> None:
        self.hear[service.name] = handler

    def serve_task(self, task: Any, on_goal: Any, on_cancel: Any) -> None:
        self.hear[task.name] = on_goal

    def timer(self, period: float, callback: Callable[[], None]) -> None:
        self.timers.append(callback)

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        self.delayed.append(callback)

    def publish(self, topic: Topic[Any], message: Message) -> None:
        self.said.append((topic, message))

    def newest_of(self, topic: Topic[Any]) -> Any:
        return [message for said, message in self.said if said is topic][-1]

    def locate(self, map_from_odom: SE2) -> None:
        edges = (("map", "odom", map_from_odom), ("odom", "base", SE2()))
        told = tuple(TransformStamped(0, a, b, SE3.from_se2(pose)) for a, b, pose in edges)
        self.hear[TRANSFORMS.name](Transforms(0, told))


def polygon(points: np.ndarray) -> Polygon:
    return Polygon(0, "map", np.column_stack((points, np.zeros(len(points)))).astype(np.float32))


def test_a_zone_of_any_form_is_lethal_and_inflated_in_the_global_costmap() -> None:
    config = GlobalCostmapConfig()
    costmap = GlobalCostmap(config, ROBOT, [*global_layers(config), KeepOutLayer([L_SHAPE])])
    costs = costmap.set_map(SPEC, np.zeros(SPEC.shape, np.int8))
    for x, y, is_in in ((1.2, 0.8, True), (1.9, -0.8, True), (1.8, 0.5, False), (0.5, 0.0, False)):
        assert (costs[SPEC.cell_of(x, y)] == 254) == is_in, (x, y)
    assert costs[SPEC.cell_of(0.9, 0.0)] == 253, "inflated as any obstacle"
    assert (costs == 254).sum() == pytest.approx(1.25 / 0.05**2, abs=45)
    assert costmap.clear() is costs, "no sensor saw it, so nothing is forgotten"


def test_paths_lead_around_a_zone_that_is_told_and_through_when_it_is_taken_back() -> None:
    zones, config = KeepOutLayer(), GlobalCostmapConfig()
    costmap = GlobalCostmap(config, ROBOT, [*global_layers(config), zones])
    node = GlobalPlannerNode(costmap, GridPlanner(), layer_inputs=[LayerInput(KEEP_OUT, zones.take)])
    assert KEEP_OUT in node.optional_inputs
    context = Context(node)
    context.locate(SE2())
    context.hear[MAP.name](OccupancyGrid(0, "map", SPEC, np.zeros(SPEC.shape, np.int8)))
    ask = PlanRequest(SE2(4.0, 0.0, 0.0))
    assert np.abs(context.hear[COMPUTE_PATH.name](ask).path.poses[:, 1]).max() < 0.1, "straight ahead"
    context.hear["keep_out"](polygon(WALL))
    assert len(context.delayed) == 1, "a costmap is told at most twice a second"
    context.delayed.pop()()
    assert context.newest_of(GLOBAL_COSTMAP).data[SPEC.cell_of(2.75, 0.0)] == 254
    path = context.hear[COMPUTE_PATH.name](ask).path.poses
    beside = path[(path[:, 0] > 2.5) & (path[:, 0] < 3.0)]
    assert len(beside) > 3
    assert beside[:, 1].min() > 0.6 + ROBOT.inscribed_radius - 0.05, "around the zone, with the robot's own width"
    context.hear["keep_out"](polygon(WALL[:0]))
    context.delayed.pop()()
    assert np.abs(context.hear[COMPUTE_PATH.name](ask).path.poses[:, 1]).max() < 0.1


def test_news_that_change_nothing_are_not_told() -> None:
    zones, config = KeepOutLayer(), GlobalCostmapConfig()
    costmap = GlobalCostmap(config, ROBOT, [zones])
    node = GlobalPlannerNode(costmap, GridPlanner(), layer_inputs=[LayerInput(KEEP_OUT, zones.take)])
    context = Context(node)
    with pytest.raises(NoValidPathError):
        context.hear[COMPUTE_PATH.name](PlanRequest(SE2()))
    context.hear[MAP.name](OccupancyGrid(0, "map", SPEC, np.zeros(SPEC.shape, np.int8)))
    told = len(context.said)
    for _ in range(3):
        context.now_ns += 1_000_000_000
        context.hear["keep_out"](polygon(WALL[:2]))
    assert len(context.said) == told
    context.now_ns += 1_000_000_000
    context.hear["keep_out"](polygon(WALL))
    assert len(context.said) == told + 1


def test_the_local_costmap_holds_the_zone_where_the_map_lies_now() -> None:
    zones, config = KeepOutLayer(), LocalCostmapConfig()
    costmap = LocalCostmap(config, ROBOT, [*local_layers(config), zones])
    wanted = LayerInput(KEEP_OUT, zones.take, is_required=True)
    node = ControllerNode(ROBOT, local_planner("rollout", ROBOT), costmap, layer_inputs=[wanted])
    assert KEEP_OUT in node.inputs
    assert GLASS in node.optional_inputs
    context = Context(node)
    zero = np.zeros((6, 6))
    pose = SE3()
    context.hear[ODOMETRY.name](Odometry(0, "odom", "base", pose, (0.0,) * 3, (0.0,) * 3, zero, zero.copy()))
    context.hear["keep_out"](polygon(np.array([[1.0, -0.5], [1.5, -0.5], [1.5, 0.5], [1.0, 0.5]])))
    context.hear[SCAN.name](empty_scan("laser"))
    assert not (costmap.costs == 254).any(), "nobody has said yet where the map lies"
    for x in (0.0, -0.5):  # the map slips against odometry, and the zone with it
        context.locate(SE2(x, 0.0, 0.0))
        context.hear[SCAN.name](empty_scan("laser"))
        context.timers[-1]()
        shown = context.newest_of(LOCAL_COSTMAP)
        at = np.argwhere(shown.data == 254)
        xy = shown.spec.centers_of(at)
        np.testing.assert_allclose((xy[:, 0].min(), xy[:, 0].max()), (1.025 - x, 1.475 - x), atol=1e-6)
        np.testing.assert_allclose((xy[:, 1].min(), xy[:, 1].max()), (-0.475, 0.475), atol=1e-6)
