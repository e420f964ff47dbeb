"""`ambler bench live`: how regularly a live robot commands its base, also while its disk, recorder or log fails."""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

from ambler.cli.results_output import save_json
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
    from ambler.apps.scene import RunOptions, checked_scene
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.studies.bench_live import measure

    plain = RunOptions(world=args.world, robot=args.robot, seed=args.seed, is_apart=True, port=None)
    options = study_settings(args).applied_to(plain)
    checked_scene(options)
    check_outputs(args.json, args.out)
    begin = time.perf_counter()
    warm_up(imported_kernel_modules())
    tell = partial(print, flush=True)
    found = measure(options, args.disturb, args.seconds, args.out, tell, with_failure=args.failure)
    save_json(args, begin, {"world": args.world, "robot": args.robot, "seconds": args.seconds, **found})
    return 0
