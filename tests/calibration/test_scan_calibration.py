"""Mountings and clock offsets from driving, on exact geometry with noisy ranges and wheels; and what must be refused."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ambler.calibration import planar_arrays as se2
from ambler.calibration.hand_eye import guess_mounting, track_scanner
from ambler.calibration.scan_calibration import (
    CalibrationConfig,
    CalibrationError,
    CalibrationResult,
    OdometryModel,
    calibrate_scanners,
)
from ambler.calibration.scan_pairs import PairConfig, match_pair, prepare_scan
from ambler.core.messages import LaserScan, Odometry
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.perception.merger import ScannerConfig
from ambler.perception.scanner_profile import scanner_calibrations
from tests.perception.flatland import Beams, constant_twist, room, take_scan

TRACK = 0.5
BEAMS = Beams(count=271, angle_min=-math.radians(135.0), step=math.radians(1.0), interval=0.07 / 271)
MOUNTS = {"front": SE2(0.45, -0.3, -0.8), "back": SE2(-0.4, 0.25, 2.4)}
OFFSETS = {"front": 0.040, "back": -0.025}
UPSIDE_DOWN = {"front": False, "back": True}
WORLD = room(4.5)


@dataclass(frozen=True)
class Recording:
    scans: dict[str, list[LaserScan]]
    odometry: list[Odometry]
    scanners: tuple[ScannerConfig, ...]


def drive(velocities: np.ndarray, step: float) -> se2.PlanarTrack:
    poses = [SE2()]
    for velocity in velocities[:-1]:
        poses.append(poses[-1] @ SE2.exp(velocity * step))
    return se2.PlanarTrack(np.arange(len(velocities)) * step, np.array([p.as_array() for p in poses]))


def record(velocities: np.ndarray, step: float = 0.02, noise: float = 0.008, seed: int = 1) -> Recording:
    """Scan at 5 Hz; odometry of two wheels that are 1 % too large and too small, on a track believed 1 % too narrow."""
    rng = np.random.default_rng(seed)
    track = drive(velocities, step)
    left, right = velocities[:, 0] - 0.5 * TRACK * velocities[:, 2], velocities[:, 0] + 0.5 * TRACK * velocities[:, 2]
    slip = 1.0 + 0.005 * np.sin(np.arange(len(velocities)) * step)
    left, right = left * 1.01 * slip, right * 0.99
    measured = np.column_stack([0.5 * (left + right), 0.0 * left, (right - left) / (TRACK * 0.99)])
    zeros = np.zeros((6, 6))
    odometry = [
        Odometry(round(t * 1e9), "odom", "base", SE3.from_se2(SE2(*p)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), zeros, zeros)
        for t, p in zip(track.times.tolist(), drive(measured, step).poses.tolist(), strict=True)
    ]
    scans: dict[str, list[LaserScan]] = {}
    for frame, mount in MOUNTS.items():
        begins = np.arange(0.55, track.times[-1] - 0.65, 0.2) + (0.07 if frame == "back" else 0.0)
        scans[frame] = [scan_moving(track, frame, mount, float(b), noise, rng) for b in begins]
    scanners = tuple(ScannerConfig.planar(f, SE2(), 0.2, upside_down=UPSIDE_DOWN[f]) for f in MOUNTS)
    return Recording(scans, odometry, scanners)


def scan_moving(
    track: se2.PlanarTrack, frame: str, mount: SE2, begin: float, noise: float, rng: np.random.Generator
) -> LaserScan:
    index = np.arange(BEAMS.count)
    poses = se2.compose(track.at(begin + index * np.float64(np.float32(BEAMS.interval))), mount.as_array()[None])
    sign = -1.0 if UPSIDE_DOWN[frame] else 1.0
    heading = poses[:, 2] + sign * (BEAMS.angle_min + index * BEAMS.step)
    ranges = WORLD.cast(poses[:, :2], np.column_stack([np.cos(heading), np.sin(heading)]))
    return LaserScan(
        round((begin + OFFSETS[frame]) * 1e9),
        frame,
        BEAMS.angle_min,
        BEAMS.step,
        BEAMS.interval,
        0.1,
        0.05,
        30.0,
        (ranges + noise * rng.standard_normal(len(ranges))).astype(np.float32),
        np.zeros(0, np.float32),
    )


def waves(seconds: float, step: float = 0.02) -> np.ndarray:
    t = np.arange(0.0, seconds, step)
    return np.column_stack([0.45 * np.sin(2 * np.pi * t / 8.3), 0.0 * t, 0.8 * np.sin(2 * np.pi * t / 6.1 + 0.5)])


MODEL = OdometryModel.differential(TRACK)
CONFIG = CalibrationConfig(pairs=PairConfig(half_width=4), node_period=0.35)


@cache
def calibrated() -> CalibrationResult:
    recording = record(waves(26.0))
    return calibrate_scanners(recording.scans, recording.odometry, recording.scanners, MODEL, CONFIG)


def errors_of(result: CalibrationResult) -> np.ndarray:
    rows = []
    for estimate in result.scanners:
        mount, found = MOUNTS[estimate.frame], estimate.base_from_scanner
        yaw = (found.yaw - mount.yaw + math.pi) % (2 * math.pi) - math.pi
        rows.append([found.x - mount.x, found.y - mount.y, yaw, estimate.clock_offset - OFFSETS[estimate.frame]])
    return np.array(rows)


def test_mountings_and_clocks_are_found_without_any_prior_knowledge() -> None:
    errors = errors_of(calibrated())
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.005
    assert np.degrees(np.abs(errors[:, 2])).max() < 0.1
    assert np.abs(errors[:, 3]).max() < 0.002


def test_the_covariance_is_honest() -> None:
    result = calibrated()
    errors = errors_of(result)
    for error, estimate in zip(errors, result.scanners, strict=True):
        assert (np.abs(error) < 3.5 * estimate.sigma).all()
        assert (estimate.sigma < [0.005, 0.005, 0.003, 0.003]).all()
    np.linalg.cholesky(result.covariance)


def test_the_wheels_errors_are_found_as_well() -> None:
    matrix = calibrated().odometry_matrix
    left, right = 1 / 1.01, 1 / 0.99
    assert matrix[0, 0] == pytest.approx(0.5 * (left + right), abs=0.006)
    assert matrix[2, 2] == pytest.approx(0.99 * 0.5 * (left + right), abs=0.006)
    assert matrix[2, 0] == pytest.approx((right - left) / TRACK, abs=0.02)


def test_the_result_is_written_into_the_configuration() -> None:
    recording, result = record(waves(2.0)), calibrated()
    found = scanner_calibrations(result.scanners)
    assert list(found) == [before.frame for before in recording.scanners]
    for before, estimate in zip(recording.scanners, result.scanners, strict=True):
        after = found[before.frame].applied_to(before.base_from_sensor)
        planar = ScannerConfig.planar(
            before.frame, estimate.base_from_scanner, 0.2, upside_down=UPSIDE_DOWN[before.frame]
        )
        np.testing.assert_allclose(after.matrix(), planar.base_from_sensor.matrix(), atol=1e-12)
        assert found[before.frame].clock_offset == estimate.clock_offset


def test_driving_straight_only_is_refused() -> None:
    t = np.arange(0.0, 24.0, 0.02)
    straight = np.column_stack([0.3 * np.sin(2 * np.pi * t / 8.0), 0.0 * t, 0.0 * t])
    recording = record(straight)
    with pytest.raises(CalibrationError, match="scanner front: the robot hardly turned"):
        calibrate_scanners(recording.scans, recording.odometry, recording.scanners, MODEL, CONFIG)


def test_missing_scans_and_odometry_are_named() -> None:
    recording = record(waves(3.0))
    with pytest.raises(CalibrationError, match="holds no odometry"):
        calibrate_scanners(recording.scans, [], recording.scanners, MODEL, CONFIG)
    with pytest.raises(CalibrationError, match="scanner front: only 0 scans"):
        calibrate_scanners({}, recording.odometry, recording.scanners, MODEL, CONFIG)


def test_noise_instead_of_walls_is_refused() -> None:
    recording = record(waves(20.0), noise=0.6)
    with pytest.raises(CalibrationError, match=r"scanner front: only .* scans match"):
        calibrate_scanners(recording.scans, recording.odometry, recording.scanners, MODEL, CONFIG)


def test_the_first_guess_is_good_to_centimetres() -> None:
    recording = record(waves(15.0))
    times = np.array([o.stamp_ns * 1e-9 for o in recording.odometry])
    odometry = se2.PlanarTrack(times, np.array([o.pose.to_se2().as_array() for o in recording.odometry]))
    scans = recording.scans["back"]
    motion = track_scanner(scans, 0, True, odometry, CONFIG.pairs)
    assert np.isfinite(motion.steps).all()
    guess = guess_mounting("back", motion, odometry, 0.3)
    assert np.abs(guess.base_from_scanner[:2] - MOUNTS["back"].as_array()[:2]).max() < 0.05
    assert abs(guess.base_from_scanner[2] - MOUNTS["back"].yaw) < 0.05
    assert guess.clock_offset == pytest.approx(OFFSETS["back"], abs=0.01)


@pytest.mark.parametrize("other", [SE2(0.4, -0.3, -0.7), SE2(-0.4, 0.2, 2.5)])
def test_scans_of_different_scanners_match_to_millimetres(other: SE2) -> None:
    trajectory, rng = constant_twist(0.5, 0.0, 0.8), np.random.default_rng(2)
    mount = SE2(0.4, -0.3, -0.7)
    beams = Beams(interval=0.075 / 541)
    half = 0.5 * 540 * beams.interval
    errors, normalised = [], []
    for _ in range(12):
        begins = rng.uniform(-1.0, 1.0) + np.array([0.0, rng.uniform(-0.5, 0.5)])
        prepared = []
        for pose, begin in ((mount, begins[0]), (other, begins[1])):
            scan = take_scan(room(), trajectory, pose, begin, beams, noise=0.01, rng=rng)
            twist = se2.adjoint(pose.inverse().as_array()) @ np.array([0.5, 0.0, 0.8])
            prepared.append(prepare_scan(scan, 0, False, twist, PairConfig()))
        truth = (trajectory(begins[0] + half) @ mount).inverse() @ (trajectory(begins[1] + half) @ other)
        match = match_pair(prepared[0], prepared[1], truth.as_array() + rng.normal(size=3) * 0.04, PairConfig())
        assert match is not None
        error = (truth.inverse() @ SE2.from_array(match.target_from_source)).log()
        errors.append(np.abs(error))
        normalised.append(float(error @ match.information @ error) / 3.0)
    assert np.max(errors, axis=0)[:2].max() < 0.005
    assert np.max(errors, axis=0)[2] < math.radians(0.08)
    assert 0.2 < np.mean(normalised) < 4.0


POSES = arrays(np.float64, (5, 3), elements=st.floats(-3.0, 3.0))


@settings(max_examples=50, deadline=None)
@given(a=POSES, b=POSES)
def test_arrays_of_poses_obey_the_group_laws(a: np.ndarray, b: np.ndarray) -> None:
    for k in range(5):
        one, two = SE2.from_array(a[k]), SE2.from_array(b[k])
        np.testing.assert_allclose(se2.compose(a, b)[k], (one @ two).as_array(), atol=1e-12)
        np.testing.assert_allclose(se2.log(a)[k], one.log(), atol=1e-9)
        np.testing.assert_allclose(se2.exp(a)[k], SE2.exp(a[k]).as_array(), atol=1e-9)
    np.testing.assert_allclose(se2.compose(a, se2.inverse(a))[:, :2], 0.0, atol=1e-12)
    conjugated = se2.compose(se2.compose(a, se2.exp(1e-6 * b)), se2.inverse(a))
    np.testing.assert_allclose(se2.log(conjugated), 1e-6 * np.einsum("nij,nj->ni", se2.adjoint(a), b), atol=1e-9)
