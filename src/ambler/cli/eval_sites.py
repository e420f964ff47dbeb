"""`ambler eval sites`: robots explore drawn sites with slopes and levels, and are judged by the surfaces that can be seen."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.site_options import add_site_options, sites_of, tell, words_of
from ambler.cli.study_options import conduct_study


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "sites", help="explore drawn sites with three dimensions: slopes, kerbs, garages of two levels"
    )
    add_site_options(parser, ("go2", "mecanum", "spot"))
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore all; 0 when all bars are met."""
    from ambler.studies.site_study import site_study, summarize

    kinds, robots, seeds, settings = sites_of(args)
    study = site_study(seeds, kinds, robots, words_of("--time-limit", args.time_limit), settings)
    return tell(args, summarize(conduct_study(args, study)), seeds)
