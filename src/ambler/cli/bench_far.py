"""`ambler bench far`: updates of and searches on the visibility graph, in processor time of one core."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("far", help="visibility graph: updates and searches with 2000 nodes")
    parser.add_argument("--nodes", type=int, default=2000, help="nodes of the site, about (default: 2000)")
    parser.add_argument("--runs", type=int, default=200, help="updates and searches (default: 200 each)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; 0 when a median update and a median search take at most 3 ms, and both together a fifth of a core at 5 Hz."""
    from ambler.core.errors import BadInputError
    from ambler.studies.bench_far import measure, meets_bars

    if args.nodes < 10 or args.runs < 1:
        raise BadInputError("bench far: needs at least 10 nodes and 1 run")
    begin = time.perf_counter()
    fields = measure(args.nodes, args.runs, args.runs, args.seed)
    print_fields(fields, 24, ".4g")
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
