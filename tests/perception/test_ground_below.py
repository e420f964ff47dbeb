"""Heights in a cloud count from the ground that the terrain analysis found: who stands higher or lower than the robot is seen, and a slope is no wall."""

import math

import numpy as np
import pytest

from ambler.control.config import RolloutConfig
from ambler.control.trajectory_rollout import TrajectoryRollout
from ambler.core.errors import BadInputError
from ambler.core.messages import Odometry, PointCloud
from ambler.core.se3 import SE3
from ambler.costmap.local_costmap import LocalCostmap, LocalCostmapConfig
from ambler.costmap.terrain_layer import TerrainLayer
from ambler.nodes.controller import ControllerNode
from ambler.perception.ground_below import BEYOND, GroundBelow
from ambler.perception.planar import PlanarConfig, cloud_to_points
from ambler.perception.terrain import Ground
from ambler.robots.spatial_robots import mecanum
from ambler.runtime.topics import CLOUD, MOVERS, ODOMETRY, TERRAIN_MAP
from ambler.sim.lidar import LidarSensor
from ambler.sim.scene import build_scene
from ambler.sim.sensors import MID_360
from ambler.studies.made_ground import LEVEL, made, slab
from tests.hand_made_context import HandMadeContext

CELL, STEP = 0.2, 0.08
MS = 1_000_000
CONFIG = PlanarConfig(range_min=0.3, range_max=10.0, free_length=10.0)
MOUNT = SE3((0.1, 0.0, 0.6))


def cloud_of(points: np.ndarray) -> PointCloud:
    n = len(points)
    zero = np.zeros(n, np.float32)
    return PointCloud(0, "lidar", points.astype(np.float32), zero, zero, np.zeros(n, np.uint16))


def terrain_of(height, x: tuple[float, float], y: tuple[float, float]) -> GroundBelow:
    """Ground of a height (x, y) -> z, a point in the middle of each cell."""
    gx, gy = np.meshgrid(np.arange(*x, CELL) + 0.5 * CELL, np.arange(*y, CELL) + 0.5 * CELL)
    points = np.stack((gx, gy, height(gx, gy)), axis=-1).reshape(-1, 3).astype(np.float32)
    n = len(points)
    return GroundBelow.of_terrain(points, np.zeros(n, np.float32), np.full(n, int(Ground.GROUND)), CELL, STEP)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.15, 0.0), (-0.2, 0.1), (0.05, -0.25)])
@pytest.mark.parametrize("base", [SE3(), SE3.from_rpy((3.0, -2.0, 0.7), 0.0, 0.0, 1.1)])
def test_a_slope_is_taken_off(slope: tuple[float, float], base: SE3) -> None:
    """What stands on a slope is where it would be on a level floor: same returns, same rays, to the height that the slope has within a cell."""
    rng = np.random.default_rng(5)
    n = 2000
    bearing, distance = rng.uniform(-math.pi, math.pi, n), rng.uniform(0.5, 9.0, n)
    height = rng.choice([-0.03, 0.0, 0.03, 0.3, 0.5, 1.4], n)  # none within a cell's rise of the band's edges
    flat = np.stack((0.1 + distance * np.cos(bearing), distance * np.sin(bearing), height), axis=1)
    in_odom = base.transform(flat)
    ground = terrain_of(lambda x, y: base.translation[2] + slope[0] * x + slope[1] * y, (-13.0, 16.0), (-13.0, 13.0))
    bx, by, bz = base.translation
    rise = np.column_stack((0.0 * bearing, 0.0 * bearing, slope[0] * in_odom[:, 0] + slope[1] * in_odom[:, 1]))
    below = slope[0] * bx + slope[1] * by
    standing = SE3((bx, by, bz + below), base.rotation)
    sloping = base.inverse().transform(in_odom + rise) - (0.0, 0.0, below)
    told = [
        cloud_to_points(cloud_of(points - MOUNT.translation), MOUNT, np.zeros(3), CONFIG, ground=under)
        for points, under in ((flat, GroundBelow()), (sloping, ground.under(standing)))
    ]
    assert len(told[0].points) > 200
    np.testing.assert_allclose(told[1].points, told[0].points, atol=2e-4)
    assert len(told[1].free_points) == len(told[0].free_points)
    lengths = [np.linalg.norm(scan.free_points, axis=1) for scan in told]
    np.testing.assert_allclose(lengths[1], lengths[0], rtol=0.12)
    tops = [np.nan_to_num(scan.falls.tops, posinf=9.0) for scan in told if scan.falls is not None]
    np.testing.assert_allclose(tops[1], tops[0], atol=0.04)


