"""`ambler bench posegraph`: recorded planar graphs to their known optima, two beside gtsam in the same run, two from bad starts."""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

from ambler.cli.results_output import save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("posegraph", help="pose graph solver: optimum and time beside gtsam")
    parser.add_argument("--data", type=Path, help="folder with the .g2o files (default: $AMBLER_DATA/posegraph)")
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Solve every graph; exit 1 when an optimum is missed by more than 0.1 % or gtsam is faster."""
    from ambler.recordings.public_data import public_data
    from ambler.studies.bench_posegraph import measure, meets_bars

    data = public_data("posegraph") if args.data is None else args.data
    begin = time.perf_counter()
    fields = measure(data, args.runs, partial(print, flush=True))
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
