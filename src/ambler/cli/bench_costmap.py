"""`ambler bench costmap`: inflation and the update of a rolling window, beside SciPy's distance transform."""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

from ambler.cli.results_output import save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("costmap", help="costmaps: inflation and rolling update")
    parser.add_argument("--sizes", type=int, nargs="+", default=[60, 200, 1000, 4000])
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; exit 1 when the inflation of a 60 x 60 window takes more than 0.3 ms or differs from SciPy's distances."""
    from ambler.studies.bench_costmap import measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.sizes, args.runs, args.seed, partial(print, flush=True))
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
