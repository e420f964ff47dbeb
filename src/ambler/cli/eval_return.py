"""`ambler eval return`: robots explore drawn sites and save them; switched on elsewhere later, they find their place and drive to way-points."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.site_options import add_site_options, sites_of, tell, words_of
from ambler.cli.study_options import conduct_study


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "return", help="explore drawn sites and save them; start elsewhere, relocalize, drive to way-points"
    )
    add_site_options(parser, ("go2",))
    parser.add_argument("--way-points", type=int, default=5, help="way-points of each return (default: 5)")
    parser.add_argument(
        "--return-time-limit", type=float, help="simulated seconds per return (default: that of `ambler navigate`)"
    )
    parser.add_argument("--radius", type=float, metavar="M", help="explore no farther than this from the start, metres")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore and come back; 0 when every run did all of it, without a collision."""
    from ambler.core.errors import BadInputError
    from ambler.studies.return_study import ReturnCase, return_study, summarize

    if args.way_points < 1:
        raise BadInputError(f"--way-points {args.way_points}: needs at least 1")
    kinds, robots, seeds, settings = sites_of(args)
    exploring, returning = (words_of("--time-limit", limit) for limit in (args.time_limit, args.return_time_limit))
    cases = [
        ReturnCase(seed, kinds[k % len(kinds)], robot, args.way_points, exploring, returning, settings)
        for k, seed in enumerate(seeds)
        for robot in robots
    ]
    return tell(args, summarize(conduct_study(args, return_study(cases))), seeds)
