"""`ambler bench particles`: time of the particle update, scan matching, the EKF step and the search of the whole map, one core."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("particles", help="particle filter, grid tracker, EKF and relocalization: times")
    parser.add_argument("--particles", type=int, default=2000)
    parser.add_argument("--beams", type=int, default=60)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure on a map of 50 x 50 m at 5 cm; exit 1 when the particle update or the EKF step is slower than its bar."""
    from ambler.studies.bench_particles import measure, meets_bars

    begin = time.perf_counter()
    fields = measure(args.particles, args.beams, args.runs, args.seed)
    print_fields(fields, 28, "10.3f", "10d")
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
