"""The merger against exact geometry: a robot that drives and turns while three scanners sweep, judged at the common time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.core.errors import BadInputError, StaleInputError
from ambler.core.messages import LaserScan
from ambler.core.se2 import SE2
from ambler.perception.array_pool import ArrayPool
from ambler.perception.merger import AngleWindow, MergerConfig, MergeResult, ScanMerger, ScannerConfig, SourceState
from tests.perception.flatland import Beams, Flatland, Trajectory, constant_twist, room, take_scan

MOUNTS = (SE2(0.5, -0.35, -math.pi / 4), SE2(0.5, 0.35, math.pi / 4), SE2(-0.5, 0.0, math.pi))
IDENTITY = SE2()
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


def bin_errors(world: Flatland, trajectory: Trajectory, result: MergeResult, origin: SE2 = IDENTITY) -> np.ndarray:
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


def still_merger(config: MergerConfig) -> ScanMerger:
    merger = ScanMerger(config)
    feed_odometry(merger, constant_twist(0.0, 0.0, 0.0), -0.1, 1.8)
    return merger


def flat_scan(
    frame: str, ranges: list[float] | np.ndarray, begin: float = 0.0, step_deg: float = 1.0, start_deg: float = 0.0
) -> LaserScan:
    return LaserScan(
        round(begin * 1e9),
        frame,
        math.radians(start_deg),
        math.radians(step_deg),
        0.0,
        0.1,
        0.05,
        10.0,
        np.asarray(ranges, np.float32),
        np.zeros(0, np.float32),
    )


def bin_at(result: MergeResult, deg: float) -> float:
    bins = len(result.scan.ranges)
    return float(result.scan.ranges[round((deg + 180.0) / 360.0 * bins) % bins])


def test_empty_blocked_and_unseen_bins_are_kept_apart() -> None:
    config = config_of(
        (IDENTITY,), bins=360, self_mask=(np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]),)
    )
    merger = still_merger(config)
    ranges = np.full(181, np.inf)
    ranges[40:60] = 2.0
    ranges[80:90] = 0.3  # the robot itself
    ranges[100:110] = np.nan
    ranges[120:130] = 0.01  # nearer than range_min
    ranges[140:150] = 10.5  # beyond range_max: nothing in range
    merger.add_scan(flat_scan(FRAMES[0], ranges), 0)
    result = merger.merge(0)
    assert bin_at(result, 50) == pytest.approx(2.0, abs=1e-3)
    assert bin_at(result, 20) == math.inf
    assert bin_at(result, 145) == math.inf
    for unseen in (85, 105, 125, -90):
        assert math.isnan(bin_at(result, unseen))
    report = result.sources[0]
    assert (report.returns, report.masked, report.invalid, report.empty) == (20, 10, 20, 131)


@pytest.mark.parametrize(
    ("window", "kept"),
    [
        (AngleWindow(math.radians(30), math.radians(60)), lambda d: 30 <= d <= 60),
        (AngleWindow(math.radians(30), math.radians(60), inverse=True), lambda d: not 30 <= d <= 60),
        (AngleWindow(math.radians(150), math.radians(-150)), lambda d: d >= 150 or d <= -150),
        (AngleWindow(-math.pi, math.pi), lambda d: True),
    ],
)
def test_angle_windows(window: AngleWindow, kept: object) -> None:
    scanner = ScannerConfig.planar(FRAMES[0], IDENTITY, windows=(window,))
    merger = still_merger(MergerConfig((scanner,), bins=360))
    merger.add_scan(flat_scan(FRAMES[0], np.full(360, 3.0), start_deg=-180), 0)
    result = merger.merge(0)
    expected = sum(kept(d) for d in range(-180, 180))  # type: ignore[operator]
    assert result.sources[0].returns == expected
    assert result.sources[0].outside_window == 360 - expected
    angles = np.degrees(np.arctan2(result.cloud.points[:, 1], result.cloud.points[:, 0]))
    assert all(kept(round(float(d))) for d in angles)  # type: ignore[operator]


def test_a_scanner_upside_down_sees_its_first_beam_on_the_left() -> None:
    scanner = ScannerConfig.planar(FRAMES[0], SE2(0.2, 0.1, 0.0), 0.4, upside_down=True)
    merger = still_merger(MergerConfig((scanner,)))
    merger.add_scan(flat_scan(FRAMES[0], [2.0], start_deg=-90.0), 0)
    np.testing.assert_allclose(merger.merge(0).cloud.points, [[0.2, 2.1, 0.4]], atol=1e-6)


def test_the_nearest_return_of_a_bin_wins_whichever_scanner_saw_it() -> None:
    config = config_of((SE2(0.0, 0.5, 0.0), SE2(0.0, -0.5, 0.0)), bins=360)
    for near_frame, far_frame in ((0, 1), (1, 0)):
        merger = still_merger(config)
        reach = {near_frame: 1.0, far_frame: 4.0}
        for k in (0, 1):
            mount = config.scanners[k].base_from_sensor.translation
            direction = math.degrees(math.atan2(-mount[1], reach[k]))
            merger.add_scan(flat_scan(FRAMES[k], [math.hypot(reach[k], mount[1])], start_deg=direction), 0)
        result = merger.merge(0)
        assert bin_at(result, 0.0) == pytest.approx(1.0, abs=1e-6)
        assert result.bin_source[180] == near_frame
        assert sorted(result.cloud.ring.tolist()) == [0, 1]


def test_points_remember_their_source_intensity_and_instant() -> None:
    world, trajectory = room(), constant_twist(0.5, 0.0, 0.5)
    merger = ScanMerger(config_of())
    feed_odometry(merger, trajectory)
    begins = (0.0, 0.031, 0.067)
    for k, (mount, begin) in enumerate(zip(MOUNTS, begins, strict=True)):
        scan = take_scan(world, trajectory, mount, begin, frame=FRAMES[k])
        object.__setattr__(scan, "intensities", np.full(len(scan.ranges), 10.0 * (k + 1), np.float32))
        merger.add_scan(scan, 160_000_000)
    result = merger.merge(160_000_000)
    np.testing.assert_array_equal(result.cloud.intensity, 10.0 * (result.cloud.ring + 1.0))
    won = result.bin_source >= 0
    np.testing.assert_array_equal(result.scan.intensities[won], 10.0 * (result.bin_source[won] + 1.0))
    assert set(result.bin_source[won].tolist()) == {0, 1, 2}
    for k, begin in enumerate(begins):
        first = result.cloud.time[result.cloud.ring == k][0]
        assert first == pytest.approx(begin - result.scan.stamp_ns * 1e-9, abs=1e-6)


def test_a_thin_pole_between_two_bin_centres_is_not_lost() -> None:
    merger = still_merger(config_of((IDENTITY,), bins=90))
    ranges = np.full(41, np.inf)
    ranges[18:20] = 1.5  # 1.8° and 1.9°: between the centres 0° and 4°
    merger.add_scan(flat_scan(FRAMES[0], ranges, step_deg=0.1), 0)
    hits = np.isfinite(merger.merge(0).scan.ranges)
    assert hits.sum() == 1


def test_a_surface_nearer_to_the_virtual_origin_has_no_holes() -> None:
    """Beams 2° apart leave holes in 0.25° bins unless the surface between them is drawn."""
    world = Flatland(np.array([[2.0, -3.0, 2.0, 3.0]]), np.zeros((0, 3)))
    still = constant_twist(0.0, 0.0, 0.0)
    mount = SE2(-2.0, 0.0, 0.0)
    beams = Beams(count=46, angle_min=-math.radians(45), step=math.radians(2.0), interval=0.0)
    merger = still_merger(config_of((mount,), bins=1440))
    merger.add_scan(take_scan(world, still, mount, 0.0, beams, FRAMES[0]), 0)
    ranges = merger.merge(0).scan.ranges
    centre = ranges[720 - 160 : 720 + 161]  # ±40°
    angles = np.radians(np.arange(-160, 161) * 0.25)
    np.testing.assert_allclose(centre, 2.0 / np.cos(angles), atol=1e-5)


def test_a_step_in_depth_is_not_joined() -> None:
    merger = still_merger(config_of((SE2(0.0, 0.0, 0.0),), bins=3600))
    merger.add_scan(flat_scan(FRAMES[0], [2.0] * 10 + [2.6] * 10), 0)
    ranges = merger.merge(0).scan.ranges
    hit = ranges[np.isfinite(ranges)]
    assert ((hit < 2.02) | (hit > 2.58)).all()


def test_stale_and_silent_sources_are_dropped_and_reported() -> None:
    merger = still_merger(config_of(max_age=0.25))
    merger.add_scan(flat_scan(FRAMES[0], [2.0] * 5, 0.0), 0)
    merger.add_scan(flat_scan(FRAMES[1], [3.0] * 5, 0.0), 0)
    assert not merger.is_due(50_000_000)  # the third may still come
    assert merger.is_due(100_000_000)  # a scan waits one period at most
    result = merger.merge(100_000_000)
    assert [r.state for r in result.sources] == [SourceState.FRESH, SourceState.FRESH, SourceState.SILENT]
    assert result.latency == pytest.approx(0.1)
    merger.add_scan(flat_scan(FRAMES[0], [2.0] * 5, 0.2), 200_000_000)
    result = merger.merge(200_000_000)
    assert [r.state for r in result.sources] == [SourceState.FRESH, SourceState.REUSED, SourceState.SILENT]
    merger.add_scan(flat_scan(FRAMES[0], [2.0] * 5, 0.3), 300_000_000)
    assert merger.is_due(300_000_000)  # nobody waits for a stale source
    result = merger.merge(300_000_000)
    assert [r.state for r in result.sources] == [SourceState.FRESH, SourceState.STALE, SourceState.SILENT]
    assert result.sources[1].is_dropped
    assert set(result.cloud.ring.tolist()) == {0}
    with pytest.raises(StaleInputError, match=r"no scanner has sent a scan in the last 0\.25 s"):
        merger.merge(600_000_000)


def test_stamps_always_increase_and_latency_stays_below_one_scan() -> None:
    merger = still_merger(config_of())
    stamps, latencies = [], []
    events = sorted((0.1 * n + 0.033 * k, k) for n in range(18) for k in range(3))
    for begin, k in events:
        now_ns = round((begin + 0.001) * 1e9)
        merger.add_scan(flat_scan(FRAMES[k], [2.0] * 5, begin), now_ns)
        if merger.is_due(now_ns):
            result = merger.merge(now_ns)
            stamps.append(result.scan.stamp_ns)
            latencies.append(result.latency)
    assert len(stamps) == 18
    assert (np.diff(stamps) > 0).all()
    assert max(latencies) < 0.1


def test_clock_offset_is_taken_back() -> None:
    world, trajectory = room(), constant_twist(1.0, 0.0, math.pi / 2)
    scanner = ScannerConfig.planar(FRAMES[0], MOUNTS[0], clock_offset=0.05)
    merger = ScanMerger(MergerConfig((scanner,)))
    feed_odometry(merger, trajectory)
    merger.add_scan(take_scan(world, trajectory, MOUNTS[0], 0.0, frame=FRAMES[0], clock_offset=0.05), 160_000_000)
    result = merger.merge(160_000_000)
    assert cloud_errors(world, trajectory, result).max() < 1e-4


def test_missing_odometry_is_a_named_failure() -> None:
    merger = ScanMerger(config_of((IDENTITY,)))
    merger.add_scan(flat_scan(FRAMES[0], [2.0] * 5), 0)
    with pytest.raises(StaleInputError, match="no odometry yet"):
        merger.merge(0)
    merger.odometry.add_pose(-900_000_000, IDENTITY)
    merger.odometry.add_pose(-800_000_000, IDENTITY)
    with pytest.raises(StaleInputError, match=r"odometry ends 0\.800 s before"):
        merger.merge(0)


def test_wrong_configurations_are_refused() -> None:
    with pytest.raises(BadInputError, match="at least one scanner"):
        MergerConfig(())
    with pytest.raises(BadInputError, match="share a frame"):
        MergerConfig((ScannerConfig.planar("a", IDENTITY), ScannerConfig.planar("a", IDENTITY)))
    with pytest.raises(BadInputError, match="no scanner 'x'"):
        ScanMerger(config_of()).add_scan(flat_scan("x", [1.0]), 0)
    with pytest.raises(BadInputError, match="at least three finite corners"):
        ScanMerger(config_of(self_mask=(np.zeros((2, 2)),)))


def test_same_input_gives_the_same_bytes() -> None:
    world, trajectory = room(), constant_twist(0.3, 0.2, 1.0)
    first, second = (merge_moving(world, trajectory, config_of(), (0.0, 0.03, 0.06)) for _ in range(2))
    assert first.scan.ranges.tobytes() == second.scan.ranges.tobytes()
    assert first.cloud.points.tobytes() == second.cloud.points.tobytes()


def test_a_kept_result_never_changes_while_its_memory_is_pooled() -> None:
    merger = still_merger(config_of((IDENTITY,), bins=360))
    merger.add_scan(flat_scan(FRAMES[0], np.full(90, 2.0)), 0)
    kept = merger.merge(0).cloud.points
    before = kept.copy()
    for k in range(1, 5):
        merger.add_scan(flat_scan(FRAMES[0], np.full(90, 2.0 + k), begin=0.1 * k), k * 100_000_000)
        newest = merger.merge(k * 100_000_000).cloud.points
        assert not np.shares_memory(kept, newest)
        np.testing.assert_allclose(np.hypot(newest[:, 0], newest[:, 1]), 2.0 + k, rtol=1e-6)
    np.testing.assert_array_equal(kept, before)


def test_a_pool_hands_an_array_out_again_only_when_no_view_of_it_lives() -> None:
    pool = ArrayPool()
    address = pool.take((4, 3), np.float32).ctypes.data
    first = pool.take((4, 3), np.float32)
    assert first.ctypes.data == address
    view = first[:2, 1:]
    del first
    second = pool.take((4, 3), np.float32)
    assert not np.shares_memory(view, second)
    assert pool.take((4, 3), np.float64).dtype == np.float64
