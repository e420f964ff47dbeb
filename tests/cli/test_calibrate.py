"""`ambler calibrate`: a simulated drive ends in a profile beside what it held before; recordings that do not fit are one clear line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from ambler.calibration.scan_calibration import OdometryModel
from ambler.cli.main import main
from ambler.core.messages import LaserScan, Odometry
from ambler.core.protocols import BodyVelocity
from ambler.core.se3 import SE3
from ambler.evaluation.robot_calibration import MOUNT_ERROR, read_drive, simulate_robot_drive
from ambler.settings.profiles import load_profile
from ambler.sim.drive import MecanumWheels
from ambler.sim.robots import robot_named
from ambler.wire.ros_messages import encode, ros_type_of
from ambler.wire.ros_types import STORE


def write_bag(path: Path, messages: list[tuple[str, Any]]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for topic, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, ros_type_of(type(message)), typestore=STORE)
            writer.write(connections[topic], message.stamp_ns, encode(message))
    return path


def scan(frame: str, stamp_ns: int) -> LaserScan:
    ranges = np.full(30, 2.0, np.float32)
    return LaserScan(stamp_ns, frame, -1.0, 0.05, 0.0, 0.1, 0.1, 20.0, ranges, np.zeros(0, np.float32))


def odometry(stamp_ns: int) -> Odometry:
    zeros = np.zeros((6, 6))
    return Odometry(stamp_ns, "odom", "base", SE3(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), zeros, zeros.copy())


def test_a_simulated_drive_completes_the_profile(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    profile, result = tmp_path / "profile.yaml", tmp_path / "result.json"
    profile.write_text("strategy: nearest\nscanners: {laser: {x: 9.0, y: 9.0, yaw: 1.0}}\n")
    command = [
        "calibrate",
        "--simulated",
        "--robot",
        "diff",
        "--seconds",
        "30",
        "--out",
        str(profile),
        "--json",
        str(result),
    ]
    assert main(command) == 0
    saved = load_profile(profile)
    assert saved["strategy"] == "nearest"
    laser = saved["scanners"]["laser"]
    model = robot_named("diff").model.sensor("laser").base_from_sensor
    assert abs(laser["x"] - model.translation[0]) < MOUNT_ERROR[0] + 0.02
    fields = json.loads(result.read_text())
    assert fields["position_error_max_mm"] < 15.0
    assert fields["yaw_error_max_deg"] < 0.3
    assert fields["offset_error_max_ms"] < 4.0
    assert 0.0 < fields["laser.sigma_position_mm"] < 15.0
    assert "clock" in capsys.readouterr().out


def test_the_simulated_odometry_follows_the_motion_of_mecanum_wheels() -> None:
    drive = simulate_robot_drive(robot_named("amr_omni"), seed=3, seconds=8.0)
    again = simulate_robot_drive(robot_named("amr_omni"), seed=3, seconds=8.0)
    assert [o.pose for o in drive.odometry] == [o.pose for o in again.odometry]
    assert max(abs(o.linear[1]) for o in drive.odometry) > 0.1
    assert set(drive.scans) == {"front_right", "front_left", "rear_left"}
    assert all(len(s.ranges) == 721 for s in drive.scans["rear_left"])


def test_the_mecanum_model_is_what_larger_wheels_do() -> None:
    wheels, model = MecanumWheels(0.1, 0.7), OdometryModel.mecanum(0.7)
    for i in range(4):
        larger = 1.0 + 1e-3 * (np.arange(4) == i)
        seen = [wheels.motion(np.array(wheels.rates(BodyVelocity(*unit))) * larger) for unit in np.eye(3).tolist()]
        deviation = np.array(seen).T - np.eye(3)
        np.testing.assert_allclose(deviation, 1e-3 * model.slip_modes[i], atol=1e-12)
        for entry, other, factor in model.ties:
            assert deviation.reshape(-1)[entry] == pytest.approx(factor * deviation.reshape(-1)[other])


def test_a_recording_is_read_by_the_frames_of_its_scans(tmp_path: Path) -> None:
    messages: list[tuple[str, Any]] = [("/odom", odometry(k)) for k in range(1, 4)]
    messages += [("/a", replace(scan("laser", 5))), ("/b", scan("other", 6)), ("/ground_truth/pose", odometry(7))]
    drive = read_drive(write_bag(tmp_path / "bag", messages), robot_named("diff"))
    assert len(drive.odometry) == 3
    assert [s.stamp_ns for s in drive.scans["laser"]] == [5]
    assert [s.frame for s in drive.scanners] == ["laser"]


@pytest.mark.parametrize(
    ("messages", "named"),
    [
        ([("/odom", odometry(1)), ("/scan", scan("laser", 2))], "no scans of front_right, front_left, rear_left"),
        ([("/scan", scan("laser", 2))], "needs one topic with odometry, has none"),
        ([("/a", odometry(1)), ("/b", odometry(2)), ("/s", scan("laser", 3))], "has /a, /b"),
    ],
)
def test_recordings_that_do_not_fit_are_named_and_nothing_is_written(
    messages: list[tuple[str, Any]], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "bag", messages)
    assert main(["calibrate", str(bag), "--out", str(tmp_path / "p.yaml")]) == 2
    assert named in capsys.readouterr().err
    assert not (tmp_path / "p.yaml").exists()


def test_it_wants_one_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", "--out", str(tmp_path / "p.yaml")]) == 2
    assert "either a RECORDING or --simulated" in capsys.readouterr().err
