"""The global planner: keeps the global costmap of the newest map and answers requests for a path from the robot's pose."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path as FilePath
from typing import Any

from ambler.core.errors import NoValidPathError, StaleInputError
from ambler.core.messages import CostGrid, GroundLevels, Message, Number, OccupancyGrid, Path, Status
from ambler.core.protocols import GlobalPlanner, GraphPlanner, PlanResult, PlanStatus
from ambler.core.se2 import SE2
from ambler.costmap.global_costmap import GlobalCostmap
from ambler.costmap.layer import Moment
from ambler.nodes.layer_inputs import UNPLACED, LayerInput, usual_inputs
from ambler.nodes.map_frames import MapFrames
from ambler.runtime.node import Node, Offers, Topics
from ambler.runtime.tasks import (
    CLEAR_GLOBAL_COSTMAP,
    COMPUTE_PATH,
    SAVE_GRAPH,
    Nothing,
    PlanReply,
    PlanRequest,
    SaveMapRequest,
)
from ambler.runtime.topics import (
    CLOUD_CLEARING,
    GLOBAL_COSTMAP,
    GROUND_LEVELS,
    MAP,
    MAP_CLEARING,
    STATIC_TRANSFORMS,
    STATUS,
    TRANSFORMS,
    VISIBILITY_GRAPH,
)
from ambler.wire.graph_files import graph_file, save_graph

TEXTS = {
    PlanStatus.PLANNING: "looking for a way to",
    PlanStatus.FREE_PATH: "over known ground to",
    PlanStatus.ATTEMPTING: "attempting unknown ground on the way to",
    PlanStatus.UNREACHABLE: "neither known ground nor a frontier that may still be attempted leads to",
}
GRAPH_PERIOD = 2.0  # seconds between two pictures of a planner's graph: thousands of lines


class GlobalPlannerNode(Node):
    """Publishes GLOBAL_COSTMAP when the map or what lies over it has changed, at most once per `period` seconds; serves COMPUTE_PATH (a
    PlanningError or TransformError reaches the caller) and CLEAR_GLOBAL_COSTMAP. Of a planner that keeps a graph it publishes VISIBILITY_GRAPH with the paths and, in STATUS, the
    `PlanStatus` of a goal when that changes, and serves SAVE_GRAPH.

    On a map of ground the map is that of one level (GROUND_LEVELS): on another one, what sensors saw on the last is forgotten.

    `layer_inputs` feed layers of one's own; those of `usual_inputs` are fed anyway. MAP_CLEARING and CLOUD_CLEARING tell within what radius of the
    robot it shall forget what sensors saw.
    """

    name: str = "planner"
    kept_inputs: Topics = (TRANSFORMS,)
    outputs: Topics = (GLOBAL_COSTMAP,)
    serves: Offers = (COMPUTE_PATH, CLEAR_GLOBAL_COSTMAP)
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
        self._levels: GroundLevels | None = None
        self._level = 0  # of the map
        self._told: tuple[SE2, PlanStatus] | None = None
        if isinstance(planner, GraphPlanner):
            self.outputs = (GLOBAL_COSTMAP, VISIBILITY_GRAPH, STATUS)
            self.serves = (*type(self).serves, SAVE_GRAPH)
        self._layer_inputs = (*usual_inputs(costmap.layers), *layer_inputs)
        required = tuple(wanted.topic for wanted in self._layer_inputs if wanted.is_required)
        self.inputs = (MAP, TRANSFORMS, *required)
        optional = tuple(wanted.topic for wanted in self._layer_inputs if not wanted.is_required)
        self.optional_inputs = (STATIC_TRANSFORMS, MAP_CLEARING, CLOUD_CLEARING, GROUND_LEVELS, *optional)

    @property
    def planner(self) -> GlobalPlanner:
        """The planner behind it."""
        return self._planner

    def start(self) -> None:
        """Subscribe and serve."""
        self.ctx.subscribe(MAP, self._on_map)
        self.ctx.subscribe(GROUND_LEVELS, self._on_levels)
        self.ctx.subscribe(TRANSFORMS, self._frames.add)
        self.ctx.subscribe(STATIC_TRANSFORMS, self._frames.add_static)
        for clearing in (MAP_CLEARING, CLOUD_CLEARING):
            self.ctx.subscribe(clearing, self._on_clearing)
        for wanted in self._layer_inputs:
            self.ctx.subscribe(wanted.topic, partial(self._on_layer_input, wanted))
        self.ctx.serve(COMPUTE_PATH, self._compute_path)
        self.ctx.serve(CLEAR_GLOBAL_COSTMAP, self._clear)
        if isinstance(self._planner, GraphPlanner):
            self.ctx.serve(SAVE_GRAPH, self._save_graph)

    def _on_map(self, message: OccupancyGrid) -> None:
        self._map = message
        self._find_level()
        self._publish_soon()

    def _on_levels(self, message: GroundLevels) -> None:
        self._levels = message
        self._find_level()

    def _find_level(self) -> None:
        """Find out of which level the map is: that of the newest word of levels, unless the map is older; then its own is on the way."""
        if self._levels is None or self._map is None or self._map.stamp_ns < self._levels.stamp_ns:
            return
        if self._levels.active == self._level:
            return
        self._level = self._levels.active
        self._costmap.clear()
        self._costmap.forget_driven()
        if isinstance(self._planner, GraphPlanner):
            self._planner.enter_level(self._level)
        self._publish()  # at once: who plans next is on that level

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
        if self._levels is not None and self._levels.active != self._level:
            raise StaleInputError(f"the map of level {self._levels.active} has not come yet")
        result = self._plan(self._frames.newest_map_from_base(), request.map_from_goal)
        path = Path(self._map.stamp_ns, self._map.frame, result.path)
        self._draw(self._map)
        return PlanReply(path, result.cost, result.goal_distance)

    def _plan(self, map_from_base: SE2, map_from_goal: SE2) -> PlanResult:
        """Plan, and tell what a planner that knows says of it, when that is news of this goal."""
        planner, costs = self._planner, (self._costmap.costs, self._costmap.spec)
        if not isinstance(planner, GraphPlanner):
            return planner.plan(*costs, map_from_base, map_from_goal)
        if self._told is None or self._told[0] != map_from_goal:
            self._tell(map_from_goal, PlanStatus.PLANNING)
        try:
            return planner.plan(*costs, map_from_base, map_from_goal)
        finally:
            if self._told != (map_from_goal, planner.status):
                self._tell(map_from_goal, planner.status)

    def _tell(self, goal: SE2, status: PlanStatus) -> None:
        self._told = (goal, status)
        where = "" if self._levels is None else f" on level {self._level}"
        text = f"{TEXTS[status]} {goal.x:.2f}, {goal.y:.2f} m{where}"
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, status.value, text))
        self.ctx.log(status.value, text)

    def _save_graph(self, request: SaveMapRequest) -> Nothing:
        """Save the graphs of all levels beside a map."""
        assert isinstance(self._planner, GraphPlanner)
        save_graph(graph_file(FilePath(request.stem)), self._planner.to_arrays())
        return Nothing()

    def _draw(self, newest: OccupancyGrid) -> None:
        """Publish the planner's graph, if it has one, at most once per `GRAPH_PERIOD`."""
        now = self.ctx.now_ns
        if not isinstance(self._planner, GraphPlanner):
            return
        if self._drawn_ns is None or now - self._drawn_ns >= GRAPH_PERIOD * 1e9:
            self._drawn_ns = now
            self.ctx.publish(VISIBILITY_GRAPH, self._planner.view(newest.stamp_ns, newest.frame))

    def _clear(self, request: Nothing) -> Nothing:
        self._costmap.clear()
        self._drawn_map = None
        self._publish()
        return Nothing()
