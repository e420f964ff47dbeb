"""Sensor models: exact when perfect, and with the statistics that their values promise when not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.imu import GRAVITY, ImuSensor
from ambler.sim.lidar import LidarSensor
from ambler.sim.odometry import DeadReckoning
from ambler.sim.robots import robot_named, robot_names
from ambler.sim.scene import build_scene
from ambler.sim.sensors import MEMS_IMU, SCANNER_360, VLP_16, LidarSpec, named_generator
from ambler.sim.simulation import Simulation, SimulationConfig
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.world_file import load_world

STILL = (np.array([0.0, 0.1]), np.array([[0.0, 0, 0.5]] * 2), np.array([[1.0, 0, 0, 0]] * 2))


def drum(radius: float) -> WorldSpec:
    """A hollow ring of 720 thin boxes: every level ray from the centre meets a face at `radius` at a right angle."""
    solids = []
    for k in range(720):
        a = 2 * math.pi * (k + 0.5) / 720 - math.pi
        pose = SE2((radius + 0.05) * math.cos(a), (radius + 0.05) * math.sin(a), a)
        solids.append(Solid(f"d{k}", Shape.BOX, pose, 0.1, 0.01 * radius, 0.0, 50.0))
    return WorldSpec("drum", tuple(solids), SE2())


def turns(spec: LidarSpec, world: WorldSpec, count: int, seed: int = 0) -> np.ndarray:
    sensor = LidarSensor(spec, "laser", build_scene(world), seed)
    out = []
    for _ in range(count):
        sensor.sweep(*STILL)
        out.append(sensor.to_scan(0).ranges)
    return np.array(out)


def test_a_perfect_scanner_is_exact() -> None:
    ranges = turns(SCANNER_360.perfect(), drum(4.0), 1)
    np.testing.assert_allclose(ranges, 4.0, atol=2e-3 * 4.0 * 0.01)


def test_range_noise_and_losses_have_the_promised_statistics() -> None:
    ranges = turns(SCANNER_360, drum(5.0), 60)
    lost = np.isnan(ranges)
    assert lost.mean() == pytest.approx(SCANNER_360.dropout, rel=0.25)
    errors = ranges[~lost] - 5.0
    sigma = SCANNER_360.sigma_0 + 5.0 * SCANNER_360.sigma_1
    assert errors.std() == pytest.approx(sigma, rel=0.03)
    assert abs(errors.mean()) < 4 * sigma / math.sqrt(len(errors))
    beams = np.nan_to_num(ranges - 5.0)
    assert abs(np.mean(beams[:, :-1] * beams[:, 1:])) < 0.02 * sigma**2 + 4 * sigma**2 / math.sqrt(beams.size)


def test_range_limits_are_told_apart() -> None:
    near = replace(SCANNER_360.perfect(), range_min=1.0)
    assert np.isnan(turns(near, drum(0.9), 1)).all()
    assert np.isposinf(turns(SCANNER_360, drum(25.0), 2)).all()


def test_flat_angles_lose_beams() -> None:
    """Along a wall, beams that graze it are lost far more often than those that meet it."""
    side = Solid("side", Shape.BOX, SE2(0.0, 0.6, 0.0), 39.0, 0.2, 0.0, 2.5)
    spec = replace(SCANNER_360, dropout=0.0, mixed=0.0)
    world = WorldSpec("side", (side,), SE2())
    ranges = turns(spec, world, 100)
    angles = spec.azimuth_start + np.arange(720) * spec.azimuth_increment
    cosine = np.abs(np.sin(angles))
    seen = (np.sin(angles) > 0) & (0.5 / np.maximum(cosine, 1e-9) < 18.0)
    lost = np.isnan(ranges).mean(axis=0)
    assert lost[seen & (cosine > spec.grazing_cosine + 0.01)].max() == 0.0
    expected = spec.grazing_dropout * (1 - cosine / spec.grazing_cosine)
    grazing = seen & (cosine < spec.grazing_cosine - 0.01)
    assert grazing.sum() >= 4
    np.testing.assert_allclose(lost[grazing], expected[grazing], atol=0.15)


def test_mixed_pixels_lie_between_the_two_surfaces(wall_ahead: WorldSpec) -> None:
    post = Solid("post", Shape.BOX, SE2(1.6, 0.0, 0.0), 0.2, 0.4, 0.0, 2.5)
    world = WorldSpec("post", (*wall_ahead.solids, post), SE2())
    spec = replace(SCANNER_360.perfect(), mixed=0.3)
    exact, mixed = turns(SCANNER_360.perfect(), world, 1)[0], turns(spec, world, 400)
    exact, mixed = np.nan_to_num(exact, posinf=0.0), np.nan_to_num(mixed, posinf=0.0)
    changed = np.abs(mixed - exact) > 1e-4
    beams = 300 + np.flatnonzero(changed[:, 300:420].any(axis=0))
    assert beams.tolist() == [344, 345, 375, 376], "both sides of both edges of the post"
    for beam, other in ((344, 345), (345, 344), (375, 376), (376, 375)):
        low, high = sorted((exact[other], exact[beam]))
        values = mixed[changed[:, beam], beam]
        assert ((values >= low) & (values <= high)).all()
        assert changed[:, beam].mean() == pytest.approx(0.15, abs=0.06)


def test_the_cloud_of_a_vlp16_holds_rings_times_and_points() -> None:
    world = load_world("office").from_start()
    sensor = LidarSensor(VLP_16.perfect(), "velodyne", build_scene(world), 0)
    sensor.sweep(np.array([0.0, 0.1]), np.array([[0.0, 0, 0.8]] * 2), STILL[2])
    cloud = sensor.to_cloud(7)
    assert cloud.stamp_ns == 7
    assert len(cloud.points) > 28_000
    elevation = np.degrees(np.arctan2(cloud.points[:, 2], np.hypot(cloud.points[:, 0], cloud.points[:, 1])))
    np.testing.assert_allclose(elevation, 2.0 * cloud.ring - 15.0, atol=1e-3)
    azimuth = np.arctan2(cloud.points[:, 1], cloud.points[:, 0])
    fired = np.unwrap(azimuth[cloud.ring == 7]) + math.pi
    np.testing.assert_allclose(cloud.time[cloud.ring == 7], fired / (2 * math.pi) * 0.1, atol=1e-5)
    assert (np.diff(cloud.time) >= 0).all()
    floor = np.abs(cloud.points[:, 2] + 0.8) < 1e-4
    assert 0.02 < floor.mean() < 0.6


def test_the_scanner_is_the_one_of_its_data_sheet() -> None:
    assert VLP_16.columns * len(VLP_16.elevations) == 28_800
    assert (min(VLP_16.elevations), max(VLP_16.elevations)) == (math.radians(-15), math.radians(15))
    assert SCANNER_360.columns == 720
    assert 1 / SCANNER_360.period == 10.0


def test_imu_noise_and_bias_have_the_promised_statistics() -> None:
    spec = replace(MEMS_IMU, bias_time=1e9)
    samples = []
    for seed in range(40):
        imu = ImuSensor(spec, "imu", seed)
        rows = [imu.update(SE3(), (0.0, 0.0, 0.0), k) for k in range(201)]
        samples.append([[*r.angular_velocity, *r.linear_acceleration] for r in rows if r is not None])
    values = np.array(samples)
    assert values.shape == (40, 200, 6)
    white = np.mean(values.std(axis=1), axis=0)
    np.testing.assert_allclose(white[:3], spec.gyro_density * 10.0, rtol=0.03)
    np.testing.assert_allclose(white[3:], spec.accel_density * 10.0, rtol=0.03)
    bias = values.mean(axis=1) - [0, 0, 0, 0, 0, GRAVITY]
    np.testing.assert_allclose(bias[:, :3].std(), spec.gyro_bias_sigma, rtol=0.25)
    np.testing.assert_allclose(bias[:, 3:5].std(), spec.accel_bias_sigma, rtol=0.25)


def test_a_perfect_imu_integrates_to_the_true_motion() -> None:
    """The sum of rates is the true heading; the sum of forces in the map, less gravity, is the true velocity."""
    simulation = Simulation(load_world("lab_empty"), robot_named("spot"), SimulationConfig(0, True))
    mount = simulation.robot.model.sensor("imu").base_from_sensor
    heading, velocity = 0.0, np.zeros(3)
    poses = {}
    for k in range(300):
        simulation.command(BodyVelocity(0.4, 0.1, 0.3))
        out = simulation.step((k + 1) * 10_000_000)
        poses[simulation.now_ns] = simulation.world_from_base @ mount
        for imu in out.imus:
            before = poses.get(imu.stamp_ns - 5_000_000, SE3() @ mount)
            middle = before.interpolate(poses[imu.stamp_ns + 5_000_000], 0.5)
            heading += imu.angular_velocity[2] * 0.01
            force = np.array(middle.rotate(imu.linear_acceleration))
            velocity += (force - [0, 0, GRAVITY]) * 0.01
    now = simulation.now_ns
    end = poses[now]
    last = simulation.step(now + 5_000_000)
    assert last.imus == []
    true_velocity = (np.array((simulation.world_from_base @ mount).translation) - end.translation) / 0.005
    assert heading == pytest.approx(end.to_se2().yaw, abs=0.01)
    np.testing.assert_allclose(velocity, true_velocity, atol=0.03)


@pytest.mark.parametrize("robot", robot_names())
def test_perfect_odometry_repeats_the_motion(robot: str, open_floor: WorldSpec) -> None:
    simulation = Simulation(open_floor, robot_named(robot), SimulationConfig(0, True, "kinematic"))
    for k in range(500):
        simulation.command(BodyVelocity(0.5, 0.0, 0.3 * math.sin(k / 50)))
        out = simulation.step((k + 1) * 10_000_000)
    estimate, truth = out.odometry[-1].pose, simulation.world_from_base
    np.testing.assert_allclose(estimate.translation, truth.translation, atol=2e-3)
    np.testing.assert_allclose(estimate.rotation, truth.rotation, atol=1e-3)


@pytest.mark.parametrize(("robot", "share"), [("diff", 0.005 / math.sqrt(2)), ("spot", 0.01)])
def test_odometry_is_wrong_by_its_scale_errors(robot: str, share: float) -> None:
    """Straight on for 4 m with 60 seeds: the counted length differs by the drawn scales; wheels of unlike size also turn."""
    sim_robot = robot_named(robot)
    lengths, headings = [], []
    for seed in range(60):
        reckoning = DeadReckoning(sim_robot, sim_robot.odometry, seed)
        length = 0.0
        for k in range(1, 101):
            x = 0.04 * k
            travel = (x / sim_robot.wheel_radius,) * 2 if robot == "diff" else (x, 0.0, 0.0)
            odometry = reckoning.update(travel, SE3(), k)
            length += odometry.linear[0] / 50.0
        lengths.append(length / 4.0 - 1.0)
        headings.append(odometry.pose.to_se2().yaw)
    slip = sim_robot.odometry.slip_sigma * math.sqrt(2 * sim_robot.odometry.slip_time / 2.0)
    slip = slip / math.sqrt(2) if robot == "diff" else slip
    assert 0.8 * share < np.std(lengths) < 1.3 * math.hypot(share, slip)
    assert abs(np.mean(lengths)) < 4 * np.std(lengths) / math.sqrt(60)
    turning = 4.0 * 0.005 * math.sqrt(2) / sim_robot.track if robot == "diff" else 0.0
    assert np.std(headings) >= 0.8 * turning


def test_encoders_count_whole_ticks() -> None:
    robot = robot_named("diff")
    spec = replace(robot.odometry.perfect(), ticks=64)
    reckoning = DeadReckoning(robot, spec, 0)
    tick = 2 * math.pi / 64 * robot.wheel_radius
    for k in range(50):
        x = reckoning.update((0.01 * k, 0.01 * k), SE3(), k).pose.translation[0]
        assert x / tick == pytest.approx(round(x / tick), abs=1e-9)


def test_generators_of_different_sensors_and_seeds_differ() -> None:
    a, b, c = (named_generator(s, n).random(8) for s, n in ((1, "laser"), (1, "imu"), (2, "laser")))
    assert not np.array_equal(a, b)
    assert not np.array_equal(a, c)
    np.testing.assert_array_equal(a, named_generator(1, "laser").random(8))
