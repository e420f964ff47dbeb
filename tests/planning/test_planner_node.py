"""The planner node in a hand-made context: rate of the costmap, services, named failures."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambler.core.errors import (
    AmblerError,
    GoalOutsideMapError,
    NoValidPathError,
    StaleInputError,
    TransformError,
)
from ambler.core.grid import GridSpec
from ambler.core.messages import CostGrid, GroundLevels, Number, OccupancyGrid, PointCloud, Transforms, TransformStamped
from ambler.core.protocols import GlobalPlanner
from ambler.core.robot import DriveKind, RobotModel, VelocityLimits
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.costmap.global_costmap import GlobalCostmap, GlobalCostmapConfig
from ambler.costmap.obstacle_layer import ObstacleLayer, SensorRays
from ambler.nodes.planner import GlobalPlannerNode
from ambler.planning.grid_planner import GridPlanner
from ambler.planning.visibility_planner import VisibilityConfig, VisibilityPlanner
from ambler.runtime.tasks import CLEAR_GLOBAL_COSTMAP, COMPUTE_PATH, SAVE_GRAPH, Nothing, PlanRequest, SaveMapRequest
from ambler.runtime.topics import (
    ADDED_OBSTACLES,
    CLOUD_CLEARING,
    GLOBAL_COSTMAP,
    GROUND_LEVELS,
    MAP,
    MAP_CLEARING,
    STATUS,
    TRANSFORMS,
    VISIBILITY_GRAPH,
)
from ambler.wire.graph_files import load_graph

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
        self.said: list[tuple[str, str]] = []
        self.delayed: list[tuple[float, Callable[[], None]]] = []

    def subscribe(self, topic: Any, callback: Callable[[Any], None]) -> None:
        self.callbacks[topic.name] = callback

    def serve(self, service: Any, handler: Callable[[Any], Any]) -> None:
        self.handlers[service.name] = handler

    def publish(self, topic: Any, message: Any) -> None:
        if topic is STATUS:
            self.said.append((message.code, message.text))
        elif topic is GLOBAL_COSTMAP:
            self.published.append(message)
        else:
            assert topic is VISIBILITY_GRAPH

    def log(self, code: str, text: str) -> None:
        assert text

    def after(self, delay: float, callback: Callable[[], None]) -> None:
        self.delayed.append((delay, callback))


def started(planner: GlobalPlanner | None = None, costmap: GlobalCostmap | None = None) -> FakeContext:
    costmap = costmap or GlobalCostmap(GlobalCostmapConfig(), ROBOT)
    node, context = GlobalPlannerNode(costmap, planner or GridPlanner(), period=0.5), FakeContext()
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


def on_level(context: FakeContext, stamp_ns: int, active: int) -> None:
    context.callbacks[GROUND_LEVELS.name](GroundLevels(stamp_ns, "map", active, 2, np.zeros((0, 5))))


@pytest.mark.parametrize("make", [GridPlanner, VisibilityPlanner])
@pytest.mark.parametrize("is_map_first", [False, True])
def test_on_another_level_costs_are_its_own_at_once_and_the_others_obstacles_are_forgotten(
    make: Callable[[], GlobalPlanner], is_map_first: bool
) -> None:
    costmap = GlobalCostmap(GlobalCostmapConfig(), ROBOT)
    context = started(make(), costmap)
    locate(context, SE2(0.2, 0.1, 0.0))
    on_level(context, 0, 0)
    context.callbacks[MAP.name](grid(0, wall=50))
    costmap.layer(ObstacleLayer).add([SensorRays((0.5, 0.5), np.array([[2.7, 0.5]]))])
    assert costmap.update()[SPEC.cell_of(2.7, 0.5)] == 254
    goal = PlanRequest(SE2(3.0, 0.6))
    with pytest.raises(NoValidPathError):
        context.handlers[COMPUTE_PATH.name](goal)
    if is_map_first:
        context.callbacks[MAP.name](grid(5))
        on_level(context, 5, 1)
    else:
        on_level(context, 5, 1)
        with pytest.raises(StaleInputError, match="level 1"):
            context.handlers[COMPUTE_PATH.name](goal)
        context.callbacks[MAP.name](grid(5))
    way = context.handlers[COMPUTE_PATH.name](goal).path
    assert way.stamp_ns == 5
    assert abs(way.poses[:, 1] - np.interp(way.poses[:, 0], [0.2, 3.0], [0.1, 0.6])).max() < 0.02, "straight"
    assert context.published[-1].data.max() == 0
    assert context.published[-1].stamp_ns == 5


def test_a_graph_is_kept_for_each_level_and_what_is_drawn_is_the_robots() -> None:
    planner = VisibilityPlanner()
    context = started(planner)
    locate(context, SE2(0.2, 0.1, 0.0))
    on_level(context, 0, 0)
    cells = np.zeros(SPEC.shape, np.int8)
    cells[:40, 50] = 100
    context.callbacks[MAP.name](OccupancyGrid(0, "map", SPEC, cells))
    context.handlers[COMPUTE_PATH.name](PlanRequest(SE2(3.0, 0.1)))
    corners = len(planner.view(0, "map").nodes)
    assert corners > 0
    on_level(context, 5, 1)
    context.callbacks[MAP.name](grid(5))
    context.handlers[COMPUTE_PATH.name](PlanRequest(SE2(3.0, 0.1)))
    assert len(planner.view(0, "map").contours) == 0
    assert planner.graph.node_count >= corners, "the other level is not forgotten"


def test_the_status_of_a_plan_is_told_when_it_is_news_of_its_goal() -> None:
    context = started(VisibilityPlanner(VisibilityConfig(is_unknown_allowed=True)))
    locate(context, SE2(0.2, 0.1, 0.0))
    cells = np.zeros(SPEC.shape, np.int8)
    cells[:, 60:] = -1
    context.callbacks[MAP.name](OccupancyGrid(0, "map", SPEC, cells))
    ask = context.handlers[COMPUTE_PATH.name]
    for goal in (SE2(1.0, 0.1), SE2(1.0, 0.1), SE2(3.0, 0.1)):
        ask(PlanRequest(goal))
    assert [code for code, _ in context.said] == ["PLANNING", "FREE_PATH", "PLANNING", "ATTEMPTING"]
    assert "3.00, 0.10 m" in context.said[-1][1]
    walls = np.full(SPEC.shape, 100, np.int8)
    walls[10:70, 10:50], walls[30:50, 70:90] = 0, 0
    context.now_ns = 10**9
    context.callbacks[MAP.name](OccupancyGrid(1, "map", SPEC, walls))
    with pytest.raises(NoValidPathError):
        ask(PlanRequest(SE2(3.0, 1.0)))
    assert [code for code, _ in context.said][-2:] == ["PLANNING", "UNREACHABLE"]
    grid_planner = started()
    grid_planner.callbacks[MAP.name](grid(0))
    locate(grid_planner, SE2(0.2, 0.1, 0.0))
    grid_planner.handlers[COMPUTE_PATH.name](PlanRequest(SE2(1.0, 0.1)))
    assert grid_planner.said == []


def test_a_graph_is_saved_beside_the_map_by_its_service_and_loads_alike(tmp_path: Path) -> None:
    planner = VisibilityPlanner()
    context = started(planner)
    locate(context, SE2(0.2, 0.1, 0.0))
    cells = np.zeros(SPEC.shape, np.int8)
    cells[:40, 50] = 100
    context.callbacks[MAP.name](OccupancyGrid(0, "map", SPEC, cells))
    context.handlers[COMPUTE_PATH.name](PlanRequest(SE2(3.0, 0.1)))
    context.handlers[SAVE_GRAPH.name](SaveMapRequest(str(tmp_path / "map")))
    other = VisibilityPlanner(saved=load_graph(tmp_path / "map.vgraph"))
    for name, array in planner.to_arrays().items():
        np.testing.assert_array_equal(other.to_arrays()[name], array)
    assert SAVE_GRAPH.name not in started().handlers, "a grid planner has none"
