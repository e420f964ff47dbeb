"""`ambler eval relocalization3d`: random starts in saved clouds of drawn places on another day, with a guess and without any."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "relocalization3d", help="random starts in saved clouds of drawn places, 10 %% of the solids changed"
    )
    parser.add_argument(
        "--kinds", default="site,hall,decks", metavar="A,B", help="of site, hall, decks (default: all three)"
    )
    parser.add_argument("--lidar", default="mid_360", help="of vlp_16, mid_360, os_64 (default: mid_360)")
    parser.add_argument("--starts", type=int, default=20, help="starts in each map (default: 20)")
    parser.add_argument("--walk", type=float, help="metres walked from each start (default: drawn, 18 to 26)")
    parser.add_argument("--foreign", action="store_true", help="look for each start in the map of another place, too")
    add_study_options(parser, 1, "drawn maps of each kind")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when the bars are met."""
    from ambler.apps.config import recorded_config
    from ambler.core.errors import BadInputError
    from ambler.studies.cloud_relocalization_study import (
        CloudRelocalizationCase,
        check,
        cloud_relocalization_study,
        summarize,
    )

    kinds = args.kinds.split(",")
    check(kinds, args.lidar)
    if not 1 <= args.starts <= 1000:
        raise BadInputError(f"--starts {args.starts}: between 1 and 1000")
    if args.walk is not None and not 10.0 <= args.walk <= 20_000.0:
        raise BadInputError(f"--walk {args.walk}: between 10 and 20000 metres")
    settings, seeds = study_settings(args, takes_faults=False), seeds_of(args)
    recorded_config(settings.profile)
    cases = [
        CloudRelocalizationCase(kind, seed, args.lidar, args.starts, args.walk, args.foreign, settings=settings)
        for kind in kinds
        for seed in seeds
    ]
    fields = summarize(conduct_study(args, cloud_relocalization_study(cases)))
    print_fields(fields, 48, ".4g")
    write_summary(args, fields, seeds)
    return 0 if fields["is_met"] else 1
