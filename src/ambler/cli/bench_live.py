"""`ambler bench live`: how regularly a live robot commands its base, also while its disk, recorder or log fails."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, check_outputs, study_settings

DISTURBANCES = ("none", "stalled_disk", "full_disk", "recorder_raises", "log_raises")


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "how regularly a live robot commands its base, beside an empty loop of 50 Hz; the simulator runs niced in another process"
    parser: argparse.ArgumentParser = subparsers.add_parser("live", help=text, description=text)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each run (default: 60)")
    parser.add_argument("--world", default="office", help="what it explores meanwhile (default: office)")
    parser.add_argument("--robot", default="diff", help="(default: diff)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--disturb", nargs="*", default=["none"], choices=DISTURBANCES, help="(default: none)")
    parser.add_argument("--failure", action="store_true", help="let a node fail, too: how soon does the robot stop?")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    add_settings(parser)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run each and print the periods."""
    import time

    from ambler.apps.scene import RunOptions, checked_scene
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.studies.live_timing import busy, measure, stop_after_failure

    plain = RunOptions(world=args.world, robot=args.robot, seed=args.seed, is_apart=True, port=None)
    options = study_settings(args).applied_to(plain)
    checked_scene(options)
    check_outputs(args.json, args.out)
    started = time.perf_counter()
    warm_up(imported_kernel_modules())
    fields: dict[str, Any] = {"world": args.world, "robot": args.robot, "seconds": args.seconds}
    for disturbance in args.disturb:
        found = measure(busy(options), args.seconds, args.out, disturbance)
        fields |= {f"{disturbance}.{name}": value for name, value in found.items()}
        print(disturbance, {name: round(v, 1) if isinstance(v, float) else v for name, v in found.items()}, flush=True)
    if args.failure:
        for log_raises in (False, True):
            name = "failure_and_log" if log_raises else "failure"
            told = stop_after_failure(options, args.out, log_raises=log_raises)
            fields |= {f"{name}.{key}": value for key, value in told.items()}
            print(name, told, flush=True)
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    return 0
