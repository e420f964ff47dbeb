"""`ambler eval variants`: 2-D SLAM on variants of recorded logs that should not matter."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, names_of, seeds_of, write_summary

SHARE_BAR = 0.95  # of the variants are to end good


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "variants", help="2-D SLAM on logs that are mirrored, reversed, thinned, clipped, driven with other wheels …"
    )
    parser.add_argument(
        "logs",
        nargs="+",
        type=Path,
        metavar="LOG",
        help="CARMEN log with a .relations or .tum file of its name beside it",
    )
    parser.add_argument(
        "--kinds",
        nargs="+",
        metavar="KIND",
        help="some kinds of variants only (default: all but `late`, for dense logs: scans that are stamped late)",
    )
    parser.add_argument(
        "--keyframes",
        nargs="+",
        type=Path,
        default=[],
        metavar="LOG",
        help="dense logs of which one scan per 0.4 to 1 m is kept first",
    )
    add_study_options(parser, 1, "draws of each kind that draws something")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Map all; 0 when at least 95 % of the variants are good."""
    from ambler.apps.config import recorded_config
    from ambler.core.errors import BadInputError
    from ambler.studies.log_variants import KINDS, OF_DENSE_LOGS
    from ambler.studies.log_variants_study import cases_of, log_variants_study, reference_of, summarize

    kinds = names_of(args.kinds) if args.kinds else tuple(kind for kind in KINDS if kind not in OF_DENSE_LOGS)
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise BadInputError(f"--kinds {unknown[0]}: one of {', '.join(KINDS)}")
    settings, seeds = study_settings(args, takes_faults=False), seeds_of(args)
    recorded_config(settings.profile)
    cases = [
        case
        for logs, is_keyframed in ((args.logs, False), (args.keyframes, True))
        for case in cases_of(
            [(str(log), str(reference_of(log))) for log in logs],
            kinds,
            seeds,
            is_keyframed=is_keyframed,
            settings=settings,
        )
    ]
    fields = summarize(conduct_study(args, log_variants_study(cases)), [case.place for case in cases])
    fields["is_met"] = fields["variants_good_ratio"] >= SHARE_BAR
    print_fields(fields, 48, ".4g")
    write_summary(args, fields, seeds)
    return 0 if fields["is_met"] else 1
