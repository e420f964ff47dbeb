"""`ambler bench slam2d`: the stages of 2-D SLAM on scans of a simulated drive, one thread, medians in milliseconds."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


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
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.studies.bench_slam2d import measure, meets_bars

    warm_up(imported_kernel_modules())
    begin = time.perf_counter()
    fields = measure(args.seed, args.runs)
    print_fields(fields, 24, ".4g")
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
