"""`ambler bench exploration`: path lengths and times of each strategy, with an ideal scanner and robot and the real mission."""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("exploration", help="path length of the exploration strategies on floor plans")
    parser.add_argument(
        "--data", type=Path, help="folder with floor plans, *.png, also deeper (default: $AMBLER_DATA/exploration)"
    )
    parser.add_argument("--strategies", default="tour,nearest,greedy", help="names, separated by commas")
    parser.add_argument("--resolution", type=float, default=0.0625, help="metres per pixel")
    parser.add_argument("--no-plans", action="store_true", help="worlds only")
    parser.add_argument("--every", type=int, default=1, help="take each n-th plan only")
    parser.add_argument(
        "--worlds",
        default="office,lab_empty,lab_obstacle,warehouse,maze,corridor,building",
        help="worlds by name, separated by commas",
    )
    parser.add_argument("--plan-range", type=float, default=5.0, help="how far the scanner sees in plans, metres")
    parser.add_argument("--world-range", type=float, default=20.0, help="how far the scanner sees in worlds, metres")
    parser.add_argument("--seed", type=int, default=0, help="unused: nothing is random here")
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore every plan with every strategy; exit 1 when an exploration ends without proof or below 98 % coverage."""
    from ambler.recordings.public_data import public_data
    from ambler.studies.bench_exploration import check_strategies, compare, compare_with_tours, measure
    from ambler.studies.exploration_places import plans_in, worlds_named

    data = public_data("exploration") if args.data is None and not args.no_plans else args.data
    begin = time.perf_counter()
    strategies = args.strategies.split(",")
    check_strategies(strategies)
    plans = [] if args.no_plans else plans_in(data, args.every, args.resolution, args.plan_range)
    places = [*worlds_named(args.worlds, args.world_range), *plans]
    found = measure(places, strategies, partial(print, flush=True))
    fields = {"plans": len(plans), "places": len(places), **compare(found.explorations)}
    fields |= compare_with_tours(found)
    print_fields(fields, 45)
    save_json(args, begin, fields)
    return 0 if found.is_good else 1
