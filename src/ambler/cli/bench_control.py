"""`ambler bench control`: one cycle of the local planner in cluttered windows, and one step of the velocity gate."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("control", help="local planner and velocity gate: time per cycle")
    parser.add_argument("--runs", type=int, default=300, help="cycles per measurement")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print medians of CPU time; exit 1 when the planner's median at 60 x 60 cells is above 3 ms."""
    from ambler.studies.bench_control import measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.runs, args.seed)
    print_fields(fields, 40)
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
