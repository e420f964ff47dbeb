"""`ambler eval campus`: 2-D SLAM on drives of a kilometre through campuses that nobody has seen."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "campus", help="2-D SLAM on dense logs of drawn campuses: errors, false closures, bend"
    )
    parser.add_argument("--scanner", help="scanner_360 (20 m) or safety_270 (40 m) (default: drawn for each)")
    parser.add_argument(
        "--keep-logs", action="store_true", help="keep `recording` and `truth.tum` in each case's folder"
    )
    add_study_options(parser, 3, "drawn campuses")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Map all; 0 when no closure is false, no map bent by more than 0.3 m, and the median error at most 0.1 m."""
    from ambler.apps.config import recorded_config
    from ambler.core.errors import BadInputError
    from ambler.studies.campus_log import SCANNERS
    from ambler.studies.campus_study import CampusCase, campus_study, summarize

    if args.scanner is not None and args.scanner not in SCANNERS:
        raise BadInputError(f"--scanner {args.scanner}: one of {', '.join(SCANNERS)}")
    settings, seeds = study_settings(args, takes_faults=False), seeds_of(args)
    recorded_config(settings.profile)
    cases = [CampusCase(seed, args.scanner, args.keep_logs, settings) for seed in seeds]
    fields = summarize(conduct_study(args, campus_study(cases)))
    print_fields(fields, 48, ".4g")
    write_summary(args, fields, seeds)
    return 0 if fields["is_met"] else 1
