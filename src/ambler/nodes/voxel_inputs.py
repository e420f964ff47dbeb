"""What feeds a voxel layer: the depth cameras of a robot and its clouds, each placed in three dimensions."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from ambler.core.camera import CameraModel
from ambler.core.messages import CameraInfo, Image, PointCloud
from ambler.core.robot import RobotModel, SensorKind, SensorMount
from ambler.costmap.layer import Frames
from ambler.costmap.voxel_layer import VoxelLayer, view_of_cloud, view_of_depth
from ambler.nodes.devices.table import topics_of
from ambler.nodes.layer_inputs import LayerInput
from ambler.runtime.topics import TERRAIN_MAP

POSE_STEP = 0.02  # seconds between two poses of a cloud's sensor


class VoxelFeed:
    """Feeds one layer with all depth cameras of a robot and, when there are any, its clouds. Of each sensor it takes a message every `period` seconds
    at most (0: every one). `has_terrain`: the ground is analysed, and obstacles are what stands over that."""

    def __init__(self, robot: RobotModel, layer: VoxelLayer, period: float = 0.0, *, has_terrain: bool = False) -> None:
        self._robot, self._layer = robot, layer
        self._has_terrain = has_terrain
        self._period_ns = round(period * 1e9)
        self._models: dict[str, CameraModel] = {}
        self._taken_ns: dict[str, int] = {}

    @property
    def inputs(self) -> tuple[LayerInput[Any], ...]:
        """What it is fed with. A depth camera that falls silent stops a controller: the robot would go blind where it counts on it."""
        out: list[LayerInput[Any]] = []
        for mount in self._robot.depth_cameras:
            image, info = topics_of(self._robot, mount)
            out.append(LayerInput(info, self._on_info))
            out.append(LayerInput(image, partial(self._on_depth, mount), is_required=True))
        for mount in self._robot.of_kind(SensorKind.CLOUD):
            (cloud,) = topics_of(self._robot, mount)
            out.append(LayerInput(cloud, partial(self._on_cloud, mount)))
        if self._has_terrain:
            out.append(LayerInput(TERRAIN_MAP, self._on_terrain))
        return tuple(out)

    def _on_info(self, info: CameraInfo, frames: Frames) -> None:
        self._models[info.frame] = info.model

    def _on_depth(self, mount: SensorMount, image: Image, frames: Frames) -> None:
        model = self._models.get(mount.frame)
        if model is None or not image.is_depth or not self._is_due(mount.frame, image.stamp_ns):
            return
        floor = frames.spatial_from("base", image.stamp_ns).translation[2]
        pose = frames.spatial_from(mount.frame, image.stamp_ns)
        depth = np.require(image.depth, np.uint16, ["C", "W"])
        reach = min(mount.range_max, self._layer.config.reach)
        self._layer.add(view_of_depth(depth, model, pose, floor, mount.range_min, reach))

    def _on_cloud(self, mount: SensorMount, cloud: PointCloud, frames: Frames) -> None:
        if not self._is_due(mount.frame, cloud.stamp_ns):
            return
        parts = max(1, math.ceil(float(cloud.time.max(initial=0.0)) / POSE_STEP))
        stamps = [cloud.stamp_ns + round(k * POSE_STEP * 1e9) for k in range(parts + 1)]
        floor = frames.spatial_from("base", cloud.stamp_ns).translation[2]
        poses = np.stack([frames.spatial_from(mount.frame, stamp_ns).matrix()[:3] for stamp_ns in stamps])
        points, times = (np.require(a, np.float32, ["C", "W"]) for a in (cloud.points, cloud.time))
        config, near = self._layer.config, mount.range_min
        self._layer.add(view_of_cloud(points, times, poses, POSE_STEP, floor, near, mount.elevation, config))

    def _on_terrain(self, terrain: PointCloud, frames: Frames) -> None:
        """Every point says how high it is above the ground, and so where the ground is."""
        points = terrain.points.astype(np.float64)
        place = frames.costmap_from(terrain.frame, terrain.stamp_ns).transform(points[:, :2])
        self._layer.set_ground(place, points[:, 2] - terrain.intensity)

    def _is_due(self, frame: str, stamp_ns: int) -> bool:
        if stamp_ns - self._taken_ns.get(frame, -self._period_ns) < self._period_ns:
            return False
        self._taken_ns[frame] = stamp_ns
        return True
