"""`ambler eval team`: two robots explore one building in one process; both must end with proof, and both recordings must replay."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "two robots explore one building in one process, told apart by a prefix"
    parser: argparse.ArgumentParser = subparsers.add_parser("team", help=text, description=text)
    parser.add_argument("--world", default="building", help="a world (default: building)")
    parser.add_argument("--robot", default="diff", help="what both are (default: diff)")
    add_study_options(parser, 1, "seeds")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0: all ended with proof, without a collision, and replayed to the same bits."""
    from ambler.studies.program_study import TeamCase, is_team_good, summarize_teams, team_study

    settings, seeds = study_settings(args), seeds_of(args)
    settings.check([args.world], [args.robot])
    results = conduct_study(args, team_study([TeamCase(args.world, args.robot, seed, settings) for seed in seeds]))
    write_summary(args, {"world": args.world, "robot": args.robot, **summarize_teams(results)}, seeds)
    return 0 if all(map(is_team_good, results)) else 1
