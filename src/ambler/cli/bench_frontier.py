"""`ambler bench frontier`: frontier search on synthetic maps, whole and incremental, and one whole survey."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("frontier", help="frontier search: whole map, changed box, whole survey")
    parser.add_argument("--runs", type=int, default=21)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure medians; exit 1 when a bar is missed."""
    from ambler.studies.bench_frontier import measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.runs, args.seed)
    print_fields(fields, 24, ".3f")
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
