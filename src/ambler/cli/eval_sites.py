"""`ambler eval sites`: robots explore drawn sites with slopes and levels, and are judged by the surfaces that can be seen."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, names_of, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "sites", help="explore drawn sites with three dimensions: slopes, kerbs, garages of two levels"
    )
    parser.add_argument("--kinds", nargs="+", default=["plot", "garage"], help="in turn (default: plot garage)")
    parser.add_argument("--robots", nargs="+", default=["go2", "mecanum"], help="default: go2 mecanum")
    parser.add_argument("--time-limit", type=float, help="simulated seconds per run (default: that of `ambler demo`)")
    add_study_options(parser, 2, "sites")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore all; 0 when all bars are met."""
    from ambler.core.errors import BadInputError
    from ambler.sim.generator.spatial import SPATIAL_KINDS
    from ambler.studies.site_study import site_study, summarize

    kinds, robots = names_of(args.kinds), names_of(args.robots)
    for kind in kinds:
        if kind not in SPATIAL_KINDS:
            raise BadInputError(f"--kinds {kind!r}: there are {', '.join(SPATIAL_KINDS)}")
    settings = study_settings(args)
    seeds = seeds_of(args)
    settings.check([f"{kinds[0]}-{seeds[0]}"], robots)
    options = () if args.time_limit is None else ("--time-limit", str(args.time_limit))
    fields = summarize(conduct_study(args, site_study(seeds, kinds, robots, options, settings)))
    print_fields(fields, 52, ".4g")
    write_summary(args, fields, seeds)
    return 0 if all(value for name, value in fields.items() if name.startswith("bars.")) else 1
