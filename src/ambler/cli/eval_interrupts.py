"""`ambler eval interrupts`: signals at random instants of runs; what was known must be saved, and nothing may be left half done."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, first_seed, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "end runs by signals at random instants: is what was known saved, and nothing left half done?"
    parser: argparse.ArgumentParser = subparsers.add_parser("interrupts", help=text, description=text)
    parser.add_argument("--world", default="office", help="what is explored (default: office)")
    add_study_options(parser, 30, "signals")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0: every run ended with code 130 and left a whole report and map, or nothing at all."""
    from ambler.studies.interrupt_study import ROBOT, interrupt_study, summarize

    settings, seed = study_settings(args), first_seed(args)
    settings.check([args.world], [ROBOT])
    fields = summarize(conduct_study(args, interrupt_study(args.world, args.runs, seed, settings)))
    write_summary(args, fields, [seed])
    return 1 if fields["wrong"] else 0
