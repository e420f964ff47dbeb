"""`ambler eval calibration`: mountings and clock offsets of scanners from simulated drives, against the truth."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser(
        "calibration", help="mountings and clock offsets of scanners from a minute of driving"
    )
    parser.add_argument(
        "--robot",
        default="amr_omni",
        help="a robot whose scanners sit a little beside their drawing, or `differential`, `omni`: a base with three scanners"
        " anywhere (default: amr_omni)",
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each drive (default: 60)")
    add_study_options(parser, 10, "random mountings")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Calibrate every drive; exit 1 when any error is beyond 5 mm, 0.1° or 2 ms."""
    from ambler.apps.config import recorded_config
    from ambler.studies.calibration_study import CalibrationCase, calibration_study, summarize

    settings, seeds = study_settings(args, takes_faults=False), seeds_of(args)
    recorded_config(settings.profile)
    cases = [CalibrationCase(args.robot, seed, args.seconds, settings) for seed in seeds]
    fields = summarize(conduct_study(args, calibration_study(cases)))
    print(f"{fields['within_bars']} of {args.runs} runs within 5 mm, 0.1° and 2 ms")
    write_summary(args, {"robot": args.robot, **fields, "drive_seconds": args.seconds}, seeds)
    return 0 if fields["within_bars"] == args.runs else 1
