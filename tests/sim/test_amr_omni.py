"""The industrial robot: mecanum kinematics, slip that odometry does not see, and scanners that look exactly where they should."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambler.core.messages import LaserScan
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import MERGED_FRAME
from ambler.core.se2 import SE2
from ambler.perception.merger import MergerConfig
from ambler.sim.drive import MecanumWheels, TwoWheels, drive_of
from ambler.sim.robots import robot_named
from ambler.sim.sensors import SAFETY_270
from ambler.sim.simulation import Simulation, SimulationConfig, SimulationOutput
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.world_file import load_world

SCANNERS = ("front_right", "front_left", "rear_left")


def drive(simulation: Simulation, command: BodyVelocity, seconds: float) -> SimulationOutput:
    out = SimulationOutput()
    for _ in range(round(seconds * 20)):
        simulation.command(command)
        out = simulation.step(simulation.now_ns + 50_000_000)
    return out


@pytest.mark.parametrize("drive_model", [TwoWheels(0.09, 0.34), MecanumWheels(0.1, 0.7)])
def test_wheels_and_motion_are_inverse_to_each_other(drive_model: TwoWheels | MecanumWheels) -> None:
    for k in range(50):
        vx, vy, wz = np.random.default_rng(k).uniform(-1, 1, 3)
        vy = vy if isinstance(drive_model, MecanumWheels) else 0.0
        rates = drive_model.rates(BodyVelocity(vx, vy, wz))
        np.testing.assert_allclose(drive_model.motion(np.array(rates)), (vx, vy, wz), atol=1e-12)


def test_mecanum_wheels_turn_as_in_the_textbook() -> None:
    """Sideways to the left the front left and rear right wheels turn backwards; turning left, both left wheels do."""
    wheels = drive_of(robot_named("amr_omni"))
    assert np.sign(wheels.rates(BodyVelocity(0, 0.3, 0))).tolist() == [-1, 1, 1, -1]
    assert np.sign(wheels.rates(BodyVelocity(0, 0, 0.3))).tolist() == [-1, 1, -1, 1]
    assert wheels.rates(BodyVelocity(0.5, 0, 0)) == pytest.approx((5.0,) * 4)


@pytest.mark.parametrize("mode", ["contact", "kinematic"])
def test_it_drives_sideways_and_its_rollers_lose_three_percent(open_floor: WorldSpec, mode: str) -> None:
    config = SimulationConfig(0, physics="contact" if mode == "contact" else "kinematic")
    simulation = Simulation(open_floor, robot_named("amr_omni"), config)
    drive(simulation, BodyVelocity(0, 0.4, 0), 1.5)
    before = simulation.world_from_base.to_se2()
    out = drive(simulation, BodyVelocity(0, 0.4, 0), 2.0)
    moved = before.inverse() @ simulation.world_from_base.to_se2()
    assert moved.y / 2.0 == pytest.approx(0.97 * 0.4, abs=0.005)
    assert abs(moved.x) < 0.02
    assert abs(moved.yaw) < 0.02
    # The encoders do not notice: odometry is a few percent ahead, within the scale errors of wheels.
    assert out.odometry[-1].linear[1] / 0.4 == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize("mode", ["contact", "kinematic"])
def test_perfect_odometry_agrees_with_the_motion(open_floor: WorldSpec, mode: str) -> None:
    config = SimulationConfig(0, True, "contact" if mode == "contact" else "kinematic")
    simulation = Simulation(open_floor, robot_named("amr_omni"), config)
    for k in range(8):
        out = drive(simulation, BodyVelocity(0.5 * math.sin(k), 0.4 * math.cos(k), 0.5), 0.5)
    error = out.odometry[-1].pose.to_se2().inverse() @ simulation.world_from_base.to_se2()
    assert math.hypot(error.x, error.y) < 0.03
    assert abs(error.yaw) < 0.01


def test_real_odometry_drifts_within_a_few_percent(open_floor: WorldSpec) -> None:
    errors = []
    for seed in range(5):
        simulation = Simulation(open_floor, robot_named("amr_omni"), SimulationConfig(seed, physics="kinematic"))
        out = drive(simulation, BodyVelocity(0.5, 0.4, 0.0), 3.0)
        errors.append(out.odometry[-1].pose.to_se2().distance_to(simulation.world_from_base.to_se2()))
    assert 0.01 < np.mean(errors) < 0.10


def test_on_ice_the_wheels_count_more_than_the_base_moves(open_floor: WorldSpec) -> None:
    simulation = Simulation(replace(open_floor, friction=0.03), robot_named("amr_omni"), SimulationConfig(0, True))
    out = drive(simulation, BodyVelocity(0.0, 0.5, 0.0), 1.0)
    assert out.odometry[-1].pose.translation[1] - simulation.world_from_base.translation[1] > 0.05


def scans_of(world: WorldSpec) -> dict[str, LaserScan]:
    simulation = Simulation(world, robot_named("amr_omni"), SimulationConfig(0, True, "kinematic"))
    return {scan.frame: scan for scan in simulation.step(200_000_000).scans}


def test_each_scanner_sends_its_sector_in_its_own_time() -> None:
    simulation = Simulation(load_world("lab_empty"), robot_named("amr_omni"))
    out = simulation.step(400_000_000)
    stamps = {frame: [s.stamp_ns for s in out.scans if s.frame == frame] for frame in SCANNERS}
    assert stamps["front_right"] == [50_000_000 + 80_000_000 * k for k in range(5)]
    assert {s % 80_000_000 for s in stamps["front_left"]} == {75_000_000}
    assert {s % 80_000_000 for s in stamps["rear_left"]} == {25_000_000}
    scan = out.scans[0]
    assert len(scan.ranges) == 721
    assert scan.angle_min == pytest.approx(-math.radians(135))
    assert scan.angle_min + 720 * scan.angle_increment == pytest.approx(math.radians(135))
    assert scan.time_increment * 720 == pytest.approx(0.03)
    assert len(out.imus) == 80


@pytest.mark.parametrize("bearing", range(0, 360, 15))
def test_a_scanner_sees_a_post_exactly_when_it_stands_in_its_sector(bearing: int) -> None:
    """A thin post 3 m from the base: every scanner tells its place, or has it outside of its 270 degrees."""
    phi = math.radians(bearing)
    post = Solid("post", Shape.CYLINDER, SE2(3 * math.cos(phi), 3 * math.sin(phi), 0.0), 0.1, 0.1, 0.0, 1.0)
    model = robot_named("amr_omni").model
    seen = 0
    for frame, scan in scans_of(WorldSpec("post", (post,), SE2())).items():
        sensor_from_base = model.sensor(frame).base_from_sensor.to_se2().inverse()
        place = sensor_from_base @ post.world_from_solid
        distance, angle = math.hypot(place.x, place.y), math.atan2(place.y, place.x)
        hits = np.flatnonzero(np.isfinite(scan.ranges))
        assert (len(hits) > 0) == (abs(angle) < math.radians(135) + 0.05 / distance), frame
        if len(hits) and abs(angle) < math.radians(130):
            assert scan.ranges[hits].min() == pytest.approx(distance - 0.05, abs=2e-3)
            middle = scan.angle_min + hits.mean() * scan.angle_increment
            assert middle == pytest.approx(angle, abs=scan.angle_increment)
            seen += 1
    assert seen >= 1, "there is no direction in which nobody looks"


def test_the_merger_gets_windows_and_the_self_mask_from_the_model() -> None:
    model = robot_named("amr_omni").model
    config = MergerConfig.from_robot(model)
    assert [s.frame for s in config.scanners] == list(SCANNERS) == [m.frame for m in model.scanners]
    angles = SAFETY_270.azimuth_start + np.arange(721) * SAFETY_270.azimuth_increment
    for scanner in config.scanners:
        kept = np.degrees(angles[scanner.windows[0].keeps(angles)])
        assert kept[-1] - kept[0] == pytest.approx(264.0, abs=0.4)
    np.testing.assert_array_equal(config.self_mask[0], model.footprint)
    virtual, given = model.sensor(MERGED_FRAME).base_from_sensor, config.mount.base_from_sensor
    assert given.translation == pytest.approx(virtual.translation)
    assert given.rotation == virtual.rotation


def test_no_beam_of_a_window_passes_through_the_robot() -> None:
    model = robot_named("amr_omni").model
    for mount in model.scanners:
        angles = np.linspace(*mount.azimuth, 200)
        for reach in (0.1, 0.4, 1.0):
            beams = reach * np.column_stack([np.cos(angles), np.sin(angles)])
            points = mount.base_from_sensor.to_se2().transform(beams)
            inside = (np.abs(points[:, 0]) < 0.6) & (np.abs(points[:, 1]) < 0.4)
            assert not inside.any(), mount.frame
