"""`ambler bench odometry`: the share of one core that LiDAR-inertial odometry takes on a robot that is driven."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "odometry", help="share of one core that LiDAR-inertial odometry and localization in a cloud take on a robot"
    )
    parser.add_argument("--world", default="campus", help="a world with a route of its own (default: campus)")
    parser.add_argument("--robot", default="go2", help="a robot with a LiDAR of many rings and an IMU (default: go2)")
    parser.add_argument("--map", type=Path, metavar="CLOUD", help="localize in this saved cloud instead of mapping")
    parser.add_argument("--seconds", type=float, default=60.0, help="seconds of the robot (default: 60)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where the run folder is made")
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; 1 when odometry takes more of a core than its bar."""
    from ambler.core.errors import BadInputError
    from ambler.studies.bench_odometry import FIRST, measure

    if args.seconds <= 2.0 * FIRST:
        raise BadInputError(f"--seconds {args.seconds:g}: more than {2.0 * FIRST:g} s")
    begin = time.perf_counter()
    fields = measure(args.world, args.robot, args.seed, args.seconds, args.out, args.map)
    print_fields(fields, 32, ".4g")
    save_json(args, begin, fields)
    return 0 if fields["is_met"] else 1
