"""`ambler eval overhangs`: tables, signs, bars and open drawers above the planar scanner, with depth cameras in the costmaps and without."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "overhangs", help="what hangs above a planar scanner: collisions with depth cameras and without"
    )
    parser.add_argument("--robot", default="porter+depth")
    parser.add_argument("--physics", choices=("contact", "kinematic"), default="contact")
    add_study_options(parser, 10, "rooms, each driven with voxels and without")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive all; 0 when with voxels every goal is reached and nothing is touched."""
    from ambler.studies.overhang_study import overhang_study, summarize

    settings, seeds = study_settings(args), seeds_of(args)
    fields = summarize(conduct_study(args, overhang_study(seeds, args.robot, args.physics, settings)))
    print_fields(fields, 40, ".4g")
    write_summary(args, fields, seeds)
    return 0 if fields["is_met"] else 1