def test_what_is_no_ground_stands_on_the_nearest_and_far_from_all_the_floor_is_level() -> None:
    points = np.array([(0.1, 0.1, 1.0), (0.3, 0.1, 1.8), (0.5, 0.1, 5.0), (0.9, 0.1, 0.4)], np.float32)
    heights = np.array([0.0, 0.7, 0.0, 0.02], np.float32)
    kinds = np.array([Ground.GROUND, Ground.OBSTACLE, 0, Ground.STEEP])
    ground = GroundBelow.of_terrain(points, heights, kinds, CELL, STEP)
    x0, y0 = ground.place[:2].tolist()
    row = {
        x: float(ground.heights[math.floor((0.1 - y0) / CELL), math.floor((x - x0) / CELL)]) for x in (0.3, 0.7, 2.7)
    }
    assert row == pytest.approx({0.3: 1.0, 0.7: 0.4, 2.7: 0.4})
    assert x0 == pytest.approx(-BEYOND)
    assert math.isnan(float(ground.heights[0, 0])), "the corner is farther"
    dropped = GroundBelow.of_terrain(points, heights, np.full(4, int(Ground.DROP)), CELL, STEP)
    assert dropped.heights.shape == (0, 0)
    with pytest.raises(BadInputError, match="4 points, 3 heights"):
        GroundBelow.of_terrain(points, heights[:3], kinds, CELL, STEP)


STAGE, STAGE_FROM = 0.7, 2.0  # metres: a stage as high as the band of the robot's own level, from there on


def told_of_a_walker(kind: str) -> list[np.ndarray]:
    """Somebody walks on a stage towards a robot that stands below it; return the movers (K, 2) of every scan, with his true place behind them. With the
    terrain as the analysis tells it, or without it (`blind`)."""
    robot = mecanum().model
    layers = (TerrainLayer(),)
    context, told = HandMadeContext(), []
    node = ControllerNode(
        robot, TrajectoryRollout(RolloutConfig(), robot), LocalCostmap(LocalCostmapConfig(), robot, layers)
    )
    context.start(node)
    (mount,) = robot.clouds
    pose = mount.base_from_sensor
    gx, gy = np.meshgrid(np.arange(-6.0, 8.0, CELL) + 0.1, np.arange(-6.0, 6.0, CELL) + 0.1)
    points = np.stack((gx, gy, np.where(gx > STAGE_FROM, STAGE, 0.0)), axis=-1).reshape(-1, 3).astype(np.float32)
    n, zero, none = len(points), (0.0, 0.0, 0.0), np.zeros((6, 6))
    for k in range(30):
        stamp_ns = context.now_ns + k * 100 * MS
        place = (5.0 - 0.1 * k, 1.5 - 0.05 * k)
        walker = slab(place[0] - 0.2, place[0] + 0.2, place[1] - 0.2, place[1] + 0.2, STAGE + 1.7, STAGE)
        room = [slab(-9.0, 9.0, -9.0, 9.0), slab(STAGE_FROM, 9.0, -9.0, 9.0, STAGE), slab(7.0, 7.2, -9.0, 9.0, 3.0)]
        lidar = LidarSensor(MID_360, mount.frame, build_scene(made(*room, *([walker] if k >= 5 else []))), k)
        x, y, z = pose.translation
        at, q = np.array([(x, y, z + LEVEL)] * 2), np.array([pose.rotation] * 2)
        lidar.sweep(np.array([0.0, 0.1]), at, q, first=0.1 * k)
        for when in (stamp_ns - 10 * MS, stamp_ns + 110 * MS):
            context.callbacks[ODOMETRY.name](Odometry(when, "odom", "base", SE3(), zero, zero, none, none))
        kinds = np.full(n, int(Ground.GROUND), np.uint16)
        if kind != "blind":
            late = np.zeros(n, np.float32)
            context.callbacks[TERRAIN_MAP.name](PointCloud(stamp_ns, "odom", points, late, late, kinds))
        context.callbacks[CLOUD.name](lidar.to_cloud(stamp_ns))
        movers = [m for m in context.messages(MOVERS) if m.stamp_ns == stamp_ns]
        seen = movers[-1].points[:, :2] if movers else np.zeros((0, 2))
        told.append(np.vstack((seen, [place])))
    return told


def test_who_walks_higher_than_the_robot_stands_is_seen_in_time() -> None:
    """Within the band of the robot's own level there is only the stage; above the stage's floor there is somebody."""
    seen = [np.hypot(*(told[:-1] - told[-1]).T) for told in told_of_a_walker("terrain")]
    assert not any(len(distances) for distances in seen[:5])
    assert all(len(distances) == 1 and distances[0] < 0.35 for distances in seen[18:27])
    assert not any(len(told) > 1 for told in told_of_a_walker("blind")[:27]), "or the stage does not hide him"
