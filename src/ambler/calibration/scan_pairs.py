"""Scans prepared for matching with each other, and relative poses of pairs of them: the measurements of the calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan
from ambler.kernels import scan_pair

F64 = NDArray[np.float64]
CELLS = 1440


@dataclass(frozen=True, slots=True)
class PairConfig:
    """How scans are matched. `gates` (m) shrink from iteration to iteration; lines are fitted to `half_width` beams on each
    side within `radius` (m); a match needs `min_inliers` of its points and a residual below `max_rms` (m)."""

    range_min: float = 0.15
    range_max: float = 20.0
    radius: float = 0.35
    half_width: int = 7
    max_spread: float = 0.025
    huber: float = 0.025
    first_gate: float = 0.3
    last_gate: float = 0.12
    iterations: int = 10
    min_inliers: float = 0.3
    max_rms: float = 0.04
    min_balance: float = 0.01


@dataclass(frozen=True, slots=True)
class PreparedScan:
    """A scan's points float64 (M, 2) in the sensor frame at `middle_s` (its own clock, seconds), fitted lines, bearings."""

    middle_s: float
    points: F64
    lines: F64
    cells: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class PairMatch:
    """target_from_source as float64 (3,) of (x, y, yaw), its information (3, 3) for right perturbations, the residual RMS (m)."""

    target_from_source: F64
    information: F64
    rms: float


def middle_of(scan: LaserScan, origin_ns: int) -> float:
    """Return the instant of a scan's middle beam, seconds after an origin, by the scanner's clock."""
    return (scan.stamp_ns - origin_ns) * 1e-9 + 0.5 * (len(scan.ranges) - 1) * scan.time_increment


def prepare_scan(scan: LaserScan, origin_ns: int, upside_down: bool, twist: F64, config: PairConfig) -> PreparedScan:
    """Move every beam to the scan's middle with the sensor's twist (vx, vy, wz), and fit lines."""
    n = len(scan.ranges)
    points = np.zeros((n, 2))
    beam = np.array([scan.angle_min, scan.angle_increment, scan.time_increment])
    limits = np.array([max(config.range_min, scan.range_min), min(config.range_max, scan.range_max)])
    middle = 0.5 * (n - 1) * scan.time_increment
    sign = -1.0 if upside_down else 1.0
    count = scan_pair.place_scan(scan.ranges, beam, sign, limits, middle, twist, points)
    lines, cells = np.zeros((max(count, 1), 4)), np.empty(CELLS, np.int32)
    points = np.ascontiguousarray(points[: max(count, 1)])
    scan_pair.fit_lines(points, count, config.radius, config.half_width, config.max_spread, lines, cells)
    return PreparedScan(middle_of(scan, origin_ns), points, lines, cells)


def match_pair(
    target: PreparedScan, source: PreparedScan, guess: F64, config: PairConfig, first_gate: float | None = None
) -> PairMatch | None:
    """Match two scans from a guess of target_from_source (x, y, yaw); None when they do not fit or say too little."""
    pose, hessian, stats = np.array(guess, np.float64), np.zeros((3, 3)), np.zeros(5)
    gates = np.geomspace(first_gate or config.first_gate, config.last_gate, config.iterations)
    scan_pair.match_scans(
        *(source.points, source.lines, len(source.points), target.points, target.lines, len(target.points)),
        *(target.cells, gates, config.huber, pose, hessian, stats),
    )
    rms, _, inliers, step, balance = stats
    if inliers < config.min_inliers or rms > config.max_rms or step > 2e-3 or balance < config.min_balance:
        return None
    pose[2] = (pose[2] + math.pi) % (2.0 * math.pi) - math.pi
    return PairMatch(pose, hessian / max(rms, 1e-3) ** 2, float(rms))
