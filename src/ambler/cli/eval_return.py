"""`ambler eval return`: robots explore drawn sites and save them; switched on elsewhere later, they find their place and drive to way-points."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, names_of, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "return", help="explore drawn sites and save them; start elsewhere, relocalize, drive to way-points"
    )
    parser.add_argument("--kinds", nargs="+", default=["plot", "garage"], help="in turn (default: plot garage)")
    parser.add_argument("--robots", nargs="+", default=["go2"], help="default: go2")
    parser.add_argument("--way-points", type=int, default=5, help="way-points of each return (default: 5)")
    parser.add_argument(
        "--time-limit", type=float, help="simulated seconds per exploration (default: that of `ambler demo`)"
    )
    parser.add_argument(
        "--return-time-limit", type=float, help="simulated seconds per return (default: that of `ambler navigate`)"
    )
    parser.add_argument("--radius", type=float, metavar="M", help="explore no farther than this from the start, metres")
    add_study_options(parser, 2, "sites")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore and come back; 0 when every run did all of it, without a collision."""
    from ambler.core.errors import BadInputError
    from ambler.sim.generator.spatial import SPATIAL_KINDS
    from ambler.studies.return_study import ReturnCase, return_study, summarize

    kinds, robots = names_of(args.kinds), names_of(args.robots)
    for kind in kinds:
        if kind not in SPATIAL_KINDS:
            raise BadInputError(f"--kinds {kind!r}: there are {', '.join(SPATIAL_KINDS)}")
    if args.way_points < 1:
        raise BadInputError(f"--way-points {args.way_points}: needs at least 1")
    settings, seeds = study_settings(args), seeds_of(args)
    settings.check([f"{kinds[0]}-{seeds[0]}"], robots)
    exploring, returning = (_words("--time-limit", limit) for limit in (args.time_limit, args.return_time_limit))
    cases = [
        ReturnCase(seed, kinds[k % len(kinds)], robot, args.way_points, exploring, returning, settings)
        for k, seed in enumerate(seeds)
        for robot in robots
    ]
    fields = summarize(conduct_study(args, return_study(cases)))
    print_fields(fields, 52, ".4g")
    write_summary(args, fields, seeds)
    return 0 if all(value for name, value in fields.items() if name.startswith("bars.")) else 1


def _words(option: str, value: float | None) -> tuple[str, ...]:
    return () if value is None else (option, str(value))
