"""The many rays of a cloud are cast part by part while the scanner turns: the cloud is that of a whole turn."""

import numpy as np
import pytest

from ambler.core.devices import Lidar
from ambler.core.messages import PointCloud
from ambler.core.protocols import BodyVelocity
from ambler.sim.body import TICK_NS
from ambler.sim.lidar import LidarSensor
from ambler.sim.robot_devices import robot_devices
from ambler.sim.robots import robot_named
from ambler.sim.world import BodySpec, SimulationConfig, World
from ambler.sim.world_file import load_world

SEED = 7
LATE_NS = 20_000_000  # more than a cloud is on its way
CLOUDS = ["mecanum", "spot", "go2"]  # rings, rings on a body that sways, a pattern that never repeats


def turning(robot: str, *, is_perfect: bool = False) -> tuple[World, Lidar]:
    """Return a robot that drives and turns where nobody walks, and its LiDAR, which is open."""
    world = World(load_world("building"), [BodySpec("a", robot_named(robot))], SimulationConfig(SEED, is_perfect))
    devices = robot_devices(world, "a")
    devices.base.open()
    devices.lidars[0].open()
    world.advance(0)
    for k in range(120):
        devices.base.command(BodyVelocity(0.4, 0.0, 0.8))
        world.advance(k * TICK_NS)
    return world, devices.lidars[0]


def at_once(world: World, cloud: PointCloud, turns: int) -> PointCloud:
    """Return the same turn, the scanner's so manieth, with all its rays cast at once."""
    (body,) = world.bodies
    (spec,) = body.robot.lidars.values()
    sensor = LidarSensor(spec.perfect() if world.config.is_perfect else spec, cloud.frame, world.scene, SEED)
    for _ in range(turns):  # each takes its share of chance
        sensor.sweep(*body.knots(cloud.frame, cloud.stamp_ns), first=1e-9 * cloud.stamp_ns)
    return sensor.to_cloud(cloud.stamp_ns)


@pytest.mark.parametrize("robot", CLOUDS)
def test_a_turn_in_parts_is_the_whole_turn(robot: str) -> None:
    """Without noise, of a base that drives and turns: every return lies where it does when all rays are cast at once."""
    world, lidar = turning(robot)
    (body,) = world.bodies
    clouds = [c for c in lidar.read(600_000_000 + LATE_NS) if isinstance(c, PointCloud)]
    cloud = clouds[-1]
    again = at_once(world, cloud, len(clouds))
    np.testing.assert_array_equal(cloud.ring, again.ring)
    np.testing.assert_array_equal(cloud.time, again.time)
    np.testing.assert_allclose(cloud.points, again.points, atol=1e-4)
    turned = np.diff(body.knots(cloud.frame, cloud.stamp_ns)[2][[0, -1]], axis=0)
    assert np.abs(turned).max() > 0.01


@pytest.mark.parametrize("robot", CLOUDS)
def test_a_scanner_that_was_closed_within_a_turn_begins_with_a_whole_one(robot: str) -> None:
    """Closed at each of many instants of a turn, and opened 40 ms later: the first cloud then is all of one turn."""
    for tick in range(0, 20, 3):
        world, lidar = turning(robot, is_perfect=True)
        world.advance(600_000_000 + tick * TICK_NS)
        lidar.close()
        lidar.read(700_000_000 + tick * TICK_NS)
        lidar.open()
        now_ns, cloud = 700_000_000 + tick * TICK_NS, None
        while cloud is None:
            now_ns += TICK_NS
            cloud = next(iter(lidar.read(now_ns)), None)
        assert isinstance(cloud, PointCloud)
        assert cloud.stamp_ns >= 700_000_000 + tick * TICK_NS
        again = at_once(world, cloud, 1)
        np.testing.assert_array_equal(cloud.time, again.time)
        np.testing.assert_allclose(cloud.points, again.points, atol=1e-4)
