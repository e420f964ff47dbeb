"""The global planner: keeps the global costmap of the newest map and answers requests for a path from the robot's pose."""

from __future__ import annotations

from typing import Any

from ambler.core.errors import NoValidPathError
from ambler.core.messages import CostGrid, GlassWalls, LaserScan, OccupancyGrid, Odometry, Path, Range, Transforms
from ambler.core.protocols import GlobalPlanner
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.core.transforms import TransformTree
from ambler.costmap.global_costmap import GlobalCostmap
from ambler.costmap.range_layer import RangeCone
from ambler.nodes.range_view import RangeView, cone_of
from ambler.runtime.node import Node, Service, Task
from ambler.runtime.tasks import CLEAR_GLOBAL_COSTMAP, COMPUTE_PATH, Nothing, PlanReply, PlanRequest
from ambler.runtime.topics import (
    GLASS,
    GLOBAL_COSTMAP,
    MAP,
    ODOMETRY,
    RANGES,
    SCAN,
    STATIC_TRANSFORMS,
    TRANSFORMS,
    Topic,
)

CONES_PERIOD = 0.2


class GlobalPlannerNode(Node):
    """Publishes GLOBAL_COSTMAP when the map has changed, at most once per `period` seconds; serves COMPUTE_PATH (a
    PlanningError or TransformError reaches the caller) and CLEAR_GLOBAL_COSTMAP.

    Given a robot with ultrasonic transducers and planar scanners, it also keeps their range layer; glass is drawn wherever it comes from.
    """

    name: str = "planner"
    inputs: tuple[Topic[Any], ...] = (MAP, TRANSFORMS)
    optional_inputs: tuple[Topic[Any], ...] = (STATIC_TRANSFORMS, GLASS)
    outputs: tuple[Topic[Any], ...] = (GLOBAL_COSTMAP,)
    serves: tuple[Service[Any, Any] | Task[Any, Any, Any], ...] = (COMPUTE_PATH, CLEAR_GLOBAL_COSTMAP)
    latency: float = 0.02

    def __init__(
        self, costmap: GlobalCostmap, planner: GlobalPlanner, period: float = 0.5, robot: RobotModel | None = None
    ) -> None:
        self._costmap = costmap
        self._planner = planner
        self._period = period
        self._tree = TransformTree()
        self._map: OccupancyGrid | None = None
        self._is_waiting = False
        self._published_ns: int | None = None
        self._map_from_odom: SE2 | None = None
        self._cones: list[RangeCone] = []
        self._ranges = RangeView(robot) if robot is not None and robot.rangers and robot.scanners else None
        if self._ranges is not None:
            self.inputs = (MAP, TRANSFORMS, RANGES, SCAN, ODOMETRY)

    def start(self) -> None:
        """Subscribe and serve."""
        self.ctx.subscribe(MAP, self._on_map)
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.subscribe(STATIC_TRANSFORMS, self._on_static_transforms)
        self.ctx.subscribe(GLASS, self._on_glass)
        if self._ranges is not None:
            self.ctx.subscribe(RANGES, self._on_range)
            self.ctx.subscribe(SCAN, self._on_scan)
            self.ctx.subscribe(ODOMETRY, self._on_odometry)
            self.ctx.timer(CONES_PERIOD, self._draw_cones)
        self.ctx.serve(COMPUTE_PATH, self._compute_path)
        self.ctx.serve(CLEAR_GLOBAL_COSTMAP, self._clear)

    def _on_map(self, message: OccupancyGrid) -> None:
        self._map = message
        self._publish_soon()

    def _publish_soon(self) -> None:
        if self._is_waiting or self._map is None:
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
            if (edge.parent, edge.child) == ("map", "odom"):
                self._map_from_odom = edge.parent_from_child.to_se2()

    def _on_static_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            self._tree.set_static(edge.parent, edge.child, edge.parent_from_child)

    def _on_glass(self, message: GlassWalls) -> None:
        self._costmap.set_glass(message.segments)
        self._publish_soon()

    def _on_scan(self, scan: LaserScan) -> None:
        assert self._ranges is not None
        self._ranges.add_scan(scan)

    def _on_odometry(self, odometry: Odometry) -> None:
        assert self._ranges is not None
        self._ranges.add_odometry(odometry)

    def _on_range(self, measured: Range) -> None:
        assert self._ranges is not None
        placed = self._ranges.judge(measured)
        if placed is None or self._map_from_odom is None or not self._costmap.has_map:
            return
        self._cones.append(cone_of(placed.echo, self._map_from_odom @ placed.odom_from_base))

    def _draw_cones(self) -> None:
        cones, self._cones = self._cones, []
        if cones and self._costmap.add_cones(cones, self.ctx.now_ns * 1e-9):
            self._publish_soon()

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
