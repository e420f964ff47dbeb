"""Robots as data: what the built-in ones are, that a model survives its URDF file, and that it agrees with the simulated robot."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.robot import MERGED_FRAME, RobotModel, SensorKind
from ambler.robots.catalog import robot_description, robot_model, robot_names
from ambler.robots.ring import with_transducer_ring
from ambler.robots.sensors import SCANNERS
from ambler.robots.urdf import read_robot
from ambler.robots.urdf_writer import save_robot
from ambler.sim.robots import robot_named

NAMES = [*robot_names(), "diff+ultrasonic", "spot+ultrasonic", "spot+depth", "porter+depth"]


def assert_equal(a: RobotModel, b: RobotModel) -> None:
    assert (a.name, a.drive, a.limits, a.body_height) == (b.name, b.drive, b.limits, b.body_height)
    np.testing.assert_array_equal(a.footprint, b.footprint)
    assert [s.frame for s in a.sensors] == [s.frame for s in b.sensors]
    for s, t in zip(a.sensors, b.sensors, strict=True):
        assert (s.kind, s.range_min, s.azimuth, s.elevation) == (t.kind, t.range_min, t.azimuth, t.elevation), s.frame
        np.testing.assert_allclose(s.base_from_sensor.matrix(), t.base_from_sensor.matrix(), atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_the_simulated_robot_has_the_model_of_the_catalog(name: str) -> None:
    assert_equal(robot_model(name), robot_named(name).model)


@pytest.mark.parametrize("name", robot_names())
def test_a_model_survives_its_file(name: str, tmp_path: Path) -> None:
    robot = robot_description(name)
    save_robot(robot, tmp_path / "robot.urdf")
    again = read_robot(tmp_path / "robot.urdf").description
    assert again.chassis == robot.chassis
    assert_equal(again.model, robot.model)
    assert_equal(robot_model(str(tmp_path / "robot.urdf")), robot.model)
    with pytest.raises(BadInputError, match="<mass>"):
        robot_named(str(tmp_path / "robot.urdf"))


def test_what_the_planar_robots_are() -> None:
    diff, spot, omni = (robot_model(name) for name in ("diff", "spot", "amr_omni"))
    assert [s.kind for s in diff.sensors] == [SensorKind.SCAN, SensorKind.IMU]
    assert diff.sensor("laser").azimuth == (-math.pi, math.pi)
    (cloud,) = spot.clouds
    assert (cloud.frame, cloud.range_min) == ("velodyne", 0.4)
    assert cloud.elevation == pytest.approx((math.radians(-15), math.radians(15)))
    assert [m.frame for m in omni.scanners] == ["front_right", "front_left", "rear_left"]
    assert omni.sensor(MERGED_FRAME).kind is SensorKind.SCAN
    assert omni.camera is not None
    widths = [math.degrees(m.azimuth[1] - m.azimuth[0]) for m in omni.scanners]
    assert widths == pytest.approx([264.0] * 3)
    assert robot_description("spot").chassis.wheel_radius == 0.0
    assert robot_description("amr_omni").chassis.has_mecanum_wheels
    assert robot_description("diff").chassis.has_two_wheels


@pytest.mark.parametrize(
    ("name", "pitch_deg"), [("mecanum", 0.0), ("mecanum+tilted", 28.0), ("go2", 28.0), ("g1", 20.0)]
)
def test_what_the_robots_with_a_mid_360_are(name: str, pitch_deg: float) -> None:
    """The sensor looks forwards and down by its tilt; the unit inside it sits 5 cm from where the points count from, turned alike."""
    robot = robot_model(name)
    (lidar,), (imu,) = robot.clouds, robot.of_kind(SensorKind.IMU)
    assert lidar.elevation == pytest.approx((math.radians(-7.0), math.radians(52.0)))
    ahead = lidar.base_from_sensor.rotate((1.0, 0.0, 0.0))
    assert math.degrees(math.asin(-ahead[2])) == pytest.approx(pitch_deg)
    between = lidar.base_from_sensor.inverse() @ imu.base_from_sensor
    assert between.rotation == pytest.approx((1.0, 0.0, 0.0, 0.0))
    assert np.linalg.norm(between.translation) == pytest.approx(0.0511, abs=1e-3)
    assert not robot.scanners


def test_only_a_level_sensor_can_be_tilted() -> None:
    both = robot_model("mecanum+tilted+ultrasonic")
    assert len(both.rangers) == 12
    with pytest.raises(BadInputError, match="only mecanum"):
        robot_model("go2+tilted")


def test_a_ring_sits_on_the_outline_and_looks_outwards() -> None:
    ring = robot_model("amr_omni+ultrasonic").rangers
    assert len(ring) == 12
    for mount in ring:
        pose = mount.base_from_sensor.to_se2()
        assert max(abs(pose.x) / 0.6, abs(pose.y) / 0.4) == pytest.approx(1.0)
        assert math.atan2(pose.y, pose.x) == pytest.approx(pose.yaw)
    with pytest.raises(BadInputError, match="transducers already"):
        with_transducer_ring(robot_model("amr_omni+ultrasonic"))


@pytest.mark.parametrize(("name", "message"), [("dif", "diff, spot, amr_omni"), ("diff+wings", "wings")])
def test_unknown_robots_are_refused_with_what_there_is(name: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        robot_model(name)


def test_directions_cover_the_span_counter_clockwise() -> None:
    scanner = SCANNERS["safety_270"]
    d = scanner.directions()[:, 0]
    azimuth = np.unwrap(np.arctan2(d[:, 1], d[:, 0]))
    np.testing.assert_allclose(np.diff(azimuth), math.radians(0.375))
    assert azimuth[0] == pytest.approx(math.radians(-135.0))
    assert azimuth[-1] == pytest.approx(math.radians(135.0))
    full = SCANNERS["scanner_360"].directions()[:, 0]
    assert math.degrees(math.acos(float(full[0] @ full[-1]))) == pytest.approx(0.5)
