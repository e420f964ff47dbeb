"""Rays of scans: what belongs to a return stays with it, and every ray starts where its scanner was when it measured."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambler.core.messages import LaserScan, PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.grids.probability_grid import Inserter, InsertionConfig, ProbabilityGrid
from ambler.perception.merger import AngleWindow, MergerConfig, MergeResult, ScanMerger, ScannerConfig
from ambler.perception.planar import PlanarConfig, merged_to_points, scan_to_points
from ambler.registration.planar_scan import PlanarScan

MS = 1_000_000
STILL = np.zeros(3)
MOUNTS = (SE2(0.5, 0.4, 0.0), SE2(-0.5, -0.4, 0.0))
OFFSETS = np.array([[m.x, m.y] for m in MOUNTS])
CONFIG = PlanarConfig(range_max=20.0)


def laser(
    ranges: np.ndarray, frame: str = "laser", stamp_ns: int = 0, step: float = 0.0, bright: bool = False
) -> LaserScan:
    n = len(ranges)
    intensities = np.arange(n, dtype=np.float32) if bright else np.zeros(0, np.float32)
    return LaserScan(
        stamp_ns, frame, -math.pi, 2 * math.pi / n, step, 0.1, 0.1, 30.0, ranges.astype(np.float32), intensities
    )


def test_intensities_stay_with_their_returns_through_every_filter() -> None:
    ranges = np.full(360, 4.0)
    ranges[10:20], ranges[50:60], ranges[100:110] = np.nan, 0.01, np.inf
    scan = scan_to_points(laser(ranges, bright=True), SE3.from_se2(SE2(0.3, 0.0, 0.5)), STILL, CONFIG)
    assert scan.intensities is not None
    assert len(scan.intensities) == len(scan.points) == 330
    at = np.isfinite(ranges) & (ranges > 0.1)
    np.testing.assert_array_equal(scan.intensities, np.flatnonzero(at))
    angle = -math.pi + scan.intensities * (2 * math.pi / 360) + 0.5
    np.testing.assert_allclose(scan.points, np.stack([0.3 + 4 * np.cos(angle), 4 * np.sin(angle)], 1), atol=1e-5)
    thin = scan.thinned(0.5)
    assert thin.intensities is not None
    assert 10 < len(thin.points) < 100
    rows = [int(np.flatnonzero((scan.points == p).all(axis=1))[0]) for p in thin.points]
    np.testing.assert_array_equal(thin.intensities, scan.intensities[rows])


def test_a_scan_without_intensities_has_none() -> None:
    assert scan_to_points(laser(np.ones(8)), SE3(), STILL, CONFIG).intensities is None


def test_a_moving_scanner_starts_every_ray_where_it_was() -> None:
    twist, step = np.array([1.0, 0.0, 0.8]), 0.1 / 360
    ranges = np.full(360, 5.0)
    ranges[::7] = np.inf
    scan = scan_to_points(laser(ranges, step=step), SE3.from_se2(SE2(0.3, 0.1, 0.0)), twist, CONFIG)
    starts, free_starts = scan.ray_starts()
    hits = np.flatnonzero(np.isfinite(ranges))
    for row, beam in ((0, hits[0]), (100, hits[100]), (len(hits) - 1, hits[-1])):
        at = SE2.exp(twist * beam * step).transform(np.array([[0.3, 0.1]]))[0]
        np.testing.assert_allclose(starts[row], at, atol=1e-4)
        assert math.dist(starts[row], scan.points[row]) == pytest.approx(5.0, abs=1e-4)
    np.testing.assert_allclose(np.hypot(*(free_starts - scan.free_points).T), 5.0, atol=1e-4)


BLOCK = (1.0, -0.3, 2.0, 0.3)  # x0, y0, x1, y1: it stands before the base, where neither scanner looks
WALL = 8.0
OUTER = (SE2(0.0, 1.5, 0.0), SE2(0.0, -1.5, 0.0))


def distance(start: np.ndarray, direction: np.ndarray) -> float:
    """Distance along a ray to the block or to the wall behind it."""
    with np.errstate(divide="ignore"):
        a = (np.array(BLOCK[:2]) - start) / direction
        b = (np.array(BLOCK[2:]) - start) / direction
    low, high = np.minimum(a, b).max(), np.maximum(a, b).min()
    if 0.0 < low <= high:
        return float(low)
    return float((WALL - start[0]) / direction[0]) if direction[0] > 0.0 else math.inf


def past_a_block() -> MergeResult:
    """Two scanners that look forward by 20° to either side see the wall past the block, from both sides of it."""
    window = AngleWindow(-0.35, 0.35)
    scanners = tuple(ScannerConfig.planar(f"s{k}", m, z=0.2, windows=(window,)) for k, m in enumerate(OUTER))
    merger = ScanMerger(MergerConfig(scanners))
    for k in range(3):
        merger.odometry.add_pose(k * 20 * MS, SE2())
    angles = -math.pi + 2 * math.pi * np.arange(1440) / 1440
    for k, mount in enumerate(OUTER):
        start = np.array([mount.x, mount.y])
        ranges = np.array([distance(start, np.array([math.cos(a), math.sin(a)])) for a in angles])
        merger.add_scan(laser(ranges, f"s{k}", 20 * MS), 30 * MS)
    return merger.merge(30 * MS)


def free_inside_the_block(scan: PlanarScan) -> int:
    """Count the free cells that lie inside the block."""
    grid = ProbabilityGrid(0.05, (0.0, 0.0), 20.0)
    starts, free_starts = scan.ray_starts()
    Inserter(InsertionConfig(p_miss=0.4)).insert(grid, starts, scan.points, scan.free_points, free_starts)
    rows, columns = np.nonzero((grid.cells > 0) & (grid.cells < 16384))
    assert len(rows) > 5000
    x, y = grid.frame[1] + (columns + 0.5) * 0.05, grid.frame[2] + (rows + 0.5) * 0.05
    return int(np.count_nonzero((x > BLOCK[0]) & (x < BLOCK[2]) & (y > BLOCK[1]) & (y < BLOCK[3])))


def test_nothing_is_free_where_no_scanner_looked() -> None:
    merged = past_a_block()
    assert set(merged.cloud.ring.tolist()) == {0, 1}
    own = merged_to_points(merged.cloud, merged.free, np.array([[m.x, m.y] for m in OUTER]), STILL, CONFIG)
    virtual = scan_to_points(merged.scan, SE3(), STILL, CONFIG)
    assert free_inside_the_block(own) == 0
    assert free_inside_the_block(virtual) > 100  # rays from the middle of the robot lead through the block


def test_rays_of_merged_scans_start_where_the_scanner_was_then() -> None:
    twist = np.array([0.9, -0.2, 0.6])
    n = 50
    time, ring = np.linspace(-0.15, 0.0, n).astype(np.float32), (np.arange(n) % 2).astype(np.uint16)
    ends = np.zeros((n, 3), np.float32)
    ends[:, 0], ends[:, 1] = 8.0, np.linspace(-6.0, 6.0, n)
    cloud = PointCloud(0, "base", ends, np.arange(n, dtype=np.float32), time, ring)
    scan = merged_to_points(cloud, None, OFFSETS, twist, CONFIG)
    assert scan.starts is not None
    for k in range(n):
        at = SE2.exp(twist * float(time[k])).transform(OFFSETS[ring[k]][None])[0]
        np.testing.assert_allclose(scan.starts[k], at, atol=1e-6)
    np.testing.assert_array_equal(scan.intensities, np.arange(n))


def test_returns_beyond_the_range_are_free_as_far_as_believed() -> None:
    ends = np.array([[30.5, 0.4, 0.2], [0.55, 0.4, 0.2], [9.5, 0.4, 0.2]], np.float32)
    three = np.zeros(3, np.float32)
    cloud = PointCloud(0, "base", ends, three, three, np.zeros(3, np.uint16))
    free = PointCloud(0, "base", ends[2:], three[:1], three[:1], np.ones(1, np.uint16))
    scan = merged_to_points(cloud, free, OFFSETS, STILL, CONFIG)
    np.testing.assert_allclose(scan.points, [[9.5, 0.4]])  # the second is nearer than 0.1 m to its scanner
    np.testing.assert_allclose(scan.free_points[0], [5.5, 0.4], atol=1e-6)
    assert math.dist(scan.free_points[1], OFFSETS[1]) == pytest.approx(5.0, abs=1e-5)
