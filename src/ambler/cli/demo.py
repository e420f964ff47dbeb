"""`ambler demo`, the main job of `./run.sh`: a simulated robot explores a building that it has never seen."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import GOAL, add_dock_options, add_run_options, options_of, parse_goal
from ambler.cli.simulated_run import run_program


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "demo", help="a simulated robot explores an unknown building, comes home and is judged"
    )
    parser.add_argument("--strategy", choices=("tour", "nearest", "greedy"), help="how the next frontier is chosen")
    parser.add_argument(
        "--then",
        action="append",
        default=[],
        metavar="STEP",
        help=f"what to do next in the map just made, any number of times: {GOAL} (a goal), dock:NAME or undock:NAME",
    )
    parser.add_argument("--radius", type=float, metavar="M", help="explore no farther than this from the start, metres")
    parser.add_argument(
        "--boundary",
        metavar="X,Y;X,Y;...",
        help="explore inside this polygon only; corners in metres from the start",
    )
    parser.add_argument(
        "--stations",
        type=float,
        metavar="METRES",
        help="on ground: hold still for a dense cloud wherever the robot has come so far away from every earlier station (default: never)",
    )
    drive = parser.add_argument_group("a drive along a route, in place of an exploration")
    drive.add_argument(
        "--drive",
        metavar="FILE",
        help="drive along the waypoints of a route file and record clouds, IMU, wheels and truth for `ambler lio`; `built-in`: the"
        " route that the world brings along (campus, garage, tunnel and drawn sites have one)",
    )
    drive.add_argument("--speed", type=float, metavar="M/S", help="speed of the drive (default: the route's)")
    drive.add_argument(
        "--map",
        type=Path,
        metavar="CLOUD",
        help="find the place in this saved cloud (.pcd, .ply, or the folder of an exploration on ground) and follow it, instead of mapping; the robot is not told where it begins",
    )
    drive.add_argument(
        "--guess", metavar="X,Y,Z,DEG", help="with --map: where in the cloud the base is at first, within 2 m and 30°"
    )
    add_run_options(parser, world="office", robot="diff", time_limit=3600.0)
    add_dock_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore, and do what comes then; or drive along a route. 0: everything was done, with proof and without a collision."""
    from ambler.cli.simulated_drive import run_drive
    from ambler.core.errors import BadInputError
    from ambler.nodes.steps import DockStep, ExploreStep, Step, UndockStep

    if args.stations is not None:
        if args.drive is not None:
            raise BadInputError("--stations belongs to an exploration, not to a drive along a route (--drive)")
        if not args.stations > 0.0:
            raise BadInputError(f"--stations {args.stations:g}: must be a positive distance in metres")
    if args.drive is not None:
        return run_drive(args, options_of(args, ()))
    if args.speed is not None:
        raise BadInputError("--speed belongs to a drive along a route (--drive)")
    for option, value in (("--map", args.map), ("--guess", args.guess)):
        if value is not None:
            raise BadInputError(
                f"{option} belongs to a drive along a route (--drive): an exploration makes its own map"
            )
    steps: list[Step] = [ExploreStep()]
    for text in args.then:
        kind, colon, name = text.partition(":")
        if colon and kind in ("dock", "undock"):
            steps.append(DockStep(name) if kind == "dock" else UndockStep(name))
        else:
            steps.append(parse_goal(text, "--then"))
    return run_program(args, options_of(args, tuple(steps)))
