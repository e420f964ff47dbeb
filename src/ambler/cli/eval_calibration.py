"""`ambler eval calibration`: mountings and clock offsets of scanners from simulated drives, against the truth."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import Any

BARS = {"position_error_max_mm": 5.0, "yaw_error_max_deg": 0.1, "offset_error_max_ms": 2.0}


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "calibration", help="mountings and clock offsets of scanners from a minute of driving"
    )
    parser.add_argument("--runs", type=int, default=4, help="random mountings; two-wheeled and omni bases take turns")
    parser.add_argument("--drive", choices=("differential", "omni", "both"), default="both")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each drive")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Calibrate every drive; exit 1 when any error is beyond 5 mm, 0.1° or 2 ms."""
    import numpy as np

    from ambler.core.robot import DriveKind
    from ambler.evaluation.calibration import evaluate_drive, simulate_drive
    from ambler.evaluation.results import write_results

    begin = time.perf_counter()
    kinds = [DriveKind.DIFFERENTIAL, DriveKind.OMNI] if args.drive == "both" else [DriveKind(args.drive)]
    rows, nees = [], []
    for k in range(args.runs):
        kind = kinds[k % len(kinds)]
        errors = evaluate_drive(simulate_drive(args.seed + k, kind, args.seconds))
        rows.append([1e3 * errors.position, math.degrees(errors.yaw), 1e3 * errors.offset])
        nees.append(errors.nees)
        print(
            f"run {k} ({kind.value}): position {rows[-1][0]:.2f} mm, yaw {rows[-1][1]:.3f}°, clock {rows[-1][2]:.2f} ms;"
            f" NEES {errors.nees:.2f}, {errors.result.pairs} pairs of scans, residual {1e3 * errors.result.residual_rms:.1f} mm"
        )
    worst = dict(zip(BARS, np.max(rows, axis=0).tolist(), strict=True))
    within = sum(all(e <= bar for e, bar in zip(row, BARS.values(), strict=True)) for row in rows)
    print(f"{within} of {args.runs} runs within 5 mm, 0.1° and 2 ms")
    fields = {
        "runs": args.runs,
        "within_bars": within,
        **worst,
        "position_error_median_mm": float(np.median(rows, axis=0)[0]),
        "yaw_error_median_deg": float(np.median(rows, axis=0)[1]),
        "offset_error_median_ms": float(np.median(rows, axis=0)[2]),
        "nees_mean": float(np.mean(nees)),
        "drive_seconds": args.seconds,
    }
    if args.json:
        write_results(args.json, "eval calibration", args.seed, time.perf_counter() - begin, fields)
    return 0 if within == args.runs else 1
