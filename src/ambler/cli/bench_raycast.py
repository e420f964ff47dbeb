"""`ambler bench raycast`: rays of one VLP-16 turn and one 720-beam scan beside MuJoCo's rays, and the cost of a simulated second."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "raycast", help="the simulator's ray caster beside MuJoCo's, and the whole simulator"
    )
    parser.add_argument("--world", default="office", help="name of a world, or a world or floor plan file (.yaml)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print; always 0."""
    from ambler.studies.bench_raycast import measure

    begin = time.perf_counter()
    fields = measure(args.world, args.seed)
    print_fields(fields, 32, ".3f", ".3f")
    save_json(args, begin, {name: round(value, 4) for name, value in fields.items()})
    return 0
