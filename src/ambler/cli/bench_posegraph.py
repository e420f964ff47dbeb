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
    parser.add_argument(
        "--data", type=Path, default=Path("../shared/data/posegraph"), help="folder with the .g2o files"
    )
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Solve every graph; exit 1 when an optimum is missed by more than 0.1 % or gtsam is faster."""
    from ambler.studies.bench_posegraph import measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.data, args.runs, partial(print, flush=True))
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
