"""`ambler eval calibration`: mountings and clock offsets of scanners from simulated drives, against the truth."""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambler.cli.run_options import add_settings, study_settings

if TYPE_CHECKING:
    from ambler.evaluation.calibration import CalibrationDrive

BARS = {"position_error_max_mm": 5.0, "yaw_error_max_deg": 0.1, "offset_error_max_ms": 2.0}


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "calibration", help="mountings and clock offsets of scanners from a minute of driving"
    )
    parser.add_argument("--runs", type=int, default=10, help="random mountings (default: 10)")
    parser.add_argument(
        "--robot",
        default="amr_omni",
        help="a robot whose scanners sit a little beside their drawing, or `differential`, `omni`: a base with three scanners"
        " anywhere (default: amr_omni)",
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each drive")
    parser.add_argument("--seed", type=int, default=0)
    add_settings(parser)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Calibrate every drive; exit 1 when any error is beyond 5 mm, 0.1° or 2 ms."""
    import numpy as np

    from ambler.apps.config import recorded_config
    from ambler.evaluation.calibration import evaluate_drive
    from ambler.evaluation.results import write_results

    config = recorded_config(study_settings(args, takes_faults=False).profile).calibration
    begin = time.perf_counter()
    rows, nees = [], []
    for k in range(args.runs):
        errors = evaluate_drive(_drive(args.robot, args.seed + k, args.seconds), config)
        rows.append([1e3 * errors.position, math.degrees(errors.yaw), 1e3 * errors.offset])
        nees.append(errors.nees)
        print(
            f"seed {args.seed + k}: position {rows[-1][0]:.2f} mm, yaw {rows[-1][1]:.3f}°, clock {rows[-1][2]:.2f} ms;"
            f" NEES {errors.nees:.2f}, {errors.result.pairs} pairs of scans, residual {1e3 * errors.result.residual_rms:.1f} mm",
            flush=True,
        )
    worst = dict(zip(BARS, np.max(rows, axis=0).tolist(), strict=True))
    within = sum(all(e <= bar for e, bar in zip(row, BARS.values(), strict=True)) for row in rows)
    print(f"{within} of {args.runs} runs within 5 mm, 0.1° and 2 ms")
    fields = {
        "robot": args.robot,
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
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0 if within == args.runs else 1


def _drive(robot: str, seed: int, seconds: float) -> CalibrationDrive:
    from ambler.core.robot import DriveKind
    from ambler.evaluation.calibration import simulate_drive
    from ambler.evaluation.robot_calibration import simulate_robot_drive
    from ambler.sim.robots import robot_named

    if robot in {kind.value for kind in DriveKind}:
        return simulate_drive(seed, DriveKind(robot), seconds)
    return simulate_robot_drive(robot_named(robot), seed, seconds)
