"""How exact, how late and how fast the scan merger is, at 1 m/s and 90°/s; its times beside those of NumPy.

Wheels slip and gyroscopes err: the merger is told what the robot's one odometry makes of both, as on the bus. A scanner's own noise is
larger than what motion adds to it, so it is parted: `carry` is how far a return lies from where the true motion had carried that same return.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from ambler.evaluation.merge_timing import time_cloud, time_merge
from ambler.evaluation.merging import NOISY_SCANNER, Wheels, drive_and_merge
from ambler.kernels import cloud_bins, scan_draw, scan_motion, self_mask

BAR_ERROR_M = 0.01
DRIVES = 20  # with wheels, gyroscope and scanners drawn anew
BAR_MS_PER_100K = 2.0


def measure(runs: int, seed: int) -> dict[str, float]:
    """Return the errors and latency of a drive, and times of `runs` repetitions."""
    for module in (self_mask, scan_motion, scan_draw, cloud_bins):
        module.warm_up()
    return _errors(seed) | _times(runs, seed)


def meets_bars(fields: dict[str, float]) -> bool:
    """Whether no point is off by more than 1 cm, with noisy wheels 99 % of them, no scan late by more than one scan, and no merge slower
    than 2 ms."""
    return (
        fields["cloud_error_max_m"] <= BAR_ERROR_M
        and fields["noisy_wheels_carry_p99_m"] <= BAR_ERROR_M
        and fields["scan_error_p99_m"] <= BAR_ERROR_M
        and fields["latency_max_ms"] <= fields["scan_period_ms"]
        and fields["merge_100k_points_fastest_ms"] <= BAR_MS_PER_100K
        and fields["cloud_to_scan_100k_points_fastest_ms"] <= BAR_MS_PER_100K
    )


def _errors(seed: int) -> dict[str, float]:
    moving, blind = (drive_and_merge(seed, wheels) for wheels in (Wheels.EXACT, Wheels.BLIND))
    seeds = range(seed, seed + DRIVES)
    fused, alone = ([drive_and_merge(s, wheels) for s in seeds] for wheels in (Wheels.FUSED, Wheels.ALONE))
    noisy = [drive_and_merge(s, Wheels.FUSED, NOISY_SCANNER) for s in seeds]
    ranges = drive_and_merge(seed, Wheels.EXACT, NOISY_SCANNER)
    return {
        "cloud_error_max_m": float(moving.cloud.max()),
        "cloud_error_rms_m": float(np.sqrt(np.mean(moving.cloud**2))),
        "scan_error_p99_m": float(np.percentile(moving.bins, 99)),
        "scan_error_max_m": float(moving.bins.max()),
        "noisy_wheels_drives": float(DRIVES),
        "noisy_wheels_error_p99_m": _p99([errors.cloud for errors in fused]),
        "noisy_wheels_carry_p99_m": _p99([errors.carry for errors in noisy]),
        "noisy_wheels_carry_p99_worst_m": max(_p99([errors.carry]) for errors in noisy),
        "noisy_wheels_carry_max_m": max(float(errors.carry.max()) for errors in noisy),
        "noisy_wheels_and_ranges_error_p99_m": _p99([errors.cloud for errors in noisy]),
        "noisy_ranges_error_p99_m": _p99([ranges.cloud]),
        "wheels_alone_error_p99_m": _p99([errors.cloud for errors in alone]),
        "uncompensated_error_p99_m": _p99([blind.cloud]),
        "latency_max_ms": 1e3 * float(moving.latency.max()),
        "scan_period_ms": 1e3 * moving.period,
        "merged_scans": float(len(moving.latency)),
    }


def _p99(errors: Sequence[NDArray[np.float64]]) -> float:
    return float(np.percentile(np.concatenate(errors), 99))


def _times(runs: int, seed: int) -> dict[str, float]:
    cases = {
        "three_scans_of_1618_beams": time_merge(1618, runs),
        "merge_100k_points": time_merge(33334, runs),
        "cloud_to_scan_100k_points": time_cloud(100_000, runs, seed),
    }
    fields: dict[str, float] = {}
    for name, (ours, peer) in cases.items():
        fields |= {f"{name}_{key}": value for key, value in asdict(ours).items()}
        fields |= {f"peer_numpy_{name}_{key}": value for key, value in asdict(peer).items()}
        fields[f"ratio_vs_numpy_{name}"] = ours.median_cpu_ms / peer.median_cpu_ms
    return fields
