"""`ambler eval exploration`: many demonstrations over worlds, robots and seeds, each in its own process, and their summary."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, print_fields, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "exploration", help="explore worlds with robots over several seeds and summarize"
    )
    parser.add_argument("--worlds", nargs="+", default=["office"], help="default: office")
    parser.add_argument("--robots", nargs="+", default=["diff", "spot"], help="default: diff spot")
    parser.add_argument("--strategies", nargs="+", help="default: that of the settings, else tour")
    parser.add_argument("--time-limit", type=float, help="simulated seconds per run (default: that of `ambler demo`)")
    add_study_options(parser, 3, "seeds per world and robot")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when every run ended with proof and without a collision."""
    from itertools import product

    from ambler.studies.exploration_study import ExplorationCase, exploration_study, is_good, summarize

    settings = study_settings(args)
    worlds, robots = _names(args.worlds), _names(args.robots)
    settings.check(worlds, robots)
    strategies = _names(args.strategies or [settings.profile.get("strategy", "tour")])
    options = () if args.time_limit is None else ("--time-limit", str(args.time_limit))
    seeds = seeds_of(args)
    cases = [ExplorationCase(*case, options, settings) for case in product(worlds, robots, strategies, seeds)]
    results = conduct_study(args, exploration_study(cases))
    fields = summarize(results)
    print_fields(fields)
    write_summary(args, fields, seeds)
    return 0 if all(map(is_good, results)) else 1


def _names(words: list[str]) -> tuple[str, ...]:
    """Return names given as words, with or without commas."""
    return tuple(name for word in words for name in word.split(",") if name)
