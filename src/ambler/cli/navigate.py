"""`ambler navigate`: a simulated robot finds out where it is in a saved map and drives to goals."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "navigate", help="a simulated robot localizes itself in a known map and drives to goals"
    )
    parser.add_argument("goals", nargs="*", metavar="X,Y[,YAW]", help="goals in the map frame, metres and radians")
    parser.add_argument("--world", default="office", help="a built-in world, or a world or map YAML (default: office)")
    parser.add_argument("--robot", default="amr_omni", help="diff, amr_omni or a URDF file (default: amr_omni)")
    parser.add_argument("--map", type=Path, help="saved map of that world, its YAML (default: drawn from the world)")
    parser.add_argument("--localizer", choices=("tracker", "particles", "reflectors"), help="(default: tracker)")
    parser.add_argument("--source", choices=("scan", "cloud", "both"), help="what it looks at (default: scan)")
    parser.add_argument("--lost", action="store_true", help="do not tell the robot where it starts")
    parser.add_argument("--may-turn", action="store_true", help="it may turn in place to find out")
    parser.add_argument("--seed", type=int, default=0, help="seed of every random number (default: 0)")
    parser.add_argument("--realtime", action="store_true", help="run in the live executor, in real time")
    parser.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    parser.add_argument("--exit", action="store_true", help="end after the last goal even on a terminal")
    parser.add_argument("--fault", action="append", default=[], metavar="FAULT", help="as of `ambler demo`")
    parser.add_argument("--time-limit", type=float, default=900.0, help="simulated seconds (default: 900)")
    parser.add_argument("--port", type=int, default=8765, help="port of the live view (default: 8765)")
    parser.add_argument("--no-view", action="store_true", help="no live view")
    parser.add_argument("--profile", type=Path, help="YAML file with what differs from the robot's defaults")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="override one setting")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive and judge. 0: every goal was reached without a collision."""
    from ambler.apps.demo_report import print_result
    from ambler.apps.navigation import NavigationRun, navigation_config
    from ambler.apps.run_folder import RunFolder
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    options = _options(args)
    navigation_config(options)
    warm_up(imported_kernel_modules())
    folder = RunFolder.new(args.out, f"navigate-{Path(args.world).stem}-{args.seed}")
    journey = NavigationRun(options, folder)
    try:
        journey.run(options.time_limit)
        fields = journey.judge()
        print_result(fields, "navigation")
        if args.json:
            goals = " ".join(args.goals)
            command = f"ambler navigate {goals} --world {args.world} --robot {args.robot} --seed {args.seed}"
            write_results(args.json, command, args.seed, journey.wall_seconds, fields)
        if sys.stdout.isatty() and not args.exit and journey.view is not None and journey.executor.failure is None:
            print("the robot stays alive: click a goal or set its pose in the viewer; Ctrl-C ends", flush=True)
            try:
                journey.serve()
            except KeyboardInterrupt:
                print()
        return 0 if journey.ended == "arrived" and fields["collisions"] == 0 else 1
    finally:
        journey.close()


def _options(args: argparse.Namespace) -> Any:
    from ambler.apps.navigation import NavigationOptions, parse_goal
    from ambler.settings.profiles import load_profile, merge, parse_assignment
    from ambler.sim.faults import Fault

    profile = load_profile(args.profile) if args.profile else {}
    for text in args.set:
        profile = merge(profile, parse_assignment(text))
    if args.localizer:
        profile = merge(profile, {"localizer": args.localizer})
    if args.source:
        profile = merge(profile, {"localization": {"source": args.source}})
    for fault in args.fault:
        Fault.parse(fault)
    return NavigationOptions(
        world=args.world,
        robot=args.robot,
        map_file=args.map,
        goals=tuple(parse_goal(text) for text in args.goals),
        seed=args.seed,
        is_lost=args.lost,
        may_turn=args.may_turn,
        is_realtime=args.realtime,
        physics="kinematic" if args.kinematic else "contact",
        port=None if args.no_view else args.port,
        time_limit=args.time_limit,
        profile=profile,
        faults=tuple(args.fault),
    )
