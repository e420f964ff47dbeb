"""`ambler eval crowd`: explore among people of whom half do not yield."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "crowd", help="explore among people who do not all yield: contacts, endings, time"
    )
    parser.add_argument(
        "--worlds",
        nargs="+",
        default=["office", "two_rooms"],
        help="default: office two_rooms; `office-*` draws one with each run's seed",
    )
    parser.add_argument("--robots", nargs="+", default=["diff", "amr_omni", "spot"], help="default: diff amr_omni spot")
    parser.add_argument("--people", type=int, default=10, help="how many walk about (default: 10)")
    parser.add_argument("--stubborn", type=int, help="how many of them do not yield (default: half of them)")
    parser.add_argument("--time-limit", type=float, help="simulated seconds per run (default: that of `ambler demo`)")
    add_study_options(parser, 30, "runs; worlds and robots take turns")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when no robot caused a contact and at most two of 30 runs did not finish."""
    from ambler.sim.faults import Fault, numbers_of_people
    from ambler.studies.crowd_study import crowd_cases, crowd_study, meets_bar, summarize

    target = f"{args.people}" if args.stubborn is None else f"{args.people}/{args.stubborn}"
    Fault.parse(f"people@{target}")
    people, stubborn = numbers_of_people(target)
    settings, seeds = study_settings(args), seeds_of(args)
    settings.check([world.replace("*", str(seeds[0])) for world in args.worlds], args.robots)
    options = () if args.time_limit is None else ("--time-limit", str(args.time_limit))
    cases = crowd_cases(args.worlds, args.robots, people, stubborn, seeds, options, settings)
    fields = summarize(conduct_study(args, crowd_study(cases)))
    print_fields(fields, 48, ".4g")
    write_summary(args, fields, seeds)
    return 0 if meets_bar(fields) else 1
