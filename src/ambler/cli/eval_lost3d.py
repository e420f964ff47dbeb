"""`ambler eval lost3d`: robots switched on at drawn places of drawn sites with a saved cloud; right, wrong or unsure."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.site_options import add_site_options, sites_of, tell
from ambler.cli.study_options import conduct_study


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "lost3d", help="robots switched on at drawn places of drawn sites with a saved cloud: right, wrong or unsure"
    )
    add_site_options(parser, ("go2",))
    parser.add_argument("--starts", type=int, default=60, help="places in each site (default: 60)")
    parser.add_argument("--moved", type=float, default=0.0, help="share of cars, trees and poles that stand elsewhere")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when no wrong place was told and hardly any start stayed unsure."""
    from ambler.core.errors import BadInputError
    from ambler.studies.lost_site_study import LostSiteCase, lost_site_study, summarize

    if not 1 <= args.starts <= 1000:
        raise BadInputError(f"--starts {args.starts}: between 1 and 1000")
    if not 0.0 <= args.moved <= 1.0:
        raise BadInputError(f"--moved {args.moved}: between 0 and 1")
    kinds, robots, seeds, settings = sites_of(args)
    seconds = 20.0 if args.time_limit is None else args.time_limit
    cases = [
        LostSiteCase(seed, kinds[k % len(kinds)], robot, args.starts, args.moved, seconds, settings)
        for k, seed in enumerate(seeds)
        for robot in robots
    ]
    return tell(args, summarize(conduct_study(args, lost_site_study(cases))), seeds)
