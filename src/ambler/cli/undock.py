"""`ambler undock`: a simulated robot that stands in a dock ends the charge and backs out to the staging pose."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.dock import add_options, run_errands


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser("undock", help="leave a docking station")
    add_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Undock and judge. 0: left without a collision."""
    from ambler.nodes.dock_pilot import ErrandKind

    return run_errands(args, [ErrandKind.UNDOCK], starts_docked=args.name)
