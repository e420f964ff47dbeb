"""`ambler demo`, the main job of `./run.sh`: a simulated robot explores a building that it has never seen."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "demo", help="a simulated robot explores an unknown building, comes home and is judged"
    )
    parser.add_argument("--world", default="office", help="a built-in world, or a world or map YAML (default: office)")
    parser.add_argument("--robot", default="diff", help="diff, spot, amr_omni or a URDF file (default: diff)")
    parser.add_argument("--seed", type=int, default=0, help="seed of every random number (default: 0)")
    parser.add_argument("--strategy", choices=("tour", "nearest", "greedy"), help="how the next frontier is chosen")
    parser.add_argument("--realtime", action="store_true", help="run in the live executor, in real time")
    parser.add_argument("--exit", action="store_true", help="end after the run even on a terminal")
    parser.add_argument("--perfect", action="store_true", help="sensors without noise, odometry without drift")
    parser.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="KIND[@TARGET][:T0[:T1]]",
        help="let something go wrong from T0 to T1 s: wheel_slip, scanner_dropout, scanner_stuck, delayed_stamps, people, "
        "door or glass",
    )
    parser.add_argument("--time-limit", type=float, default=3600.0, help="simulated seconds (default: 3600)")
    parser.add_argument("--port", type=int, default=8765, help="port of the live view (default: 8765)")
    parser.add_argument("--no-view", action="store_true", help="no live view")
    parser.add_argument("--host", default="127.0.0.1", help="address of the live view (default: this machine only)")
    parser.add_argument("--token", help="what a viewer must present (required unless the view is local)")
    parser.add_argument("--profile", type=Path, help="YAML file with what differs from the robot's defaults")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="override one setting")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore, judge, report; then keep the view open on a terminal. 0: ended with proof and without a collision."""
    from ambler.apps.demo import Demo, explorer_config
    from ambler.apps.demo_report import judge, print_result, write_demo_report
    from ambler.apps.run_folder import RunFolder
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.sim.faults import Fault

    options = _options(args)
    explorer_config(options)
    for fault in options.faults:
        Fault.parse(fault)
    warm_up(imported_kernel_modules())
    folder = RunFolder.new(args.out, f"{Path(args.world).stem}-{Path(args.robot).stem}-{args.seed}")
    demo = Demo(options, folder)
    try:
        if options.port is not None:
            print(f"live view: Foxglove on ws://{options.host}:{options.port}  (docs/live_view.md)", flush=True)
        print(
            f"{args.robot} explores {demo.world.name}, seed {args.seed}; everything goes to {folder.root}", flush=True
        )
        demo.run()
        verdict = judge(demo)
        report = write_demo_report(demo, verdict)
        print_result(verdict.fields)
        print(f"report: {report}", flush=True)
        if args.json:
            write_results(args.json, _command(args), args.seed, verdict.wall_seconds, verdict.fields)
        is_good = demo.ended == "finished" and verdict.fields["collisions"] == 0
        if sys.stdout.isatty() and not args.exit and demo.view is not None and demo.executor.failure is None:
            print("the robot stays alive: click a pose in the viewer to send it there; Ctrl-C ends", flush=True)
            try:
                demo.serve()
            except KeyboardInterrupt:
                print()
        return 0 if is_good else 1
    finally:
        demo.close()


def _options(args: argparse.Namespace) -> Any:
    from ambler.apps.demo import DemoOptions
    from ambler.core.errors import BadInputError
    from ambler.settings.profiles import load_profile, merge, parse_assignment

    if args.host not in ("127.0.0.1", "localhost", "::1") and not args.token and not args.no_view:
        raise BadInputError(f"a live view on {args.host} needs --token: everybody there could drive the robot")
    profile = load_profile(args.profile) if args.profile else {}
    faults = profile.pop("faults", [])
    if not isinstance(faults, list):
        raise BadInputError(f"{args.profile}: faults must be a list such as [wheel_slip:10:20]")
    for text in args.set:
        profile = merge(profile, parse_assignment(text))
    if args.strategy:
        profile = merge(profile, {"strategy": args.strategy})
    return DemoOptions(
        world=args.world,
        robot=args.robot,
        seed=args.seed,
        is_realtime=args.realtime,
        is_perfect=args.perfect,
        physics="kinematic" if args.kinematic else "contact",
        port=None if args.no_view else args.port,
        host=args.host,
        token=args.token,
        time_limit=args.time_limit,
        profile=profile,
        faults=(*(str(f) for f in faults), *args.fault),
    )


def _command(args: argparse.Namespace) -> str:
    extra = "".join(f" --{name}" for name in ("realtime", "perfect", "kinematic") if getattr(args, name))
    extra += "".join(f" --fault {fault}" for fault in args.fault)
    return f"ambler demo --world {args.world} --robot {args.robot} --seed {args.seed}{extra}"
