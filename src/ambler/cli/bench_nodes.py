"""`ambler bench nodes`: how long every callback of every node takes, beside the latency that the node declares."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "nodes", help="wall time of every callback of every node beside its declared latency"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated seconds of exploring the office")
    parser.add_argument("--robot", default="amr_omni", help="robot that explores")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made")
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore the office for a while and dock once; exit 1 when a node's 99th percentile is longer than it declares."""
    from ambler.studies.bench_nodes import late_nodes, measure, table

    begin = time.perf_counter()
    fields = measure(args.robot, args.seed, args.seconds, args.out)
    print(table(fields))
    offenders = late_nodes(fields)
    save_json(args, begin, {**fields, "offenders": ", ".join(offenders)})
    return 1 if offenders else 0
