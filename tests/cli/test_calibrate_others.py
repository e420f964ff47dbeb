"""`ambler calibrate range` and `reflectors`: what they find, write and refuse."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ambler.apps.config import recorded_config
from ambler.cli.calibrate_range import TAPE_ZERO, _simulated
from ambler.cli.main import main
from ambler.core.messages import LaserScan
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.settings.profiles import load_profile
from ambler.sim.robots import robot_named
from ambler.wire.camera_info import save_camera_info
from tests.cli.test_calibrate import odometry, write_bag

STRIPS = np.array([[3.0, 1.0], [2.0, -2.5], [-3.0, 2.0]])


def test_edges_are_calibrated_with_a_tape_into_the_profile(tmp_path: Path) -> None:
    profile, result = tmp_path / "profile.yaml", tmp_path / "result.json"
    profile.write_text("strategy: nearest\n")
    assert main(["calibrate", "range", "--simulated", "--out", str(profile), "--json", str(result)]) == 0
    fields = json.loads(result.read_text())
    assert fields["pictures"] == 8
    assert fields["shift_px"] > 0.1
    assert fields["tape_offset_m"] == pytest.approx(TAPE_ZERO, abs=0.003)
    values = load_profile(profile)
    assert values["strategy"] == "nearest"
    assert recorded_config(values).docking.edge_shift_px == pytest.approx(fields["shift_px"], abs=1e-4)


def test_pictures_of_another_marker_check_the_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera, marker, pictures = _simulated(3)
    save_camera_info(tmp_path / "camera.yaml", camera)
    named = []
    for k, picture in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"{k}.png"), picture.image)
        named.append(f"{tmp_path / f'{k}.png'}@{picture.distance:.4f}")
    out, result = tmp_path / "profile.yaml", tmp_path / "result.json"
    side = f"{marker.dictionary}:{marker.number}:{marker.size}"
    told = ["--camera", str(tmp_path / "camera.yaml"), "--marker", side, "--out", str(out)]
    check = ["--check-marker", side, "--json", str(result), "--check", *named[1:4]]
    assert main(["calibrate", "range", *named, *told, *check]) == 0
    fields = json.loads(result.read_text())
    assert fields["check_after_max_m"] < 0.5 * fields["check_before_max_m"]
    for wrong, word in (
        ([*named[:3], *told], "5 are needed"),
        (["0.png", *told], "taped distance"),
        ([*named, *told[:2], "--out", str(out)], "--marker"),
        ([*named, *told[:3], "4X4_50:3", *told[4:]], "4X4_50:3:0.15"),
        ([*named, *told, "--check", named[0]], "belong together"),
        (["missing.png@1.0", *told], "missing.png"),
        (told, "or --simulated"),
    ):
        capsys.readouterr()
        assert main(["calibrate", "range", *wrong]) == 2
        assert word in capsys.readouterr().err


def drive(path: Path, *, is_localized: bool = True, is_bright: bool = True) -> Path:
    """A recording of a `diff` that passes three strips, whose pose in the map is known."""
    mount = robot_named("diff").model.sensor("laser").base_from_sensor
    messages = []
    for k in range(25):
        stamp_ns, pose = 100_000_000 * k, SE2(0.05 * k, 0.02 * k, 0.03 * k)
        at = replace(odometry(stamp_ns), frame="map", pose=SE3.from_se2(pose), pose_covariance=1e-6 * np.eye(6))
        if is_localized:
            messages.append(("/localized_pose", at))
        angles = -math.pi + math.radians(0.5) * np.arange(720)
        ranges, bright = np.full(720, 8.0, np.float32), np.full(720, 20.0, np.float32)
        for x, y in (pose @ mount.to_se2()).inverse().transform(STRIPS):
            i = round((math.atan2(y, x) + math.pi) / math.radians(0.5)) % 720
            ranges[i], bright[i] = math.hypot(x, y), 600.0
        intensities = bright if is_bright else np.zeros(0, np.float32)
        scan = LaserScan(
            stamp_ns, "laser", float(angles[0]), math.radians(0.5), 0.0, 0.1, 0.1, 20.0, ranges, intensities
        )
        messages.append(("/scan", scan))
    return write_bag(path, messages)


def test_reflectors_are_surveyed_from_a_drive(tmp_path: Path) -> None:
    out, result = tmp_path / "profile.yaml", tmp_path / "result.json"
    bag = drive(tmp_path / "bag")
    command = ["calibrate", "reflectors", "--survey", str(bag), "--robot", "diff", "--out", str(out)]
    assert main([*command, "--json", str(result)]) == 0
    config = recorded_config(load_profile(out))
    found = np.array(config.reflector_positions)
    assert found.shape == (3, 2)
    away = np.hypot(*(found[:, None] - STRIPS[None]).transpose(2, 0, 1)).min(axis=0)
    assert away.max() < 0.015
    assert json.loads(result.read_text())["reflectors"] == 3


def test_a_survey_without_poses_intensities_or_recording_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--robot", "diff", "--out", str(tmp_path / "profile.yaml")]
    lost, dull = drive(tmp_path / "lost", is_localized=False), drive(tmp_path / "dull", is_bright=False)
    for words, told in (
        (["--survey", str(lost)], "no poses"),
        (["--survey", str(dull)], "intensities"),
        ([], "--survey"),
    ):
        assert main(["calibrate", "reflectors", *words, *out]) == 2
        assert told in capsys.readouterr().err
    assert not (tmp_path / "profile.yaml").exists()
