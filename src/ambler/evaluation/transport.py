"""What a robot says in a second, for measuring codecs, recordings and the live view: topics at their usual rates and sizes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.core.grid import GridSpec
from ambler.core.messages import Message
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.runtime import topics as t
from ambler.runtime.topics import Topic

Delivered = tuple[Topic[Any], Message, int]

_TICK_NS = 10_000_000
_MAP = GridSpec(0.05, 700, 700, -10.0, -10.0)
_LOCAL = GridSpec(0.05, 60, 60, -1.5, -1.5)
_BEAMS, _CLOUD_POINTS, _RINGS = 1080, 14_400, 16


def robot_traffic(seconds: int, *, has_cloud: bool, rng: np.random.Generator) -> Iterator[Delivered]:
    """Yield what a running exploration publishes: (topic, message, time of delivery in nanoseconds).

    IMU 100 Hz, odometry, truth and two transforms 50 Hz, commands and local path 20 Hz, scan (1080 beams) or cloud (14 400
    points, 16 rings) 10 Hz, local costs 5 Hz, map and global costs (700 x 700 cells), frontiers and path 1 Hz.
    """
    for k in range(100 * seconds):
        now = k * _TICK_NS
        for topic, message in _at_tick(k, now, has_cloud, rng):
            yield topic, message, now + 1_000


def _at_tick(k: int, now: int, has_cloud: bool, rng: np.random.Generator) -> Iterator[tuple[Topic[Any], Message]]:
    yield t.IMU, m.Imu(now, "imu", _vector(rng, 0.01), _vector(rng, 0.1))
    if k % 2 == 0:
        pose = SE3.from_se2(SE2(0.005 * k, float(rng.normal(0.0, 0.01)), 0.001 * k))
        for topic in (t.ODOMETRY, t.TRUE_POSE):
            moving = (0.5, 0.0, 0.0)
            yield topic, m.Odometry(now, "odom", "base", pose, moving, _vector(rng, 0.1), np.eye(6), np.eye(6))
        for parent, child in (("odom", "base"), ("map", "odom")):
            yield t.TRANSFORMS, m.Transforms(now, (m.TransformStamped(now, parent, child, pose),))
    if k % 5 == 0:
        command = m.VelocityCommand(now, float(rng.random()), 0.0, float(rng.random()))
        yield t.VELOCITY_REQUEST, command
        yield t.VELOCITY_COMMAND, command
        yield t.LOCAL_PATH, m.Path(now, "odom", rng.normal(0.0, 1.0, (30, 3)))
    if k % 10 == 0:
        yield (t.CLOUD, _cloud(now, rng)) if has_cloud else (t.SCAN, _scan(now, rng))
        yield t.SLAM_POSE, m.PoseStamped(now, "map", SE3())
        yield t.SLAM_HEALTH, m.SlamHealth(now, 0.9, 0.9, 0.5, np.eye(3), 3, 20, 0)
    if k % 20 == 0:
        yield t.LOCAL_COSTMAP, m.CostGrid(now, "odom", _LOCAL, rng.integers(0, 255, _LOCAL.shape).astype(np.uint8))
    if k % 100 == 0:
        yield from _maps(now, rng)


def _maps(now: int, rng: np.random.Generator) -> Iterator[tuple[Topic[Any], Message]]:
    occupancy = np.full(_MAP.shape, -1, np.int8)
    occupancy[200:500, 200:500] = rng.integers(0, 2, (300, 300)) * 100
    yield t.MAP, m.OccupancyGrid(now, "map", _MAP, occupancy)
    yield t.GLOBAL_COSTMAP, m.CostGrid(now, "map", _MAP, np.where(occupancy < 0, 255, 0).astype(np.uint8))
    cells = rng.uniform(-10.0, 10.0, (100, 2)).astype(np.float32)
    frontier = m.Frontier(cells, (0.0, 0.0), (1.0, 2.0, 0.0), 4.0, m.FrontierState.OPEN)
    yield t.FRONTIERS, m.Frontiers(now, "map", (frontier,) * 10)
    yield t.PATH, m.Path(now, "map", rng.normal(0.0, 5.0, (300, 3)))


def _scan(now: int, rng: np.random.Generator) -> m.LaserScan:
    ranges = (np.linspace(1.0, 8.0, _BEAMS) + rng.normal(0.0, 0.01, _BEAMS)).astype(np.float32)
    none = np.empty(0, np.float32)
    return m.LaserScan(now, "scan", -np.pi, 2 * np.pi / _BEAMS, 0.0, 0.1, 0.1, 30.0, ranges, none)


def _cloud(now: int, rng: np.random.Generator) -> m.PointCloud:
    angle = np.linspace(0.0, 2 * np.pi, _CLOUD_POINTS)
    reach = 4.0 + rng.normal(0.0, 0.02, _CLOUD_POINTS)
    points = np.stack([reach * np.cos(angle), reach * np.sin(angle), 0.1 * reach], axis=1).astype(np.float32)
    time = np.linspace(0.0, 0.1, _CLOUD_POINTS).astype(np.float32)
    ring = np.tile(np.arange(_RINGS, dtype=np.uint16), _CLOUD_POINTS // _RINGS)
    return m.PointCloud(now, "lidar", points, np.full(_CLOUD_POINTS, 50.0, np.float32), time, ring)


def _vector(rng: np.random.Generator, sigma: float) -> tuple[float, float, float]:
    x, y, z = rng.normal(0.0, sigma, 3).tolist()
    return (x, y, z)
