"""`ambler eval glass`: explore a world of glass with an ultrasonic ring and with planar scanners alone, and count contacts."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "glass", help="contacts with glass, with an ultrasonic ring and without"
    )
    parser.add_argument("--world", default="glass", help="a world with panes of glass (default: glass)")
    parser.add_argument("--robots", default="diff,amr_omni,spot", help="comma-separated (default: diff,amr_omni,spot)")
    parser.add_argument("--only", choices=("ring", "light"), help="one of the two variants")
    parser.add_argument("--time-limit", type=float, default=600.0, help="simulated seconds per run (default: 600)")
    parser.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    add_study_options(parser, 3, "seeds per robot and variant")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when every run ended with proof and without a contact."""
    from itertools import product

    from ambler.studies.glass_study import LIGHT, RING, GlassCase, glass_study, is_good, summarize

    robots = tuple(args.robots.split(","))
    settings = study_settings(args, "glass")
    settings.check([args.world], [*robots, *(f"{robot}+ultrasonic" for robot in robots)])
    variants = (RING, LIGHT) if args.only is None else (args.only,)
    seeds = seeds_of(args)
    cases = [
        GlassCase(robot, variant, seed, args.world, args.time_limit, args.kinematic, settings)
        for robot, variant, seed in product(robots, variants, seeds)
    ]
    results = conduct_study(args, glass_study(cases))
    fields = summarize(results)
    print_fields(fields, 48, ".4g")
    write_summary(args, fields, seeds)
    return 0 if all(map(is_good, results)) else 1
