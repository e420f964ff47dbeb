"""`ambler undock`: a simulated robot that stands in a dock ends the charge and backs out to the staging pose."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.dock import add_options
from ambler.cli.run_options import options_of
from ambler.cli.simulated_run import run_program


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser("undock", help="leave a docking station")
    add_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Undock. 0: left without a collision."""
    from ambler.nodes.steps import UndockStep

    return run_program(args, options_of(args, (UndockStep(args.name),), starts_docked=args.name))
