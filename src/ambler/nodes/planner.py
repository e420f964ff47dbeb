"""The global planner: keeps the global costmap of the newest map and answers requests for a path from the robot's pose."""

from __future__ import annotations

from typing import Any, ClassVar

from ambler.core.errors import NoValidPathError
from ambler.core.messages import CostGrid, OccupancyGrid, Path, Transforms
from ambler.core.protocols import GlobalPlanner
from ambler.core.transforms import TransformTree
from ambler.costmap.global_costmap import GlobalCostmap
from ambler.runtime.node import Node, Service, Task
from ambler.runtime.tasks import CLEAR_GLOBAL_COSTMAP, COMPUTE_PATH, Nothing, PlanReply, PlanRequest
from ambler.runtime.topics import GLOBAL_COSTMAP, MAP, STATIC_TRANSFORMS, TRANSFORMS, Topic


class GlobalPlannerNode(Node):
    """Publishes GLOBAL_COSTMAP when the map has changed, at most once per `period` seconds; serves COMPUTE_PATH (a
    PlanningError or TransformError reaches the caller) and CLEAR_GLOBAL_COSTMAP."""

    name: ClassVar[str] = "planner"
    inputs: ClassVar[tuple[Topic[Any], ...]] = (MAP, TRANSFORMS)
    optional_inputs: ClassVar[tuple[Topic[Any], ...]] = (STATIC_TRANSFORMS,)
    outputs: ClassVar[tuple[Topic[Any], ...]] = (GLOBAL_COSTMAP,)
    serves: ClassVar[tuple[Service[Any, Any] | Task[Any, Any, Any], ...]] = (COMPUTE_PATH, CLEAR_GLOBAL_COSTMAP)
    latency: ClassVar[float] = 0.02

    def __init__(self, costmap: GlobalCostmap, planner: GlobalPlanner, period: float = 0.5) -> None:
        self._costmap = costmap
        self._planner = planner
        self._period = period
        self._tree = TransformTree()
        self._map: OccupancyGrid | None = None
        self._is_waiting = False
        self._published_ns: int | None = None

    def start(self) -> None:
        """Subscribe and serve."""
        self.ctx.subscribe(MAP, self._on_map)
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.subscribe(STATIC_TRANSFORMS, self._on_static_transforms)
        self.ctx.serve(COMPUTE_PATH, self._compute_path)
        self.ctx.serve(CLEAR_GLOBAL_COSTMAP, self._clear)

    def _on_map(self, message: OccupancyGrid) -> None:
        self._map = message
        if self._is_waiting:
            return
        wait = 0.0
        if self._published_ns is not None:
            wait = self._period - (self.ctx.now_ns - self._published_ns) * 1e-9
        if wait <= 0.0:
            self._publish()
        else:
            self._is_waiting = True
            self.ctx.after(wait, self._publish)

    def _publish(self) -> None:
        self._is_waiting = False
        if self._map is None:
            return
        self._published_ns = self.ctx.now_ns
        costs = self._costmap.set_map(self._map.spec, self._map.data)
        message = CostGrid(self._map.stamp_ns, self._map.frame, self._map.spec, costs)
        self.ctx.publish(GLOBAL_COSTMAP, message)

    def _on_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            self._tree.set(edge.parent, edge.child, edge.stamp_ns, edge.parent_from_child)

    def _on_static_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            self._tree.set_static(edge.parent, edge.child, edge.parent_from_child)

    def _compute_path(self, request: PlanRequest) -> PlanReply:
        if self._map is None or not self._costmap.has_map:
            raise NoValidPathError("there is no map yet")
        map_from_base = self._tree.lookup("map", "base").to_se2()
        result = self._planner.plan(self._costmap.costs, self._costmap.spec, map_from_base, request.map_from_goal)
        path = Path(self._map.stamp_ns, self._map.frame, result.path)
        return PlanReply(path, result.cost, result.goal_distance)

    def _clear(self, request: Nothing) -> Nothing:
        self._costmap.clear()
        self._publish()
        return Nothing()
