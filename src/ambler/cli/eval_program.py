"""`ambler eval program`: explore, dock, undock, drive to random goals and dock again, in one run and in the map just made."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary

DOCKING_ROBOT, DOCK = "amr_omni", "charger_1"


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "explore, dock, undock, drive to random goals and dock again in one run"
    parser: argparse.ArgumentParser = subparsers.add_parser("program", help=text, description=text)
    parser.add_argument("--world", default="building", help="a world with a dock (default: building)")
    parser.add_argument("--robots", nargs="*", default=["amr_omni", "spot", "diff"], metavar="ROBOT")
    add_study_options(parser, 5, "seeds per robot", processes=2)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0: every program succeeded without a collision."""
    from ambler.studies.program_study import ProgramCase, is_good, program_study, summarize

    settings, seeds = study_settings(args), seeds_of(args)
    settings.check([args.world], args.robots)
    cases = [
        ProgramCase(args.world, robot, seed, dock=DOCK if robot == DOCKING_ROBOT else None, settings=settings)
        for robot in args.robots
        for seed in seeds
    ]
    results = conduct_study(args, program_study(cases))
    write_summary(args, {"world": args.world, **summarize(results)}, seeds)
    return 0 if all(map(is_good, results)) else 1
