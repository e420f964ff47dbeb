"""`ambler bench terrain`: one update of the terrain analysis, and the scoring of motion primitives."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "terrain", help="terrain analysis: time per cloud; motion primitives: time per scoring"
    )
    parser.add_argument("--runs", type=int, default=300, help="clouds per measurement")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print medians of CPU time; exit 1 when the median of the near update or of the scoring of primitives is above 1 ms."""
    from ambler.studies.bench_terrain import measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.runs, args.seed)
    print_fields(fields, 40)
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
