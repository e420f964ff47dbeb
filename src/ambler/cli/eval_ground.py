"""`ambler eval ground`: what the terrain analysis makes of floors, drops, kerbs and slopes that nobody has seen, with mounts that are off."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "ground", help="terrain analysis: false obstacles, drops, kerbs, slopes"
    )
    add_study_options(parser, 10, "sites for each robot and kind of ground")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive all; 0 when at most 0.1 % of a flat floor is false and every drop, kerb and slope is told right."""
    from ambler.studies.ground_study import ground_study, summarize

    settings, seeds = study_settings(args, takes_faults=False), seeds_of(args)
    fields = summarize(conduct_study(args, ground_study(seeds, settings)))
    print_fields(fields, 40, ".4g")
    write_summary(args, fields, seeds)
    return 0 if fields["is_met"] else 1
