"""`ambler eval exploration`: many demonstrations over worlds, robots and seeds, each in its own process, and their summary."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, names_of, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "exploration", help="explore worlds with robots over several seeds and summarize"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--worlds", nargs="+", default=["office"], help="default: office")
    where.add_argument(
        "--places",
        nargs="+",
        metavar="PLACES",
        help="fresh:N (N plans drawn for this campaign) and development (built-in worlds, public plans), side by side; bars count on fresh ones",
    )
    parser.add_argument(
        "--kinds", nargs="+", help="kinds of fresh places (default: those that are closed, up to 1500 m²)"
    )
    parser.add_argument("--robots", nargs="+", default=["diff", "spot"], help="default: diff spot")
    parser.add_argument("--strategies", nargs="+", help="default: that of the settings, else tour")
    parser.add_argument("--time-limit", type=float, help="simulated seconds per run (default: that of `ambler demo`)")
    add_study_options(parser, 3, "seeds per world and robot")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when every run ended with proof and without a collision, or fresh places met all bars."""
    from itertools import product

    from ambler.studies.exploration_study import ExplorationCase, exploration_study, is_good, summarize

    if args.places:
        return _campaign(args)
    settings = study_settings(args)
    worlds, robots = names_of(args.worlds), names_of(args.robots)
    settings.check(worlds, robots)
    strategies = names_of(args.strategies or [settings.profile.get("strategy", "tour")])
    options = () if args.time_limit is None else ("--time-limit", str(args.time_limit))
    seeds = seeds_of(args)
    cases = [ExplorationCase(*case, options, settings) for case in product(worlds, robots, strategies, seeds)]
    results = conduct_study(args, exploration_study(cases))
    fields = summarize(results)
    print_fields(fields, 48, ".4g")
    write_summary(args, fields, seeds)
    return 0 if all(map(is_good, results)) else 1


def _campaign(args: argparse.Namespace) -> int:
    """Explore fresh places beside those of development."""
    from ambler.core.errors import BadInputError
    from ambler.studies import exploration_campaign as campaign
    from ambler.studies.exploration_study import exploration_study

    settings = study_settings(args)
    robots, kinds = names_of(args.robots), names_of(args.kinds or list(campaign.CLOSED_KINDS))
    fresh_count, has_development = campaign.parse_places(names_of(args.places))
    campaign.check_kinds(kinds)
    if args.strategies:
        raise BadInputError("--places compares places: choose one strategy with --set strategy=…")
    args.runs = max(1, fresh_count)
    seeds = seeds_of(args)
    fresh = campaign.fresh_places(kinds, seeds[:fresh_count])
    development = campaign.development_places() if has_development else ()
    settings.check((*fresh, *development), robots)
    options = () if args.time_limit is None else ("--time-limit", str(args.time_limit))
    cases = campaign.cases_of(fresh, development, robots, seeds, options, settings)
    fields = campaign.summarize(conduct_study(args, exploration_study(cases)))
    print("\n".join(campaign.table(fields)))
    write_summary(args, {"fresh_places": ",".join(fresh), **fields}, seeds)
    return 0 if all(value for name, value in fields.items() if name.startswith("bars.")) else 1
