"""What a robot's LiDAR sees while the robot stands on the ground of a site, at drawn true places; and the cloud that a robot which has been everywhere would have saved.

Nothing drives here: a stand takes milliseconds where an exploration takes minutes, so that hundreds of places of a site can be judged. What is left out: the gait, people, and
the odometry's drift on a way of metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import small_gicp
from numpy.typing import NDArray

from ambler.core.messages import PointCloud
from ambler.core.robot import SensorKind
from ambler.core.se3 import SE3
from ambler.lio.config import LioConfig
from ambler.lio.sight import SeenScan
from ambler.lio.thin_cloud import thinned
from ambler.sim.lidar import LidarSensor
from ambler.sim.reachable_ground import ReachableGround
from ambler.sim.robots import SimRobot

F64 = NDArray[np.float64]
BEGIN_NS = 1_000_000_000
FOOT = 0.3  # metres from the middle of a robot to where its feet or wheels feel the slope
STOP_WAY = 3.0  # metres between two places at which the tour looks around
STOP_SCANS = 8  # at each, at places within `NEARBY` m of it
NEARBY = 1.5
BENT = (0.015, 0.001)  # m, rad: what loop closures leave of an error between the keyframes of a tour
LEANT = 0.004  # rad that an odometry's vertical leans: the accelerometer's bias


@dataclass(frozen=True, slots=True)
class Stand:
    """A place of the world (x, y, z: on the ground) and a heading."""

    place: tuple[float, float, float]
    yaw: float


class StandingRobot:
    """A robot that is put somewhere and looks. `seed` is that of the sensor's noise."""

    def __init__(self, robot: SimRobot, ground: ReachableGround, seed: int) -> None:
        mount = robot.model.of_kind(SensorKind.CLOUD)[0]
        self.base_from_lidar = mount.base_from_sensor
        self.ground = ground
        self._sensor = LidarSensor(robot.lidars[mount.frame], mount.frame, ground.scene, seed)
        self._scans = 0

    @property
    def period(self) -> float:
        """Seconds from a scan to the next."""
        return self._sensor.spec.period

    def world_from_base(self, stand: Stand) -> SE3:
        """Return the pose of the base, which leans with the ground."""
        x, y, z = stand.place
        c, s = math.cos(stand.yaw), math.sin(stand.yaw)
        ahead = self._height(x + FOOT * c, y + FOOT * s, z) - self._height(x - FOOT * c, y - FOOT * s, z)
        left = self._height(x - FOOT * s, y + FOOT * c, z) - self._height(x + FOOT * s, y - FOOT * c, z)
        return SE3.from_rpy((x, y, z), math.atan2(left, 2.0 * FOOT), -math.atan2(ahead, 2.0 * FOOT), stand.yaw)

    def cloud(self, stand: Stand) -> PointCloud:
        """Return one scan, in the frame of the LiDAR."""
        spec = self._sensor.spec
        pose = self.world_from_base(stand) @ self.base_from_lidar
        times = np.array([0.0, 0.5 * spec.sweep_time, spec.sweep_time + 0.01])
        positions, quaternions = np.tile(pose.translation, (3, 1)), np.tile(pose.rotation, (3, 1))
        first = self._scans * spec.period
        self._scans += 1
        self._sensor.sweep(times, positions, quaternions, first=first)
        return self._sensor.to_cloud(BEGIN_NS + round(first * 1e9))

    def seen(self, stand: Stand, odom_from_world: SE3, stamp_ns: int, cell: float) -> SeenScan:
        """Return one scan as localization gets it: thinned to a point per `cell` metres."""
        points = np.asarray(thinned(self.cloud(stand), cell).points, np.float64)
        pose = odom_from_world @ self.world_from_base(stand) @ self.base_from_lidar
        return SeenScan(stamp_ns, pose, points)

    def _height(self, x: float, y: float, near: float) -> float:
        """Return the height of the ground next to a place, that of the level at `near`."""
        iy, ix = self.ground.spec.cell_of(x, y)
        if not self.ground.spec.contains(x, y):
            return near
        column = self.ground.heights[:, iy, ix]
        off = np.where(np.isfinite(column), np.abs(column - near), np.inf)
        k = int(np.argmin(off))
        return float(column[k]) if off[k] < FOOT else near


def toured_cloud(robot: StandingRobot, config: LioConfig, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the points (N, 3) that a robot saves that has looked around everywhere on the ground it reaches, in the frame of the world: those of many keyframes, thinned as those of
    the odometry, each a little off."""
    places = robot.ground.places()
    out = []
    for stop in _spread(places, STOP_WAY, rng):
        near = np.flatnonzero(((places - stop) ** 2).sum(axis=1) < NEARBY**2)
        own = []
        for k in rng.choice(near, STOP_SCANS).tolist():
            stand = Stand(_triple(places[k]), float(rng.uniform(-math.pi, math.pi)))
            points = np.asarray(robot.cloud(stand).points, np.float64)
            points = points[np.einsum("ij,ij->i", points, points) < config.loops.range_most**2]
            own.append((robot.world_from_base(stand) @ robot.base_from_lidar).transform(points))
        shift, turn = rng.normal(0.0, BENT[0], 3), rng.normal(0.0, BENT[1], 3)
        bent = SE3(_triple(stop + shift)) @ SE3.from_rpy((0.0, 0.0, 0.0), *turn.tolist()) @ SE3(_triple(-stop))
        few = small_gicp.voxelgrid_sampling(np.concatenate(own), config.loops.cell).points()[:, :3]
        out.append(bent.transform(few))
    return np.concatenate(out).astype(np.float32)


def leaning(rng: np.random.Generator) -> SE3:
    """Draw odom_from_world of an odometry that was just switched on: any heading and place, its vertical a little off."""
    roll, pitch = rng.normal(0.0, LEANT, 2).tolist()
    x, y = rng.uniform(-20.0, 20.0, 2).tolist()
    return SE3.from_rpy((x, y, 0.0), roll, pitch, 0.0) @ SE3.from_rpy(
        (0.0, 0.0, 0.0), 0.0, 0.0, float(rng.uniform(-math.pi, math.pi))
    )


def _spread(places: F64, apart: float, rng: np.random.Generator) -> F64:
    """Return places that lie `apart` metres from each other, near enough to all."""
    left, out = places[rng.permutation(len(places))], []
    while len(left):
        out.append(left[0])
        left = left[((left - left[0]) ** 2).sum(axis=1) > apart**2]
    return np.array(out)


def _triple(row: F64) -> tuple[float, float, float]:
    x, y, z = row.tolist()
    return x, y, z
