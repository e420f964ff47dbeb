"""`ambler bench ground`: contact and rays on meshes and height fields of more and more triangles, beside the plain floor."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("ground", help="contact and rays on meshes and height fields")
    parser.add_argument("--robot", default="amr_omni", help="name of a robot")
    parser.add_argument("--seed", type=int, default=0, help="of the meshes' uneven triangles")
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print; always 0."""
    from ambler.studies.bench_ground import measure

    begin = time.perf_counter()
    fields = measure(args.robot, args.seed)
    print_fields(fields, 32, ".3f")
    save_json(args, begin, {k: v if isinstance(v, str) else round(v, 4) for k, v in fields.items()})
    return 0
