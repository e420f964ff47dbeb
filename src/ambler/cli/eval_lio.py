"""`ambler eval lio`: LiDAR-inertial odometry at drawn sites with a simulated plate in the hand."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "lio",
        help="LiDAR-inertial odometry at drawn sites: loops, halls, a tunnel, equal corridors, shaken, at rest, in dust, rain and smoke",
    )
    parser.add_argument(
        "--kinds",
        default="site",
        metavar="A,B",
        help="of site, hall, tunnel, twins, shaken, rest, dust, rain, smoke (default: site)",
    )
    parser.add_argument(
        "--lidars", default="vlp_16,mid_360,os_64", metavar="A,B", help="of vlp_16, mid_360, os_64 (default: all)"
    )
    parser.add_argument("--length", type=float, help="metres of the way (default: drawn, outdoors 70 to 1000)")
    parser.add_argument("--peer", action="store_true", help="run kiss-icp on the same scans")
    parser.add_argument("--keep-recordings", action="store_true", help="keep `recording` and `truth.tum` of each run")
    add_study_options(parser, 3, "drawn sites of each kind")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when every run meets the bar of its kind."""
    from ambler.apps.config import recorded_config
    from ambler.core.errors import BadInputError
    from ambler.studies.lio_peer import INSTALL, is_installed
    from ambler.studies.lio_study import LioCase, check, lio_study, summarize

    kinds, lidars = args.kinds.split(","), args.lidars.split(",")
    check(kinds, lidars)
    if args.length is not None and not 30.0 <= args.length <= 5000.0:
        raise BadInputError(f"--length {args.length}: between 30 and 5000 metres")
    if args.peer and not is_installed():
        raise BadInputError(INSTALL)
    settings, seeds = study_settings(args, takes_faults=False), seeds_of(args)
    recorded_config(settings.profile)
    cases = [
        LioCase(kind, seed, lidar, args.length, args.peer, args.keep_recordings, settings)
        for kind in kinds
        for seed in seeds
        for lidar in lidars
    ]
    fields = summarize(conduct_study(args, lio_study(cases)))
    print_fields(fields, 48, ".4g")
    write_summary(args, fields, seeds)
    return 0 if fields["is_met"] else 1
