"""How fast scans are merged and clouds flattened, beside the same work in whole-array NumPy, taken in turn in one run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan, PointCloud
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.evaluation.merging import BODY, SCANNERS, SPEED, TURN
from ambler.perception.cloud_to_scan import CloudToScan, CloudToScanConfig
from ambler.perception.merger import MergerConfig, ScanMerger

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
PERIOD_NS = 40_000_000
SWEEP = 0.038
RANGE_MIN, RANGE_MAX = 0.05, 30.0
TWIST = np.array([SPEED, 0.0, TURN])


@dataclass(frozen=True, slots=True)
class Timing:
    """Wall milliseconds of the fastest and the median repetition, and the median's processor time, which other programs that
    share the machine do not lengthen by taking turns."""

    fastest_ms: float
    median_ms: float
    median_cpu_ms: float


def time_merge(beams_per_scan: int, runs: int) -> tuple[Timing, Timing]:
    """Time the merging of three moving scans of that many beams, and its NumPy peer."""
    merger = ScanMerger(MergerConfig(SCANNERS, self_mask=(BODY,)))
    angles = np.linspace(-2.35, 2.35, beams_per_scan)
    ranges = (5.0 + np.sin(3.0 * angles)).astype(np.float32)
    step, ours, peers = float(angles[1] - angles[0]), [], []
    for run in range(runs + 2):
        begin_ns, now_ns = run * PERIOD_NS, (run + 1) * PERIOD_NS
        for stamp_ns in (begin_ns, begin_ns + PERIOD_NS // 2):
            merger.odometry.add_pose(stamp_ns, SE2.exp(TWIST * stamp_ns * 1e-9))
        for scanner in SCANNERS:
            scan = LaserScan(
                *(begin_ns, scanner.frame, float(angles[0]), step, SWEEP / beams_per_scan, 0.04, RANGE_MIN, RANGE_MAX),
                *(ranges, np.zeros(0, np.float32)),
            )
            merger.add_scan(scan, now_ns)
        if run > 1:
            ours.append(_clock(partial(merger.merge, now_ns)))
            peers.append(_clock(lambda: merge_in_numpy(angles, ranges, bins=merger.config.bins)))
    return _timing(ours), _timing(peers)


def time_cloud(points: int, runs: int, seed: int) -> tuple[Timing, Timing]:
    """Time the flattening of a cloud of that many points while the robot moves, and its NumPy peer."""
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(-math.pi, math.pi, points)
    distance, height = rng.uniform(1.0, 20.0, points), rng.uniform(-0.5, 2.0, points)
    cloud = PointCloud(
        0,
        "lidar",
        np.column_stack([distance * np.cos(azimuth), distance * np.sin(azimuth), height]).astype(np.float32),
        np.zeros(points, np.float32),
        np.linspace(0.0, 0.1, points).astype(np.float32),
        np.zeros(points, np.uint16),
    )
    config, mount = CloudToScanConfig(z_min=0.1, z_max=1.5, self_mask=(BODY,)), SE3((0.0, 0.0, 0.5))
    flattener, ours, peers = CloudToScan(config, mount), [], []
    for run in range(runs + 1):
        samples = _clock(lambda: flattener.update(cloud, TWIST)), _clock(lambda: flatten_in_numpy(cloud, config, mount))
        if run > 0:
            ours.append(samples[0])
            peers.append(samples[1])
    return _timing(ours), _timing(peers)


def merge_in_numpy(angles: F64, ranges: F32, bins: int) -> F64:
    """Move three scans by one twist and keep the nearest return of each bin: float64 ranges (bins,), +inf where none.

    What a merger without joined surfaces, self-mask, sources and cloud has to do at the least.
    """
    nearest = np.full(bins, np.inf)
    times = np.linspace(-SWEEP, 0.0, len(angles))
    hit = (ranges >= RANGE_MIN) & (ranges <= RANGE_MAX)
    for scanner in SCANNERS:
        mount = scanner.base_from_sensor.matrix()
        points = (ranges * np.stack([np.cos(angles), np.sin(angles)])).T @ mount[:2, :2].T + mount[:2, 3]
        _bin_nearest(_carry(points, times, TWIST)[hit], nearest)
    return nearest


def flatten_in_numpy(cloud: PointCloud, config: CloudToScanConfig, mount: SE3) -> F64:
    """Keep the nearest point inside the height band of each bin of a moving cloud: float64 (bins,), +inf where none."""
    nearest = np.full(config.bins, np.inf)
    matrix = mount.matrix()
    points = cloud.points @ matrix[:3, :3].T + matrix[:3, 3]
    moved = _carry(points[:, :2], cloud.time, TWIST)
    distance = np.hypot(moved[:, 0], moved[:, 1])
    kept = (points[:, 2] >= config.z_min) & (points[:, 2] <= config.z_max) & (distance <= config.range_max)
    _bin_nearest(moved[kept & (distance >= config.range_min)], nearest)
    return nearest


def _carry(points: F64, times: NDArray[np.floating], twist: F64) -> F64:
    """Move points (N, 2) that were seen at `times` (N,) by exp(twist * t)."""
    turns = twist[2] * times
    cos, sin = np.cos(turns), np.sin(turns)
    x = cos * points[:, 0] - sin * points[:, 1] + (twist[0] * sin - twist[1] * (1.0 - cos)) / twist[2]
    y = sin * points[:, 0] + cos * points[:, 1] + (twist[1] * sin + twist[0] * (1.0 - cos)) / twist[2]
    return np.column_stack([x, y])


def _bin_nearest(points: F64, nearest: F64) -> None:
    bins = len(nearest)
    places = np.rint((np.arctan2(points[:, 1], points[:, 0]) / (2.0 * math.pi) + 0.5) * bins).astype(np.int64) % bins
    np.minimum.at(nearest, places, np.hypot(points[:, 0], points[:, 1]))


def _clock(work: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.thread_time()
    work()
    return time.perf_counter() - wall, time.thread_time() - cpu


def _timing(samples: list[tuple[float, float]]) -> Timing:
    wall, cpu = 1e3 * np.array(samples).T
    return Timing(float(wall.min()), float(np.median(wall)), float(np.median(cpu)))
