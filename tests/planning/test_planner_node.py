"""The planner node in a hand-made context: rate of the costmap, services, named failures."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ambler.core.errors import AmblerError, GoalOutsideMapError, NoValidPathError, TransformError
from ambler.core.grid import GridSpec
from ambler.core.messages import CostGrid, Number, OccupancyGrid, PointCloud, Transforms, TransformStamped
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.costmap.obstacle_layer import ObstacleLayer, SensorRays
from ambler.nodes.planner import GlobalPlannerNode
from ambler.planning.grid_planner import GridPlanner
from ambler.planning.visibility_planner import VisibilityPlanner
from ambler.runtime.tasks import CLEAR_GLOBAL_COSTMAP, COMPUTE_PATH, Nothing, PlanRequest
from ambler.runtime.topics import ADDED_OBSTACLES, CLOUD_CLEARING, MAP, MAP_CLEARING, TRANSFORMS, VISIBILITY_GRAPH

FOOTPRINT = np.array([[0.3, -0.22], [0.3, 0.22], [-0.3, 0.22], [-0.3, -0.22]])
ROBOT = RobotModel("test", DriveKind.DIFFERENTIAL, FOOTPRINT, VelocityLimits())
SPEC = GridSpec(0.05, 100, 80, -1.0, -1.0)


class FakeContext:
    """Records what is published and runs delayed calls by hand."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.callbacks: dict[str, Callable[[Any], None]] = {}
        self.handlers: dict[str, Callable[[Any], Any]] = {}
        self.published: list[CostGrid] = []
        self.delayed: list[tuple[float, Callable[[], None]]] = []

    def subscribe(self, topic: Any, callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def serve(self, service: Any, handler: Callable[[Any], Any]) -> None:
        self.handlers[service.name] = handler

    def publish(self, topic: Any, message: Any) -> None:
        assert topic.name == "global_costmap"
        self.published.append(message)

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        self.delayed.append((delay, callback))


def started() -> FakeContext:
    node = GlobalPlannerNode(GlobalCostmap(GlobalCostmapConfig(), ROBOT), GridPlanner(), period=0.5)
    context = FakeContext()
    node.ctx = context  # type: ignore[assignment]
    node.start()
    return context


def grid(stamp_ns: int, wall: int | None = None) -> OccupancyGrid:
    cells = np.zeros(SPEC.shape, np.int8)
    if wall is not None:
        cells[:, wall] = 100
    return OccupancyGrid(stamp_ns, "map", SPEC, cells)


def locate(context: FakeContext, pose: SE2) -> None:
    edges = (
        TransformStamped(0, "map", "odom", SE3.from_se2(SE2(0.5, 0.0, 0.0))),
        TransformStamped(0, "odom", "base", SE3.from_se2(SE2(-0.5, 0.0, 0.0) @ pose)),
    )
    context.callbacks[TRANSFORMS.name](Transforms(0, edges))


def test_paths_start_at_the_robot_and_carry_the_maps_stamp() -> None:
    context = started()
    context.callbacks[MAP.name](grid(7))
    locate(context, SE2(0.2, 0.1, 0.0))
    reply = context.handlers[COMPUTE_PATH.name](PlanRequest(SE2(3.0, 1.0, 0.5)))
    np.testing.assert_allclose(reply.path.poses[0, :2], [0.2, 0.1], atol=1e-9)
    np.testing.assert_allclose(reply.path.poses[-1], [3.0, 1.0, 0.5], atol=1e-9)
    assert (reply.path.stamp_ns, reply.path.frame, reply.goal_distance) == (7, "map", 0.0)


def test_failures_have_names() -> None:
    context = started()

    def ask(goal: SE2) -> str:
        with pytest.raises(AmblerError) as caught:
            context.handlers[COMPUTE_PATH.name](PlanRequest(goal))
        return caught.value.code

    assert ask(SE2()) == NoValidPathError.code
    context.callbacks[MAP.name](grid(0, wall=50))
    assert ask(SE2()) == TransformError.code
    locate(context, SE2(0.2, 0.1, 0.0))
    assert ask(SE2(3.0, 1.0)) == NoValidPathError.code
    assert ask(SE2(99.0, 1.0)) == GoalOutsideMapError.code


def test_the_costmap_follows_the_map_at_most_twice_a_second() -> None:
    context = started()
    for k in range(10):
        context.now_ns = k * 100_000_000
        context.callbacks[MAP.name](grid(context.now_ns, wall=20 + k))
        due = [call for delay, call in context.delayed if k == 5 and delay == pytest.approx(0.4)]
        for call in due:
            call()
    stamps = [m.stamp_ns for m in context.published]
    assert stamps == [0, 500_000_000]
    assert context.published[0].data[10, 20] == 254
    assert context.published[1].data[10, 25] == 254
    assert context.published[1].data[10, 20] == int(252 * np.exp(-3.0 * (0.25 - 0.22)))
    assert len(context.delayed) == 2
    context.handlers[CLEAR_GLOBAL_COSTMAP.name](Nothing())
    assert context.published[-1].stamp_ns == 900_000_000


def test_a_planner_with_a_graph_shows_it_now_and_then() -> None:
    node = GlobalPlannerNode(GlobalCostmap(GlobalCostmapConfig(), ROBOT), VisibilityPlanner(), period=0.5)
    assert VISIBILITY_GRAPH in node.outputs
    assert VISIBILITY_GRAPH not in GlobalPlannerNode(GlobalCostmap(GlobalCostmapConfig(), ROBOT), GridPlanner()).outputs
    context = FakeContext()
    shown: list[Any] = []
    context.publish = lambda topic, message: shown.append(message) if topic is VISIBILITY_GRAPH else None  # type: ignore[method-assign]
    node.ctx = context  # type: ignore[assignment]
    node.start()
    cells = np.zeros(SPEC.shape, np.int8)
    cells[:40, 50] = 100
    context.callbacks[MAP.name](OccupancyGrid(1, "map", SPEC, cells))
    locate(context, SE2(0.2, 0.1, 0.0))
    for second in (0, 1, 2, 3):
        context.now_ns = second * 10**9
        context.handlers[COMPUTE_PATH.name](PlanRequest(SE2(3.0, 0.1)))
    assert len(shown) == 2
    assert len(shown[0].contours) >= 1
    assert len(shown[0].nodes) > 0


def test_clearing_forgets_what_sensors_saw_around_the_robot_and_nothing_told() -> None:
    costmap = GlobalCostmap(GlobalCostmapConfig(), ROBOT)
    node, context = GlobalPlannerNode(costmap, GridPlanner(), period=0.5), FakeContext()
    node.ctx = context  # type: ignore[assignment]
    node.start()
    locate(context, SE2(0.5, 0.5, 0.0))
    context.callbacks[MAP.name](grid(0))
    costmap.layer(ObstacleLayer).add([SensorRays((0.5, 0.5), np.array([[1.2, 0.5], [2.7, 0.5]]))])
    costs = costmap.update()
    near, far, told = SPEC.cell_of(1.2, 0.5), SPEC.cell_of(2.7, 0.5), SPEC.cell_of(0.5, 1.2)
    points = np.array([[0.5, 1.2, 0.0]], np.float32)
    zeros = np.zeros(1, np.float32)
    context.callbacks[ADDED_OBSTACLES.name](PointCloud(0, "map", points, zeros, zeros, np.zeros(1, np.uint16)))
    context.callbacks[ADDED_OBSTACLES.name](PointCloud(0, "odom", points + 1.0, zeros, zeros, np.zeros(1, np.uint16)))
    assert (costs[near], costs[far]) == (254, 254)
    for radius in (0.0, -1.0, float("nan")):
        context.callbacks[MAP_CLEARING.name](Number(0, radius))
    assert costmap.update()[near] == 254
    context.callbacks[CLOUD_CLEARING.name](Number(0, 1.0))
    costs = costmap.update()
    assert costs[near] < 253
    assert (costs[far], costs[told]) == (254, 254)
