"""`ambler dock NAME`: a simulated robot finds out where it is, drives to a dock and docks; or it is taught the dock it stands in."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from ambler.cli.run_options import add_dock_options, add_known_map_options, add_run_options, options_of
from ambler.cli.simulated_run import run_program

if TYPE_CHECKING:
    from ambler.apps.scene import RunOptions


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser("dock", help="drive to a docking station and dock")
    add_options(parser)
    parser.add_argument("--teach", action="store_true", help="start in the dock and save its pose into --docks")
    parser.add_argument(
        "--imperfections",
        choices=("drawn", "exact"),
        default="exact",
        help="camera, markers, contacts, floor and wheels off by what real ones are off by, drawn by --seed (default: exact)",
    )
    parser.add_argument("--then-undock", action="store_true", help="leave the dock again")
    parser.set_defaults(run=run)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what docking and undocking share."""
    parser.add_argument("name", metavar="NAME", nargs="?", default="charger_1", help="a dock (default: charger_1)")
    add_run_options(parser, world="dock_room", robot="amr_omni", time_limit=300.0)
    add_known_map_options(parser)
    add_dock_options(parser)


def run(args: argparse.Namespace) -> int:
    """Dock. 0: docked without a collision."""
    from ambler.core.errors import BadInputError
    from ambler.nodes.steps import DockStep, Step, TeachStep, UndockStep

    if args.teach and args.docks is None:
        raise BadInputError("--teach needs --docks FILE, whose dock it moves to where the robot stands")
    steps: list[Step] = [TeachStep(args.name) if args.teach else DockStep(args.name)]
    if args.then_undock:
        steps.append(UndockStep(args.name))
    options = options_of(args, tuple(steps), starts_docked=args.name if args.teach else None)
    if args.imperfections == "drawn":
        options = _imperfect(options, args.name)
    return run_program(args, options)


def _imperfect(options: RunOptions, name: str) -> RunOptions:
    """Return the options with what is off at a dock of the world and on the robot, drawn by their seed."""
    from dataclasses import replace

    from ambler.apps.docks import dock_of_world
    from ambler.core.se2 import SE2
    from ambler.sim.imperfections import draw_imperfections
    from ambler.sim.world_file import load_world

    world = load_world(options.world)
    dock = dock_of_world(world, name)
    start = world.start @ (options.start if options.start is not None else SE2())
    at = SE2() if options.starts_docked is not None else dock.world_from_dock.inverse() @ start
    return replace(options, imperfections=draw_imperfections(options.seed, dock).beginning_at(at))
