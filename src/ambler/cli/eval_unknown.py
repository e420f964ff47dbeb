"""`ambler eval unknown`: drives to goals in unknown places, half of them behind dead ends, with both global planners."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "unknown", help="drive to goals without a map: the visibility graph beside the grid planner"
    )
    parser.add_argument("--kinds", default="office,flat", help="comma-separated kinds of places (default: office,flat)")
    parser.add_argument("--robot", default="diff", help="diff, amr_omni or a URDF file (default: diff)")
    parser.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    add_study_options(parser, 20, "goals, half of them behind dead ends, each driven to with both planners")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive and judge; 0 when the bars of `unknown_study.meets_bars` are met."""
    from ambler.apps.run_report import print_result
    from ambler.studies.unknown_study import meets_bars, summarize, unknown_cases, unknown_study

    settings, seeds = study_settings(args, "global_planner"), seeds_of(args)
    settings.check(["lab_empty"], [args.robot])  # places are not drawn yet
    kinds = [kind for kind in args.kinds.split(",") if kind]
    physics: Any = "kinematic" if args.kinematic else "contact"
    cases = unknown_cases(kinds, args.robot, seeds, physics, settings)
    fields = {"robot": args.robot, "physics": physics, **summarize(conduct_study(args, unknown_study(cases)))}
    print_result(fields, "unknown")
    write_summary(args, fields, seeds)
    return 0 if meets_bars(fields) else 1
