"""`ambler bench slam2d`: the stages of 2-D SLAM on scans of a simulated drive, one thread, medians in milliseconds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

MATCH_BAR_MS = 3.0


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "slam2d", help="the stages of 2-D SLAM on a simulated drive"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulation (default: 0)")
    parser.add_argument("--runs", type=int, default=200, help="scans to measure (default: 200)")
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; 1 when a match takes longer than its bar."""
    import time

    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.studies.slam_stages import measure_stages

    warm_up(imported_kernel_modules())
    started = time.perf_counter()
    fields = measure_stages(args.seed, args.runs)
    for name, value in fields.items():
        print(f"{name:<24} {value:.4g}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    return 0 if fields["match_ms"] <= MATCH_BAR_MS else 1
