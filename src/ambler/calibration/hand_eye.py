"""A first guess of a scanner's mounting and clock offset from its own motion and the odometry, without any prior knowledge.

The scanner's motion comes from matching its scans one after the other. Its rotation equals that of the base, which gives the
clock offset; then A X = X B in the plane is linear in the lever arm and in (cos, sin) of the mounting angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.calibration import planar_arrays as se2
from ambler.calibration.scan_pairs import PairConfig, PreparedScan, match_pair, prepare_scan
from ambler.core.errors import AmblerError
from ambler.core.messages import LaserScan

F64 = NDArray[np.float64]


class CalibrationError(AmblerError):
    """The recording does not tell the mounting; the text says of which scanner and why."""

    code = "CALIBRATION_FAILED"


@dataclass(frozen=True, slots=True)
class ScannerMotion:
    """Motion of one scanner from scan to scan: middles (K,) s by its own clock; `steps` (K - 1, 3) previous_from_next, NaN where
    two scans did not match."""

    middles: F64
    steps: F64


@dataclass(frozen=True, slots=True)
class HandEyeGuess:
    """base_from_scanner (x, y, yaw), and what the scanner's clock is ahead of the odometry's, seconds."""

    base_from_scanner: F64
    clock_offset: float


def track_scanner(
    scans: Sequence[LaserScan], origin_ns: int, upside_down: bool, odometry: se2.PlanarTrack, config: PairConfig
) -> ScannerMotion:
    """Match each scan with the one before; the odometry's rotation and the last velocity are the guess."""
    previous: PreparedScan | None = None
    velocity = np.zeros(2)
    middles, steps = np.zeros(len(scans)), np.full((max(len(scans) - 1, 0), 3), np.nan)
    for k, scan in enumerate(scans):
        middle = (scan.stamp_ns - origin_ns) * 1e-9
        turn = float(odometry.twist_at(np.array([middle]))[0, 2])
        current = prepare_scan(scan, origin_ns, upside_down, np.array([*velocity, turn]), config)
        middles[k] = current.middle_s
        if previous is not None:
            seconds = current.middle_s - previous.middle_s
            guess = se2.exp(np.array([*velocity, turn]) * seconds)
            match = match_pair(previous, current, guess, config, first_gate=1.0) if seconds < 1.0 else None
            if match is None:
                velocity = np.zeros(2)
            else:
                steps[k - 1] = match.target_from_source
                velocity = se2.log(match.target_from_source)[:2] / seconds
        previous = current
    return ScannerMotion(middles, steps)


def guess_mounting(
    frame: str, motion: ScannerMotion, odometry: se2.PlanarTrack, largest_offset: float, window: int = 6
) -> HandEyeGuess:
    """Return the first guess; raises CalibrationError when too few scans match or the motion tells too little."""
    good = np.isfinite(motion.steps[:, 0])
    if good.sum() < 30 or good.mean() < 0.5:
        raise CalibrationError(f"scanner {frame}: only {int(good.sum())} of {len(good)} scans match the one before")
    if np.ptp(odometry.poses[:, 2]) < 0.5 and np.abs(motion.steps[good, 2]).sum() < 1.0:
        raise CalibrationError(f"scanner {frame}: the robot hardly turned; drive curves in both directions")
    offset = _find_offset(motion, good, odometry, largest_offset)
    base, sensor = _windows(motion, good, odometry, offset, window)
    c, s = np.cos(sensor[:, 2]), np.sin(sensor[:, 2])
    rows = np.zeros((2 * len(base), 4))
    rows[0::2] = np.column_stack([c - 1.0, -s, -sensor[:, 0], sensor[:, 1]])
    rows[1::2] = np.column_stack([s, c - 1.0, -sensor[:, 1], -sensor[:, 0]])
    solution, _, rank, _ = np.linalg.lstsq(rows, -base[:, :2].reshape(-1), rcond=1e-4)
    norm = float(np.hypot(solution[2], solution[3]))
    if rank < 4 or not 0.6 < norm < 1.6:
        raise CalibrationError(
            f"scanner {frame}: its motion does not fit the odometry (scale {norm:.2f}); drive and turn in both directions"
        )
    return HandEyeGuess(np.array([solution[0], solution[1], np.arctan2(solution[3], solution[2])]), offset)


def _find_offset(motion: ScannerMotion, good: NDArray[np.bool_], odometry: se2.PlanarTrack, largest: float) -> float:
    """Shift the odometry's rotation until it fits the scanner's best; refined with a parabola."""
    begin, end, turned = motion.middles[:-1][good], motion.middles[1:][good], motion.steps[good, 2]

    def misfit(offset: float) -> float:
        wanted = se2.wrap(odometry.at(end - offset)[:, 2] - odometry.at(begin - offset)[:, 2])
        scale = float(wanted @ turned) / max(float(wanted @ wanted), 1e-9)
        return float(np.sum((turned - scale * wanted) ** 2))

    step = 0.01
    offsets = np.arange(-largest, largest + step, step)
    costs = np.array([misfit(float(o)) for o in offsets])
    k = min(max(int(np.argmin(costs)), 1), len(offsets) - 2)
    left, centre, right = costs[k - 1 : k + 2]
    curve = left - 2.0 * centre + right
    return float(offsets[k] + (0.5 * step * (left - right) / curve if curve > 0 else 0.0))


def _windows(
    motion: ScannerMotion, good: NDArray[np.bool_], odometry: se2.PlanarTrack, offset: float, window: int
) -> tuple[F64, F64]:
    """Return base and scanner motions over `window` steps without gaps, float64 (M, 3) each."""
    count = len(motion.steps) - window + 1
    whole = np.array([good[k : k + window].all() for k in range(count)], np.bool_)
    starts = np.nonzero(whole)[0]
    sensor = np.zeros((len(starts), 3))
    for j in range(window):
        sensor = se2.compose(sensor, motion.steps[starts + j])
    begin, end = motion.middles[starts] - offset, motion.middles[starts + window] - offset
    return se2.compose(se2.inverse(odometry.at(begin)), odometry.at(end)), sensor
