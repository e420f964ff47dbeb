"""`ambler eval kidnapping`: carry a robot elsewhere without notice; does it notice, and find itself again?"""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.eval_relocalization import OWN, add_lost_options
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, first_seed, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "kidnapping", help="a robot that is carried elsewhere notices and finds itself again"
    )
    add_lost_options(parser)
    parser.add_argument(
        "--drives", type=int, default=20, help="random drives per world to draw pairs from (default: 20)"
    )
    add_study_options(parser, 30, "kidnappings in all worlds together")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when 95 % noticed within 2 s and were right again within 10 s, and none told a wrong pose after it had noticed."""
    from ambler.studies import lost_robot_study as lost

    settings, seed = study_settings(args, *OWN, takes_faults=False), first_seed(args)
    lost.lost_config(args.robot, settings)
    worlds = args.worlds.split(",")
    study = lost.kidnapping_study(worlds, args.robot, args.runs, args.drives, seed, args.resolution, settings)
    fields = lost.summarize_kidnapping(conduct_study(args, study))
    low, high, share = fields["success_interval_low"], fields["success_interval_high"], fields["success_ratio"]
    print(f"{share:.1%} noticed and recovered in time ({low:.1%} to {high:.1%} at 95 %), {fields['wrong']} wrong")
    write_summary(args, {"map_resolution_m": args.resolution, **fields}, [seed])
    return 0 if share >= lost.RECOVERED_LEAST and fields["wrong"] == 0 else 1
