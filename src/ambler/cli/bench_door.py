"""`ambler bench door`: four strangers call a robot that drives, in both executors."""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

from ambler.cli.results_output import save_json
from ambler.cli.run_options import check_outputs

EXECUTORS = ("lockstep", "live")


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "calls and goals from four threads while the robot drives: is each answered, and is the run repeated to the bit?"
    parser: argparse.ArgumentParser = subparsers.add_parser("door", help=text, description=text)
    parser.add_argument("--requests", type=int, default=1000, help="of all four together (default: 1000)")
    parser.add_argument("--world", default="office", help="(default: office)")
    parser.add_argument("--robot", default="diff", help="(default: diff)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--executors", nargs="*", default=list(EXECUTORS), choices=EXECUTORS, help="(default: both)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; exit 1 when an answer is missing or wrong, or the repetition differs."""
    from ambler.apps.scene import RunOptions, checked_scene
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.studies.bench_door import measure

    options = RunOptions(world=args.world, robot=args.robot, seed=args.seed, port=None)
    checked_scene(options)
    check_outputs(args.json, args.out)
    begin = time.perf_counter()
    warm_up(imported_kernel_modules())
    tell = partial(print, flush=True)
    fields = measure(options, args.requests, args.out, tell, args.executors)
    save_json(args, begin, {"world": args.world, "robot": args.robot, "requests": args.requests, **fields})
    return 0 if fields["bars.door"] else 1
