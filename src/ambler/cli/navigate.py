"""`ambler navigate`: a simulated robot finds out where it is in a saved map and drives to goals, or does so where there is no map."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import (
    GOAL,
    add_known_map_options,
    add_run_options,
    add_unknown_options,
    options_of,
    parse_goal,
)
from ambler.cli.simulated_run import run_program


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "navigate", help="a simulated robot localizes itself in a known map and drives to goals"
    )
    parser.add_argument(
        "goals",
        nargs="*",
        metavar=GOAL,
        help="goals in the map frame (--unknown: from the start), metres and degrees; on which level of a map of ground (default: the one where the robot then is)",
    )
    add_run_options(parser, world="office", robot="amr_omni", time_limit=900.0)
    add_known_map_options(parser)
    add_unknown_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive. 0: every goal was reached without a collision."""
    goals = tuple(parse_goal(text, "goal") for text in args.goals)
    return run_program(args, options_of(args, goals))
