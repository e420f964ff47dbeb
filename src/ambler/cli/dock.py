"""`ambler dock NAME`: a simulated robot finds out where it is, drives to a dock and docks; or it is taught the dock it stands in."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.apps.docking import DockingOptions
    from ambler.nodes.dock_pilot import ErrandKind


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser("dock", help="drive to a docking station and dock")
    add_options(parser)
    parser.add_argument("--teach", action="store_true", help="start in the dock and save its pose into --docks")
    parser.add_argument("--then-undock", action="store_true", help="leave the dock again")
    parser.set_defaults(run=run)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what docking and undocking share."""
    parser.add_argument("name", metavar="NAME", nargs="?", default="charger_1", help="a dock (default: charger_1)")
    parser.add_argument("--world", default="dock_room", help="a world with docks (default: dock_room)")
    parser.add_argument("--robot", default="amr_omni", help="a robot with a camera (default: amr_omni)")
    parser.add_argument("--map", type=Path, help="saved map of that world, its YAML (default: drawn from the world)")
    parser.add_argument("--docks", type=Path, metavar="FILE", help="dock database (default: drawn from the world)")
    parser.add_argument("--camera", type=Path, metavar="FILE", help="calibration of the camera, a camera_info YAML")
    parser.add_argument(
        "--start",
        metavar="X,Y[,YAW]",
        help="start in the map, metres and radians (default: its origin, the world's start)",
    )
    parser.add_argument("--lost", action="store_true", help="do not tell the robot where it starts")
    parser.add_argument("--seed", type=int, default=0, help="seed of every random number (default: 0)")
    parser.add_argument("--realtime", action="store_true", help="run in the live executor, in real time")
    parser.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    parser.add_argument(
        "--fault", action="append", default=[], metavar="FAULT", help="as of `ambler demo`; light, shadow, blur, …"
    )
    parser.add_argument("--time-limit", type=float, default=300.0, help="simulated seconds (default: 300)")
    parser.add_argument("--view", action="store_true", help="show it live on --port")
    parser.add_argument("--port", type=int, default=8765, help="port of the live view (default: 8765)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    parser.add_argument("--json", type=Path, help="write the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Dock and judge. 0: docked without a collision."""
    from ambler.core.errors import BadInputError
    from ambler.nodes.dock_pilot import ErrandKind

    if args.teach and args.docks is None:
        raise BadInputError("--teach needs --docks FILE, whose dock it moves to where the robot stands")
    kinds = [ErrandKind.TEACH if args.teach else ErrandKind.DOCK]
    if args.then_undock:
        kinds.append(ErrandKind.UNDOCK)
    return run_errands(args, kinds, starts_docked=args.name if args.teach else None)


def run_errands(args: argparse.Namespace, kinds: list[ErrandKind], starts_docked: str | None) -> int:
    """Run errands at the dock of `args.name`, print and write what came of them."""
    from ambler.apps.demo_report import print_result
    from ambler.apps.docking import DockingRun
    from ambler.apps.run_folder import RunFolder
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    options = options_of(args, kinds, starts_docked)
    warm_up(imported_kernel_modules())
    folder = RunFolder.new(args.out, f"{args.verb}-{Path(args.world).stem}-{args.seed}")
    docking = DockingRun(options, folder)
    try:
        docking.run(args.time_limit)
        fields = docking.judge()
        print_result(fields, "docking")
        if args.json:
            command = f"ambler {args.verb} {args.name} --world {args.world} --robot {args.robot} --seed {args.seed}"
            write_results(args.json, command, args.seed, docking.wall_seconds, fields)
        return 0 if docking.ended == "done" and fields["collisions"] == 0 else 1
    finally:
        docking.close()


def options_of(args: argparse.Namespace, kinds: list[ErrandKind], starts_docked: str | None) -> DockingOptions:
    """Read the command line; raises BadInputError."""
    from ambler.apps.docking import DockingOptions
    from ambler.apps.navigation import NavigationOptions, parse_goal
    from ambler.nodes.dock_pilot import Errand
    from ambler.sim.faults import Fault
    from ambler.wire.camera_info import load_camera_info

    for fault in args.fault:
        Fault.parse(fault)
    navigation = NavigationOptions(
        world=args.world,
        robot=args.robot,
        map_file=args.map,
        seed=args.seed,
        is_lost=args.lost,
        is_realtime=args.realtime,
        physics="kinematic" if args.kinematic else "contact",
        port=args.port if args.view else None,
        time_limit=args.time_limit,
        faults=tuple(args.fault),
    )
    return DockingOptions(
        navigation,
        tuple(Errand(kind, args.name) for kind in kinds),
        start=None if args.start is None else parse_goal(args.start),
        starts_docked=starts_docked,
        docks_file=args.docks,
        camera=None if args.camera is None else load_camera_info(args.camera),
    )
