"""Calibrated scanners go into a profile and from there into the robot's model and the merger, and nothing else of a mount changes."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from ambler.apps.config import RobotConfig, default_config
from ambler.calibration.scan_calibration import ScannerEstimate
from ambler.core.errors import BadInputError
from ambler.core.messages import LaserScan
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.merger import MergerConfig
from ambler.perception.scanner_profile import ScannerCalibration, calibrated_robot
from ambler.settings.profiles import as_values, build, load_profile, merge
from ambler.sim.robots import robot_named

FOUND = {"front_left": ScannerCalibration(0.61, 0.39, 0.8, 0.02, 0.001, 0.001, 0.002, 0.0005)}


def test_an_estimate_keeps_its_values_and_deviations() -> None:
    covariance = np.diag([4e-6, 9e-6, 1e-6, 16e-8])
    got = ScannerCalibration.from_estimate(ScannerEstimate("a", SE2(1.0, 2.0, 0.5), 0.03, covariance))
    assert got == ScannerCalibration(1.0, 2.0, 0.5, 0.03, 0.002, 0.003, 0.001, 0.0004)


def test_height_roll_and_pitch_of_the_model_stay() -> None:
    hanging = SE3.from_rpy((0.1, 0.2, 0.3), math.pi, 0.05, -0.4)
    placed = ScannerCalibration(1.0, 2.0, 0.7).applied_to(hanging)
    expected = SE3.from_rpy((1.0, 2.0, 0.3), math.pi, 0.05, 0.7)
    np.testing.assert_allclose(placed.matrix(), expected.matrix(), atol=1e-12)


def test_the_robot_and_the_merger_take_the_profile_over() -> None:
    model = robot_named("amr_omni").model
    changed = calibrated_robot(model, FOUND)
    assert changed.sensor("front_left").base_from_sensor.to_se2().as_array() == pytest.approx([0.61, 0.39, 0.8])
    assert changed.sensor("rear_left") == model.sensor("rear_left")
    merger = MergerConfig.from_robot(changed)
    assert {s.frame: s.clock_offset for s in merger.scanners} == {
        "front_right": 0.0,
        "front_left": 0.02,
        "rear_left": 0.0,
    }


def test_scans_get_the_stamps_of_when_they_were_measured() -> None:
    changed = calibrated_robot(robot_named("amr_omni").model, FOUND)
    none = np.zeros(0, np.float32)
    for frame, ahead_ns in (("front_left", 20_000_000), ("rear_left", 0), ("base", 0)):
        scan = LaserScan(5_000_000_000, frame, 0.0, 0.0, 0.0, 0.08, 0.05, 40.0, none, none)
        assert changed.timed(scan).stamp_ns == scan.stamp_ns - ahead_ns


def test_a_scanner_that_the_robot_lacks_is_named() -> None:
    with pytest.raises(BadInputError, match="robot diff has no scanner 'front_left'"):
        calibrated_robot(robot_named("diff").model, FOUND)


def test_the_section_survives_a_profile_file(tmp_path: Path) -> None:
    path = tmp_path / "profile.yaml"
    path.write_text(yaml.safe_dump({"scanners": as_values(FOUND)}))
    base = as_values(default_config(robot_named("amr_omni").model))
    config = build(RobotConfig, merge(base, load_profile(path)))
    assert config.scanners == FOUND
    assert build(RobotConfig, as_values(config)) == config


def test_mistakes_in_the_section_are_named() -> None:
    with pytest.raises(BadInputError, match=r"scanners\.front\.height: no such name"):
        build(RobotConfig, {"scanners": {"front": {"x": 0, "y": 0, "yaw": 0, "height": 1}}})
    turned = build(RobotConfig, {"scanners": {"front": {"x": 0, "y": 0, "yaw_deg": 90}}})
    assert turned.scanners["front"].yaw == pytest.approx(math.pi / 2)
