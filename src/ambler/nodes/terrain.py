"""Terrain on the bus: out of registered clouds and odometry the terrain around the robot, near and wide, in the frame of the odometry.

A point's intensity is its height above the ground; its ring says what it stands for (`perception.terrain.Ground`, 0: a voxel).
"""

from __future__ import annotations

import numpy as np

from ambler.core.base_motion import BaseMotion
from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.messages import Number, Odometry, PointCloud
from ambler.core.robot import RobotModel
from ambler.perception.terrain import Terrain, TerrainAnalysis
from ambler.perception.terrain_config import TerrainConfig, wide
from ambler.runtime.node import Node, Topics
from ambler.runtime.topics import (
    CLOUD_CLEARING,
    FIRM_GROUND,
    MAP_CLEARING,
    ODOMETRY,
    REGISTERED_CLOUD,
    TERRAIN_CLEARING,
    TERRAIN_MAP,
    TERRAIN_MAP_EXT,
)

NEAR_EVERY = 2  # clouds between two terrains: as often as a local costmap is wanted anew
WIDE_EVERY = 5  # clouds of which the wide window takes one, and tells its terrain at every second


class TerrainNode(Node):
    """Runs two `TerrainAnalysis`; a cloud of a moment without odometry is left out. MAP_CLEARING and TERRAIN_CLEARING tell within what radius of the robot the near one
    shall forget, CLOUD_CLEARING the wide one; FIRM_GROUND what a map of ground holds for sure around the robot."""

    name = "terrain"
    inputs: Topics = (REGISTERED_CLOUD, ODOMETRY)
    optional_inputs: Topics = (FIRM_GROUND, MAP_CLEARING, TERRAIN_CLEARING, CLOUD_CLEARING)
    kept_inputs: Topics = (ODOMETRY,)
    outputs: Topics = (TERRAIN_MAP, TERRAIN_MAP_EXT)
    latency = 0.005

    def __init__(self, robot: RobotModel, config: TerrainConfig) -> None:
        if not robot.clouds:
            raise BadInputError(f"{robot.name}: the terrain analysis needs a LiDAR that gives clouds")
        self._mount = robot.clouds[0]
        self._near, self._wide = TerrainAnalysis(config), TerrainAnalysis(wide(config))
        self._motion = BaseMotion()
        self._count = 0

    def start(self) -> None:
        """Subscribe to clouds and odometry."""
        self.ctx.subscribe(ODOMETRY, self._on_odometry)
        self.ctx.subscribe(REGISTERED_CLOUD, self._on_cloud)
        self.ctx.subscribe(FIRM_GROUND, lambda cloud: self._near.remember(cloud.points))
        for clearing in (MAP_CLEARING, TERRAIN_CLEARING):
            self.ctx.subscribe(clearing, lambda radius: self._forget(self._near, radius))
        self.ctx.subscribe(CLOUD_CLEARING, lambda radius: self._forget(self._wide, radius))

    def _forget(self, analysis: TerrainAnalysis, radius: Number) -> None:
        at = self._motion.newest
        if at is not None and radius.value > 0.0:
            analysis.forget(at.x, at.y, radius.value)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._motion.add(odometry)

    def _on_cloud(self, cloud: PointCloud) -> None:
        try:
            odom_from_base = self._motion.pose_at(cloud.stamp_ns)
        except StaleInputError:
            return
        poses = (odom_from_base, odom_from_base @ self._mount.base_from_sensor)
        self._near.update(cloud.points, cloud.stamp_ns, *poses, self._mount.elevation)
        if self._count % NEAR_EVERY == 0:
            self.ctx.publish(TERRAIN_MAP, to_cloud(self._near.terrain(), cloud.stamp_ns, cloud.frame))
        if self._count % WIDE_EVERY == 0:
            self._wide.update(cloud.points, cloud.stamp_ns, *poses, self._mount.elevation)
        if self._count % (2 * WIDE_EVERY) == 0:
            self.ctx.publish(TERRAIN_MAP_EXT, to_cloud(self._wide.terrain(), cloud.stamp_ns, cloud.frame))
        self._count += 1


def to_cloud(terrain: Terrain, stamp_ns: int, frame: str) -> PointCloud:
    """Return a terrain as a message: height above the ground as intensity, the kind of a point as ring."""
    points, heights = terrain.points[:, :3].copy(), terrain.points[:, 3].copy()
    late = np.zeros(len(points), np.float32)
    return PointCloud(stamp_ns, frame, points, heights, late, terrain.kinds.astype(np.uint16))
