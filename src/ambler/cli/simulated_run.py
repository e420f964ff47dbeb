"""What all verbs of a simulated robot do: check, run the steps, judge, report, and keep the view open on a terminal."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ambler.apps.scene import RunOptions
    from ambler.apps.simulated import SimulatedRun

INTERRUPTED = 130


def run_program(args: argparse.Namespace, options: RunOptions) -> int:
    """Run a program of steps. 0: all was done, without a collision; 1: something fell short; 130: interrupted."""
    from ambler.apps.scene import checked_scene
    from ambler.apps.simulated import SimulatedRun
    from ambler.cli.opened_run import is_kept_alive, opened_run

    with opened_run(
        args,
        options,
        args.verb,
        lambda: checked_scene(options),
        lambda scene, folder: SimulatedRun(options, folder, scene),
    ) as run:
        print(
            f"{args.robot} in {run.scene.world.name}, seed {args.seed}; everything goes to {run.folder.root}",
            flush=True,
        )
        run.run(options.time_limit)
        code = _conclude(args, run)
        if is_kept_alive(args, run):
            print("the robot stays alive: click a pose in the viewer to send it there; Ctrl-C ends", flush=True)
            run.serve()
        return code


def _conclude(args: argparse.Namespace, run: SimulatedRun) -> int:
    """Judge, report, print and write; a signal meanwhile does not leave a report half done."""
    from ambler.apps.console import Stages
    from ambler.apps.judgement import is_good, judge, missing_floor
    from ambler.apps.run_report import print_result, write_run_report
    from ambler.apps.signals import on_interrupt
    from ambler.evaluation.results import write_results

    with on_interrupt(lambda: print("writing the report; once more ends at once", flush=True)), Stages() as stages:
        verdict = judge(run, on_stage=stages.begin)
        stages.begin("drawing the report")
        report = write_run_report(run.robot, verdict)
        print_result(verdict.fields, args.verb)
        if run.options.is_lost and run.end is not None and run.end.where is not None:
            x, y, yaw = run.end.where.as_array()
            print(f"the robot found itself at {x:.2f}, {y:.2f} m, {math.degrees(yaw):.0f} degrees", flush=True)
        if verdict.fields["text"]:
            print(f"{verdict.fields['ended']}: {verdict.fields['text']}", flush=True)
        lack = missing_floor(verdict)
        if lack is not None:
            print(f"fell short: {lack}", flush=True)
        if run.folder.map_stem.with_suffix(".yaml").exists():
            print(f"map: {run.folder.map_stem.with_suffix('.yaml')}", flush=True)
        print(f"report: {report}", flush=True)
        if args.json:
            write_results(args.json, args.command_line, args.seed, run.wall_seconds, verdict.fields)
    if run.is_interrupted:
        return INTERRUPTED
    return 0 if is_good(verdict) else 1
