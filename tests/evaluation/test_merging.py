"""The merger and the calibration on the simulator's own rays: the bars of the project, on one run each."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.messages import LaserScan
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import DriveKind
from ambler.core.se2 import SE2
from ambler.evaluation.calibration import Motion, calibration_motion, evaluate_drive, simulate_drive
from ambler.evaluation.merge_timing import SWEEP, TWIST, merge_in_numpy
from ambler.evaluation.merging import (
    FULL,
    NOISY_SCANNER,
    SCANNERS,
    SECONDS,
    Wheels,
    distances_to_walls,
    drive_and_merge,
    hall,
    true_motion,
)
from ambler.perception.merger import MergerConfig, ScanMerger
from ambler.sim.drive import drive_of
from ambler.sim.robots import robot_named
from ambler.sim.solids import Shape, Solid, WorldSpec


def test_merged_points_at_full_speed_lie_on_the_walls() -> None:
    moving = drive_and_merge(3, Wheels.EXACT)
    assert moving.cloud.max() < 2e-3  # 50 poses a second of a swerve: the turning between two of them is not constant
    assert np.percentile(moving.bins, 99) < 0.01
    assert moving.latency.max() <= moving.period
    blind = drive_and_merge(3, Wheels.BLIND)
    assert np.percentile(blind.cloud, 99) > 0.3


def test_noisy_wheels_move_few_points_when_a_gyroscope_goes_with_them() -> None:
    """The bar of the project, with the noise of wheels, gyroscope and ranges; the wheels alone miss it by far."""
    fused = drive_and_merge(3, Wheels.FUSED, NOISY_SCANNER)
    assert 0.0025 < np.percentile(fused.carry, 99) < 0.01  # of which the gyroscope errs most
    assert np.percentile(drive_and_merge(3, Wheels.ALONE).carry, 99) > 0.03
    ranges = drive_and_merge(3, Wheels.EXACT, NOISY_SCANNER)
    assert ranges.carry.max() < 1e-3
    assert 0.02 < np.percentile(ranges.cloud, 99) <= np.percentile(fused.cloud, 99) < 0.03


def test_the_drive_starts_from_a_rest_and_goes_at_full_speed_both_ways_around() -> None:
    track = true_motion()
    np.testing.assert_allclose(track.twist_at(np.array([0.5])), [[0.0, 0.0, 0.0]], atol=1e-12)
    fast = track.twist_at(np.array([FULL + 0.5, SECONDS - 0.5]))
    np.testing.assert_allclose(fast, [[1.0, 0.0, math.pi / 2], [1.0, 0.0, -math.pi / 2]], atol=1e-9)
    assert distances_to_walls(hall(), track.poses[:, :2]).min() > 0.8  # nothing of the hall stands in its way


def test_distances_to_walls_know_boxes_and_pillars() -> None:
    box = Solid("box", Shape.BOX, SE2(1.0, 0.0, math.pi / 2), 2.0, 1.0, 0.0, 1.0)
    pillar = Solid("pillar", Shape.CYLINDER, SE2(5.0, 0.0, 0.0), 1.0, 1.0, 0.0, 1.0)
    world = WorldSpec("two", (box, pillar), SE2())
    points = np.array([[0.5, 0.0], [0.2, 0.0], [1.0, 1.0], [5.0, 0.7], [5.0, 0.0], [-0.1, 1.8]])
    expected = [0.0, 0.3, 0.0, 0.2, 0.5, 1.0]
    np.testing.assert_allclose(distances_to_walls(world, points), expected, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(DriveKind))
def test_calibration_with_full_sensor_noise(kind: DriveKind) -> None:
    errors = evaluate_drive(simulate_drive(7, kind, seconds=45.0))
    assert errors.position < 0.005
    assert errors.yaw < math.radians(0.1)
    assert errors.offset < 0.002
    assert errors.nees < 4.0


def test_the_numpy_peer_of_the_timing_does_the_same_work() -> None:
    """One circle of returns around a scanner: merger and peer see every direction at the same distance."""
    merger = ScanMerger(MergerConfig(SCANNERS))
    angles = np.linspace(-2.35, 2.35, 20_000)
    ranges = np.full(20_000, 8.0, np.float32)
    for stamp_ns in (0, 38_000_000):
        merger.odometry.add_pose(stamp_ns, SE2.exp(TWIST * stamp_ns * 1e-9))
    for scanner in SCANNERS:
        step = float(angles[1] - angles[0])
        timing = (0, scanner.frame, float(angles[0]), step, SWEEP / (len(angles) - 1), 0.04, 0.05, 30.0)
        merger.add_scan(LaserScan(*timing, ranges, np.zeros(0, np.float32)), 38_000_000)
    merged = merger.merge(38_000_000).scan.ranges
    peer = merge_in_numpy(angles, ranges, merger.config.bins)
    seen = np.isfinite(merged) & np.isfinite(peer)
    assert seen.mean() > 0.99
    assert (
        np.percentile(np.abs(merged[seen] - peer[seen]), 99) < 8.0 * 2.0 * math.pi / merger.config.bins
    )  # but at steps


@pytest.mark.parametrize("seed", range(5))
def test_mecanum_wheels_calibrate_along_both_diagonals_within_their_limits(seed: int) -> None:
    """On a diagonal two wheels stand, so that slip never leads the base askew."""
    robot = robot_named("amr_omni")
    _, velocities, track = calibration_motion(np.random.default_rng(seed), Motion.DIAGONALS, 60.0)
    vx, vy, wz = velocities.T
    assert np.hypot(*track.poses[:, :2].T).max() < 2.5
    assert np.allclose(np.abs(vx), np.abs(vy))
    assert not np.any((np.abs(vx) > 0.0) & (np.abs(wz) > 0.0))
    shares = [np.mean(part) for part in (vx * vy > 0, vx * vy < 0, wz != 0)]
    assert shares == pytest.approx([0.25, 0.25, 0.5], abs=0.12)
    limits = robot.model.limits
    assert np.abs(velocities).max(axis=0) == pytest.approx([0.42, 0.42, 0.85], abs=0.01)
    fastest = np.abs(np.diff(velocities, axis=0)).max(axis=0) / 0.005
    assert (fastest <= [limits.ax_max, limits.ay_max, limits.az_max]).all()
    drive = drive_of(robot)
    straight = np.array([drive.rates(BodyVelocity(a, b, 0.0)) for a, b in zip(vx[::50], vy[::50], strict=True)])
    slip = 1.0 + 0.02 * np.random.default_rng(seed).standard_normal(4)
    moved = np.array([drive.motion(rates * slip, 1.0) for rates in straight])
    assert np.abs(moved[:, 0] * vy[::50] - moved[:, 1] * vx[::50]).max() < 1e-9
    assert np.abs(moved[:, 2]).max() > 1e-4  # while the slip is there
