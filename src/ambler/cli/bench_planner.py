"""`ambler bench planner`: the global planner on four grids at two sizes, its costs and times beside SciPy's Dijkstra; its paths beside those
down the gradient of a full potential."""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

from ambler.cli.results_output import save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("planner", help="global planner: optimality and time beside SciPy's Dijkstra")
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 4000])
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--oracle-up-to",
        type=int,
        default=4000,
        help="largest size whose costs SciPy checks (4000: 4 GB, a minute each)",
    )
    parser.add_argument(
        "--paths",
        type=int,
        default=120,
        help="drawn paths in each of three kinds of grids, compared with the gradient's (default: 120, a minute or two)",
    )
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Plan on every grid; exit 1 when a cost differs from the oracle's, a median exceeds its bar, or paths cost more than the gradient's in
    the mean."""
    from ambler.studies.bench_planner import compare_with_gradient, measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.sizes, args.runs, args.seed, args.oracle_up_to, partial(print, flush=True))
    fields |= compare_with_gradient(args.paths, args.seed, partial(print, flush=True))
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
