"""The merger against exact geometry: a robot that drives and turns while three scanners sweep, judged at the common time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.se2 import SE2
from ambler.perception.merger import (
    MergerConfig,
    MergeResult,
    ScanMerger,
    ScannerConfig,
)
from tests.perception.flatland import Beams, Flatland, Trajectory, constant_twist, room, take_scan

MOUNTS = (SE2(0.5, -0.35, -math.pi / 4), SE2(0.5, 0.35, math.pi / 4), SE2(-0.5, 0.0, math.pi))
FRAMES = ("front_right", "front_left", "back")


def config_of(mounts: tuple[SE2, ...] = MOUNTS, **changes: object) -> MergerConfig:
    scanners = tuple(ScannerConfig.planar(f, m, 0.2) for f, m in zip(FRAMES, mounts, strict=False))
    return MergerConfig(**{"scanners": scanners, **changes})  # type: ignore[arg-type]


def feed_odometry(merger: ScanMerger, trajectory: Trajectory, begin: float = -0.5, end: float = 0.5) -> None:
    for stamp_ns in range(round(begin * 1e9), round(end * 1e9) + 1, 20_000_000):
        merger.odometry.add_pose(stamp_ns, trajectory(stamp_ns * 1e-9))


def merge_moving(
    world: Flatland,
    trajectory: Trajectory,
    config: MergerConfig,
    phases: tuple[float, ...],
    upside_down: tuple[bool, ...] = (False, False, False),
    beams: Beams = Beams(),  # noqa: B008
) -> MergeResult:
    merger = ScanMerger(config)
    feed_odometry(merger, trajectory)
    arrivals = []
    for scanner, begin, over in zip(config.scanners, phases, upside_down, strict=True):
        mount = scanner.base_from_sensor.to_se2()
        scan = take_scan(world, trajectory, mount, begin, beams, scanner.frame, over)
        arrivals.append((round((begin + beams.count * beams.interval) * 1e9) + 1_000_000, scan))
    for now_ns, scan in sorted(arrivals, key=lambda a: a[0]):
        assert not merger.is_due(now_ns)
        merger.add_scan(scan, now_ns)
    assert merger.is_due(now_ns)
    return merger.merge(now_ns)


def cloud_errors(world: Flatland, trajectory: Trajectory, result: MergeResult) -> np.ndarray:
    world_from_base = trajectory(result.cloud.stamp_ns * 1e-9)
    return world.distance_to_surface(world_from_base.transform(result.cloud.points[:, :2]))


def bin_errors(world: Flatland, trajectory: Trajectory, result: MergeResult, origin: SE2 = SE2()) -> np.ndarray:
    """Distance from each filled bin's end to the true surfaces at the stamp."""
    scan = result.scan
    angles = scan.angle_min + np.arange(len(scan.ranges)) * scan.angle_increment
    hit = np.isfinite(scan.ranges)
    ends = scan.ranges[hit, None] * np.column_stack([np.cos(angles[hit]), np.sin(angles[hit])])
    world_from_origin = trajectory(scan.stamp_ns * 1e-9) @ origin
    return world.distance_to_surface(world_from_origin.transform(ends))


@pytest.mark.parametrize("velocity", [(1.0, 0.0, math.pi / 2), (0.7, 0.7, -math.pi / 2), (0.0, 0.0, 0.0)])
def test_error_stays_below_a_centimetre_at_full_speed(velocity: tuple[float, float, float]) -> None:
    world, trajectory = room(), constant_twist(*velocity)
    result = merge_moving(world, trajectory, config_of(), (0.0, 0.031, 0.067))
    assert cloud_errors(world, trajectory, result).max() < 1e-4
    errors = bin_errors(world, trajectory, result)
    assert np.percentile(errors, 99) < 0.01
    assert errors.max() < 0.03
    assert np.isfinite(result.scan.ranges).mean() > 0.97
    assert result.scan.time_increment == 0.0


def test_without_odometry_motion_the_same_scans_miss_by_centimetres() -> None:
    world, trajectory = room(), constant_twist(1.0, 0.0, math.pi / 2)
    merger = ScanMerger(config_of())
    feed_odometry(merger, constant_twist(0.0, 0.0, 0.0))
    for frame, mount, begin in zip(FRAMES, MOUNTS, (0.0, 0.031, 0.067), strict=True):
        merger.add_scan(take_scan(world, trajectory, mount, begin, frame=frame), 160_000_000)
    result = merger.merge(160_000_000)
    assert np.percentile(cloud_errors(world, trajectory, result), 95) > 0.1


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    speed=st.floats(-1.0, 1.0),
    sideways=st.floats(-1.0, 1.0),
    turn=st.floats(-math.pi / 2, math.pi / 2),
)
def test_any_mounting_and_motion(seed: int, speed: float, sideways: float, turn: float) -> None:
    rng = np.random.default_rng(seed)
    world, trajectory = room(), constant_twist(speed, sideways, turn)
    upside_down = tuple(bool(b) for b in rng.integers(0, 2, 3))
    scanners = tuple(
        ScannerConfig.planar(f, SE2(*rng.uniform(-0.6, 0.6, 2), rng.uniform(-math.pi, math.pi)), 0.1, upside_down=over)
        for f, over in zip(FRAMES, upside_down, strict=True)
    )
    origin = SE2(*rng.uniform(-0.4, 0.4, 2), rng.uniform(-math.pi, math.pi))
    phases = tuple(rng.uniform(0.0, 0.08, 3))
    result = merge_moving(
        world, trajectory, MergerConfig(scanners, base_from_origin=origin, bins=720), phases, upside_down
    )
    assert cloud_errors(world, trajectory, result).max() < 1e-4
    errors = bin_errors(world, trajectory, result, origin)
    assert np.percentile(errors, 98) < 0.01
    assert errors.max() < 0.06
    angles = result.scan.angle_min + np.arange(720) * result.scan.angle_increment
    heading = (trajectory(result.scan.stamp_ns * 1e-9) @ origin).as_array()
    directions = np.column_stack([np.cos(angles + heading[2]), np.sin(angles + heading[2])])
    truth = world.cast(np.repeat(heading[None, :2], 720, axis=0), directions)
    hit = np.isfinite(result.scan.ranges)
    assert np.median(np.abs(result.scan.ranges[hit] - truth[hit])) < 1e-3
