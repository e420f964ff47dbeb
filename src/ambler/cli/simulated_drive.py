"""`ambler demo --drive ROUTE`: a robot is driven along a route through a world with three dimensions, and its recording is there to be
mapped."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ambler.apps.scene import RunOptions

INTERRUPTED = 130


def run_drive(args: argparse.Namespace, options: RunOptions) -> int:
    """Drive, judge, tell. 0: the route was driven to its end without a collision; 1: it was not; 130: interrupted."""
    from ambler.apps.console import Stages
    from ambler.apps.drive import DriveRun, drive_scene, judge_drive
    from ambler.apps.run_report import print_result
    from ambler.cli.lio_localize import parse_guess
    from ambler.cli.opened_run import is_kept_alive, opened_run
    from ambler.evaluation.results import write_results

    _check(args)
    with opened_run(
        args,
        options,
        "drive",
        lambda: drive_scene(options, args.drive, args.speed, parse_guess(args.guess)),
        lambda scene, folder: DriveRun(options, scene, folder),
    ) as run:
        length, world = run.scene.route.length, run.scene.world.name
        print(
            f"{args.robot} along {length:.0f} m of {world}, seed {args.seed}; everything goes to {run.folder.root}",
            flush=True,
        )
        run.run(options.time_limit)
        with Stages() as stages:
            stages.begin("reading the recording")
            verdict = judge_drive(run)
        print_result(verdict.fields, "drive")
        if verdict.fields["text"]:
            print(f"{verdict.fields['ended']}: {verdict.fields['text']}", flush=True)
        print(
            f"map it: ambler lio {verdict.fields['recording']} --truth {verdict.fields['truth']} --out DIR", flush=True
        )
        if args.json:
            write_results(args.json, args.command_line, args.seed, run.wall_seconds, verdict.fields)
        if is_kept_alive(args, run):
            print("the robot stands in view; Ctrl-C ends", flush=True)
            run.serve()
        if run.is_interrupted:
            return INTERRUPTED
        return 0 if verdict.is_good else 1


def _check(args: argparse.Namespace) -> None:
    """Refuse options of an exploration, and a speed that is none."""
    from ambler.core.errors import BadInputError

    named = {
        "--then": args.then,
        "--strategy": args.strategy,
        "--radius": args.radius,
        "--boundary": args.boundary,
        "--docks": args.docks,
    }
    for option, value in named.items():
        if value:
            raise BadInputError(f"{option} belongs to an exploration, not to a drive along a route")
    if args.speed is not None and not (math.isfinite(args.speed) and args.speed > 0.0):
        raise BadInputError(f"--speed {args.speed:g}: must be a positive number of metres per second")
