"""The map of ground on the bus: terrain, odometry and map -> odom in; the map of the level on which the robot is out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.grid import OCC_UNKNOWN
from ambler.core.messages import (
    GroundLevels,
    OccupancyGrid,
    PointCloud,
    PoseStamped,
    Status,
    Transforms,
)
from ambler.core.robot import RobotModel
from ambler.core.se3 import SE3
from ambler.perception.ground_map import GroundMap, GroundMapConfig
from ambler.perception.terrain_config import TerrainConfig
from ambler.perception.terrain_window import TerrainWindow
from ambler.runtime.node import GoalHandle, Node, Topics
from ambler.runtime.tasks import CHOOSE_LEVEL, FINISH_MAP, SAVE_MAP, LevelRequest, Nothing, SaveMapRequest
from ambler.runtime.topics import FIRM_GROUND, GROUND_LEVELS, MAP, ODOMETRY, SLAM_POSE, STATUS, TERRAIN_MAP, TRANSFORMS
from ambler.wire.ground_files import save_levels
from ambler.wire.map_files import save_map

MAP_PERIOD = 1.0  # seconds between two tellings of a map that changed


class GroundMapperNode(Node):
    """Runs a `GroundMap`, tells the level on which the robot is as the map, and to the terrain analysis what of it is firm. Terrain without odometry or map -> odom is left out."""

    name = "ground_mapper"
    inputs: Topics = (TERRAIN_MAP, ODOMETRY, TRANSFORMS)
    kept_inputs: Topics = (ODOMETRY, TRANSFORMS)
    outputs: Topics = (MAP, GROUND_LEVELS, FIRM_GROUND, SLAM_POSE, STATUS)
    serves = (SAVE_MAP, FINISH_MAP, CHOOSE_LEVEL)
    latency = 0.01

    def __init__(self, robot: RobotModel, terrain: TerrainConfig, config: GroundMapConfig | None = None) -> None:
        if not robot.clouds:
            raise BadInputError(f"{robot.name}: a map of ground needs a LiDAR that gives clouds")
        self._mount, self._terrain = robot.clouds[0], terrain
        self.map = GroundMap(config, robot.inscribed_radius)
        self._motion = BaseMotion()
        self._map_from_odom: SE3 | None = None
        self._newest_ns = -1
        self._told = (0, 0, 0)  # version, level and number of passages that were told last

    def start(self) -> None:
        """Subscribe, serve, and tell the map when it has changed."""
        self.ctx.subscribe(TERRAIN_MAP, self._on_terrain)
        self.ctx.subscribe(ODOMETRY, self._motion.add)
        self.ctx.subscribe(TRANSFORMS, self._on_transforms)
        self.ctx.serve(SAVE_MAP, self._save_map)
        self.ctx.serve(CHOOSE_LEVEL, self._choose_level)
        self.ctx.serve_task(FINISH_MAP, self._on_finish, lambda handle: None)
        self.ctx.timer(MAP_PERIOD, self._publish)
        self.ctx.timer(MAP_PERIOD, self._tell_firm)

    def _on_transforms(self, message: Transforms) -> None:
        for edge in message.transforms:
            if (edge.parent, edge.child) == ("map", "odom"):
                self._map_from_odom = edge.parent_from_child

    def _on_terrain(self, terrain: PointCloud) -> None:
        if self._map_from_odom is None:
            return
        try:
            odom_from_base = self._motion.pose_at(terrain.stamp_ns)
        except StaleInputError:
            return
        cell, step = self._terrain.cell, self._terrain.step
        kinds = terrain.ring.astype(np.uint8)
        window = TerrainWindow.of_points(terrain.points, terrain.intensity, kinds, cell, step)
        odom_from_sensor = odom_from_base @ self._mount.base_from_sensor
        self.map.update(window, self._map_from_odom, odom_from_base, odom_from_sensor, self._mount.elevation)
        self._newest_ns = terrain.stamp_ns
        self.ctx.publish(SLAM_POSE, PoseStamped(terrain.stamp_ns, "map", self._map_from_odom @ odom_from_base))
        if self._told[0] == 0 or self.map.active != self._told[1]:
            self._publish()

    def _publish(self) -> None:
        if not self.map.levels or self.map.version == self._told[0]:
            return
        now = (self.map.version, self.map.active, len(self.map.passages))
        is_first = self._told[0] == 0
        if is_first or now[1:] != self._told[1:]:
            self._tell_level(is_new=is_first or now[1] != self._told[1])
        self._told = now
        level = self.map.level
        self.ctx.publish(MAP, OccupancyGrid(self._newest_ns, "map", level.spec, self.map.occupancy(self.map.active)))

    def _tell_firm(self) -> None:
        if not self.map.levels or self._map_from_odom is None:
            return
        try:
            odom_from_base = self._motion.pose_at(self._newest_ns)
        except StaleInputError:
            return
        points = self.map.remembered(self._map_from_odom, odom_from_base)
        nothing = np.zeros(len(points), np.float32)
        ring = np.zeros(len(points), np.uint16)
        self.ctx.publish(FIRM_GROUND, PointCloud(self._newest_ns, "odom", points, nothing, nothing, ring))

    def _tell_level(self, *, is_new: bool) -> None:
        """Say on which level the robot is, and how one gets to others: before the map of that level."""
        levels = GroundLevels(self._newest_ns, "map", self.map.active, len(self.map.levels), self._passages())
        self.ctx.publish(GROUND_LEVELS, levels)
        if not is_new:
            return
        fields = {"level": self.map.active, "levels": len(self.map.levels)}
        text = f"on level {self.map.active} of {len(self.map.levels)}"
        self.ctx.log("LEVEL", text, **fields)
        self.ctx.publish(STATUS, Status(self.ctx.now_ns, self.name, "LEVEL", text, json.dumps(fields)))

    def _passages(self) -> NDArray[np.float64]:
        ways = [(p.of_level, p.to_level, *p.map_from_base.as_array()) for p in self.map.passages]
        return np.array(ways, np.float64).reshape(-1, 5)

    def _on_finish(self, handle: GoalHandle[Nothing, Nothing, Nothing]) -> None:
        self._publish()
        handle.succeed(Nothing())

    def _save_map(self, request: SaveMapRequest) -> Nothing:
        """Save what was seen of every level: the first under the name asked for, the others beside it."""
        if not self.map.levels:
            raise BadInputError("there is no ground in the map yet")
        stem = Path(request.stem)
        levels = [(level.spec, level.occupancy(OCC_UNKNOWN), level.heights) for level in self.map.levels]
        for k, (spec, seen, _) in enumerate(levels):
            save_map(stem if k == 0 else stem.with_name(f"{stem.name}-level-{k}"), spec, seen)
        save_levels(stem, levels, self._passages())
        return Nothing()

    def _choose_level(self, request: LevelRequest) -> Nothing:
        if not 0 <= request.level < len(self.map.levels):
            raise BadInputError(f"there is no level {request.level}: the map of ground has {len(self.map.levels)}")
        self.map.wanted = request.level
        return Nothing()
