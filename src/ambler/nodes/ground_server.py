"""A saved map of ground on the bus: the level on which the robot is, as soon as it knows where it is, is the map."""

from __future__ import annotations

import json

from ambler.core.errors import BadInputError, TransformError
from ambler.core.messages import GroundLevels, OccupancyGrid, Status, Transforms
from ambler.core.transforms import TransformTree
from ambler.perception.known_ground import KnownGround
from ambler.runtime.node import Node, Topics
from ambler.runtime.tasks import CHOOSE_LEVEL, LevelRequest, Nothing
from ambler.runtime.topics import GROUND_LEVELS, MAP, STATUS, TRANSFORMS

PERIOD = 0.5  # seconds between two looks at which level the robot is on


class GroundServerNode(Node):
    """Publishes the active level of a `KnownGround`, which never changes while the robot runs, and tells the level before its map."""

    name = "ground_server"
    inputs: Topics = (TRANSFORMS,)
    kept_inputs: Topics = (TRANSFORMS,)
    outputs: Topics = (MAP, GROUND_LEVELS, STATUS)
    serves = (CHOOSE_LEVEL,)
    latency = 0.005

    def __init__(self, ground: KnownGround) -> None:
        self.ground = ground
        self._tree = TransformTree()

    def start(self) -> None:
        """Publish the first level, and look from time to time whether the robot is on another."""
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.serve(CHOOSE_LEVEL, self._choose_level)
        self.ctx.timer(PERIOD, self._look)
        self._publish()

    def _on_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            if (edge.parent, edge.child) in (("map", "odom"), ("odom", "base")):
                self._tree.set(edge.parent, edge.child, edge.stamp_ns, edge.parent_from_child)

    def _look(self) -> None:
        try:
            map_from_base = self._tree.lookup("map", "base")
        except TransformError:
            return
        if self.ground.update(map_from_base):
            self._publish()

    def _publish(self) -> None:
        ground, now = self.ground, self.ctx.now_ns
        level, count = ground.levels[ground.active], len(ground.levels)
        self.ctx.publish(GROUND_LEVELS, GroundLevels(now, "map", ground.active, count, ground.passages))
        self.ctx.publish(MAP, OccupancyGrid(now, "map", level.spec, level.occupancy))
        fields = {"level": ground.active, "levels": count}
        text = f"on level {ground.active} of {count}"
        self.ctx.log("LEVEL", text, **fields)
        self.ctx.publish(STATUS, Status(now, self.name, "LEVEL", text, json.dumps(fields)))

    def _choose_level(self, request: LevelRequest) -> Nothing:
        if not 0 <= request.level < len(self.ground.levels):
            raise BadInputError(f"there is no level {request.level}: the map of ground has {len(self.ground.levels)}")
        self.ground.wanted = request.level
        return Nothing()
