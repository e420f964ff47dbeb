"""`ambler bench merger`: how exact, how late and how fast the scan merger is, at 1 m/s and 90°/s."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "merger", help="scan merger: error at full speed, latency, time per 100 thousand points"
    )
    parser.add_argument("--runs", type=int, default=200, help="repetitions of each timing")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; exit 1 when a point is off by more than 1 cm, a scan late by more than one scan, or a merge slower than 2 ms."""
    from ambler.studies.bench_merger import measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.runs, args.seed)
    print_fields(fields, 44, ".5g")
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
