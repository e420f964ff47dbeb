"""The global planner: keeps the global costmap of the newest map and answers requests for a path from the robot's pose."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from ambler.core.errors import NoValidPathError
from ambler.core.messages import CostGrid, Message, Number, OccupancyGrid, Path
from ambler.core.protocols import DrawsGraph, GlobalPlanner
from ambler.costmap.global_costmap import GlobalCostmap
from ambler.costmap.layer import Moment
from ambler.nodes.layer_inputs import UNPLACED, LayerInput, usual_inputs
from ambler.nodes.map_frames import MapFrames
from ambler.runtime.node import Node, Topics
from ambler.runtime.tasks import CLEAR_GLOBAL_COSTMAP, COMPUTE_PATH, Nothing, PlanReply, PlanRequest
from ambler.runtime.topics import (
    CLOUD_CLEARING,
    GLOBAL_COSTMAP,
    MAP,
    MAP_CLEARING,
    STATIC_TRANSFORMS,
    TRANSFORMS,
    VISIBILITY_GRAPH,
)

GRAPH_PERIOD = 2.0  # seconds between two pictures of a planner's graph: thousands of lines


class GlobalPlannerNode(Node):
    """Publishes VISIBILITY_GRAPH with the paths of a planner that has one, and GLOBAL_COSTMAP when the map or what lies over it has changed, at most once per `period` seconds; serves COMPUTE_PATH (a
    PlanningError or TransformError reaches the caller) and CLEAR_GLOBAL_COSTMAP.

    `layer_inputs` feed layers of one's own; those of `usual_inputs` are fed anyway. MAP_CLEARING and CLOUD_CLEARING tell within what radius of the
    robot it shall forget what sensors saw.
    """

    name: str = "planner"
    outputs: Topics = (GLOBAL_COSTMAP,)
    serves = (COMPUTE_PATH, CLEAR_GLOBAL_COSTMAP)
    latency: float = 0.02

    def __init__(
        self,
        costmap: GlobalCostmap,
        planner: GlobalPlanner,
        period: float = 0.5,
        layer_inputs: Sequence[LayerInput[Any]] = (),
    ) -> None:
        self._costmap = costmap
        self._planner = planner
        self._period = period
        self._frames = MapFrames()
        self._map: OccupancyGrid | None = None
        self._drawn_map: OccupancyGrid | None = None
        self._is_waiting = False
        self._published_ns: int | None = None
        self._drawn_ns: int | None = None
        if isinstance(planner, DrawsGraph):
            self.outputs = (GLOBAL_COSTMAP, VISIBILITY_GRAPH)
        self._layer_inputs = (*usual_inputs(costmap.layers), *layer_inputs)
        required = tuple(wanted.topic for wanted in self._layer_inputs if wanted.is_required)
        self.inputs = (MAP, TRANSFORMS, *required)
        optional = tuple(wanted.topic for wanted in self._layer_inputs if not wanted.is_required)
        self.optional_inputs = (STATIC_TRANSFORMS, MAP_CLEARING, CLOUD_CLEARING, *optional)

    @property
    def planner(self) -> GlobalPlanner:
        """The planner behind it."""
        return self._planner

    def start(self) -> None:
        """Subscribe and serve."""
        self.ctx.subscribe(MAP, self._on_map)
        self.ctx.subscribe(TRANSFORMS, self._frames.add)
        self.ctx.subscribe(STATIC_TRANSFORMS, self._frames.add_static)
        for clearing in (MAP_CLEARING, CLOUD_CLEARING):
            self.ctx.subscribe(clearing, self._on_clearing)
        for wanted in self._layer_inputs:
            self.ctx.subscribe(wanted.topic, partial(self._on_layer_input, wanted))
        self.ctx.serve(COMPUTE_PATH, self._compute_path)
        self.ctx.serve(CLEAR_GLOBAL_COSTMAP, self._clear)

    def _on_map(self, message: OccupancyGrid) -> None:
        self._map = message
        self._publish_soon()

    def _on_layer_input(self, wanted: LayerInput[Any], message: Message) -> None:
        try:
            wanted.feed(message, self._frames)
        except UNPLACED:
            return
        self._publish_soon()

    def _on_clearing(self, radius: Number) -> None:
        at = self._frames.map_from_base
        if at is not None and radius.value > 0.0:
            self._costmap.clear_within(at.x, at.y, radius.value)
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
        if self._refreshed(self._map):
            costs = self._costmap.costs
            self.ctx.publish(GLOBAL_COSTMAP, CostGrid(self._map.stamp_ns, self._map.frame, self._map.spec, costs))

    def _refreshed(self, newest: OccupancyGrid) -> bool:
        """Bring the costmap up to date; say whether there is anything to tell."""
        moment, before = Moment(self._frames.map_from_base), self._costmap.costs
        is_new = newest is not self._drawn_map
        if is_new:
            self._costmap.set_map(newest.spec, newest.data, moment)
            self._drawn_map = newest
        else:
            self._costmap.update(moment)
        return is_new or self._costmap.costs is not before

    def _compute_path(self, request: PlanRequest) -> PlanReply:
        if self._map is None or not self._costmap.has_map:
            raise NoValidPathError("there is no map yet")
        map_from_base = self._frames.newest_map_from_base()
        result = self._planner.plan(self._costmap.costs, self._costmap.spec, map_from_base, request.map_from_goal)
        path = Path(self._map.stamp_ns, self._map.frame, result.path)
        self._draw(self._map)
        return PlanReply(path, result.cost, result.goal_distance)

    def _draw(self, newest: OccupancyGrid) -> None:
        """Publish the planner's graph, if it has one, at most once per `GRAPH_PERIOD`."""
        now = self.ctx.now_ns
        if not isinstance(self._planner, DrawsGraph):
            return
        if self._drawn_ns is None or now - self._drawn_ns >= GRAPH_PERIOD * 1e9:
            self._drawn_ns = now
            self.ctx.publish(VISIBILITY_GRAPH, self._planner.view(newest.stamp_ns, newest.frame))

    def _clear(self, request: Nothing) -> Nothing:
        self._costmap.clear()
        self._drawn_map = None
        self._publish()
        return Nothing()
