"""`ambler eval relocalization`: switch a robot on at random places of known buildings; does it find out where it is?"""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, first_seed, write_summary

OWN = ("localization.initial_pose", "localization.covariance")


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "relocalization", help="a robot without a pose finds itself in a known map"
    )
    add_lost_options(parser)
    add_study_options(parser, 100, "starts in all worlds together")
    parser.set_defaults(run=run)


def add_lost_options(parser: argparse.ArgumentParser) -> None:
    """Add what this study and that of kidnappings share."""
    parser.add_argument("--worlds", default="office,warehouse", help="comma-separated (default: office,warehouse)")
    parser.add_argument("--robot", default="amr_omni", help="(default: amr_omni)")
    parser.add_argument("--localizer", choices=("tracker", "particles"), help="(default: tracker)")
    parser.add_argument("--resolution", type=float, default=0.05, help="of the known map, metres (default: 0.05)")


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when 97 % knew their place within 5 s and none was wrong."""
    from ambler.studies import lost_robot_study as lost

    settings, seed = study_settings(args, *OWN, takes_faults=False), first_seed(args)
    lost.lost_config(args.robot, settings)
    worlds = args.worlds.split(",")
    study = lost.relocalization_study(worlds, args.robot, args.runs, seed, args.resolution, settings)
    fields = lost.summarize_relocalization(conduct_study(args, study))
    low, high, share = fields["success_interval_low"], fields["success_interval_high"], fields["success_ratio"]
    print(f"{share:.1%} within {lost.TIME_LIMIT:g} s ({low:.1%} to {high:.1%} at 95 %), {fields['wrong']} wrong")
    write_summary(args, {"map_resolution_m": args.resolution, **fields}, [seed])
    return 0 if share >= lost.RELOCALIZED_LEAST and fields["wrong"] == 0 else 1
