"""`ambler bench transport`: encoding beside rosbags, what a recording costs, the live view's toll."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("transport", help="encode messages, record them, show them to nobody")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; exit 1 when encoding misses its bars."""
    from ambler.studies.bench_transport import measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.runs, args.seed)
    print_fields(dict(sorted(fields.items())), 42, ".4f")
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
