"""Made ground: slabs, ramps and stairs one metre above the simulator's floor, and clouds of a Mid-360 over it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.terrain import Terrain, TerrainAnalysis
from ambler.sim.lidar import LidarSensor
from ambler.sim.meshes import TriangleMesh
from ambler.sim.scene import build_scene
from ambler.sim.sensors import MID_360
from ambler.sim.solids import Shape, Solid, WorldSpec

LEVEL = 1.0  # height of the ground on which robots stand
F32 = NDArray[np.float32]


def slab(x0: float, x1: float, y0: float = -15.0, y1: float = 15.0, top: float = 0.0, bottom: float = -LEVEL) -> Solid:
    """Return a box between two heights over the ground, its sides along the axes."""
    place = SE2(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0)
    return Solid("slab", Shape.BOX, place, x1 - x0, y1 - y0, LEVEL + bottom, LEVEL + top)


def half_plane(x: float, angle: float, top: float, *, is_beyond: bool) -> Solid:
    """Return level ground before or beyond a line across the x axis at `x`, which an edge at right angles has turned by `angle` (rad)."""
    size, side = 40.0, 1.0 if is_beyond else -1.0
    place = SE2(x, 0.0, angle) @ SE2(side * 0.5 * size, 0.0, 0.0)
    return Solid("ground", Shape.BOX, place, size, size, 0.0, LEVEL + top)


def ramp(x0: float, length: float, angle: float, width: float = 8.0) -> tuple[TriangleMesh, Solid]:
    """Return a slope upwards along x from the ground, and the level ground on which it ends."""
    x1, top = x0 + length, LEVEL + length * math.tan(angle)
    y = 0.5 * width
    corners = np.array([[x0, -y, LEVEL], [x1, -y, top], [x1, y, top], [x0, y, LEVEL]])
    mesh = TriangleMesh("ramp", corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    return mesh, slab(x1, x1 + 10.0, -y, y, top - LEVEL)


def made(*solids: Solid, meshes: tuple[TriangleMesh, ...] = (), ceiling: float = math.inf) -> WorldSpec:
    """Return a world of these solids and meshes."""
    return WorldSpec("made", solids, SE2(), meshes=meshes, ceiling=ceiling)


class Rover:
    """A robot's LiDAR over made ground. `error`: what the told base is off by in its own frame, or with `tilts_odom` how
    the frame of odometry lies."""

    def __init__(
        self, world: WorldSpec, robot: RobotModel, seed: int = 0, error: SE3 | None = None, *, tilts_odom: bool = False
    ):
        spec = MID_360
        self._lidar = LidarSensor(spec, "livox", build_scene(world), seed)
        (mount,) = robot.of_kind(SensorKind.CLOUD)
        self._mount, self.elevation = mount.base_from_sensor, mount.elevation
        self._error, self._tilts_odom = error or SE3(), tilts_odom
        self._odom_from_world = SE3((0.0, 0.0, -LEVEL))
        self._count = 0

    def scan(self, world_from_base: SE3) -> tuple[F32, int, SE3, SE3]:
        """Return what the terrain analysis takes: points in odom, stamp, poses of base and sensor there."""
        world_from_sensor = world_from_base @ self._mount
        at, q = np.array([world_from_sensor.translation] * 2), np.array([world_from_sensor.rotation] * 2)
        self._lidar.sweep(np.array([0.0, 0.1]), at, q, first=0.1 * self._count)
        self._count += 1
        cloud = self._lidar.to_cloud(0)
        odom_from_base = self._odom_from_world @ world_from_base
        odom_from_sensor = odom_from_base @ self._mount
        if self._tilts_odom:
            told_base, odom_from_sensor = self._error @ odom_from_base, self._error @ odom_from_sensor
        else:
            told_base = odom_from_base @ self._error
        points = np.asarray(odom_from_sensor.transform(cloud.points), np.float32)
        return points, self._count * 100_000_000, told_base, odom_from_sensor

    def feed(self, analysis: TerrainAnalysis, poses: list[tuple[float, float, float, float]]) -> Terrain:
        """Update with a scan from each place (x, y, z over the ground, yaw)."""
        for x, y, z, yaw in poses:
            pose = SE3.from_rpy((x, y, z + LEVEL), 0.0, 0.0, yaw)
            points, stamp_ns, odom_from_base, odom_from_sensor = self.scan(pose)
            analysis.update(points, stamp_ns, odom_from_base, odom_from_sensor, self.elevation)
        return analysis.terrain()


def along_x(x0: float, x1: float, speed: float = 0.8) -> list[tuple[float, float, float, float]]:
    """Return places 0.1 s apart along the x axis on level ground."""
    return [(x, 0.0, 0.0, 0.0) for x in np.arange(x0, x1, 0.1 * speed).tolist()]


def obstacles(terrain: Terrain, step: float) -> F32:
    """Return the points (N, 4) of what cannot be crossed."""
    return terrain.points[terrain.points[:, 3] >= step]
