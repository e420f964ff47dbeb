"""`ambler bench memory`: whether memory stays flat over kilometres of a walk, and over half an hour of a drive."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "memory", help="whether memory stays flat over kilometres, and over half an hour of a whole robot"
    )
    parser.add_argument(
        *("what",), choices=("walk", "drive"), help="walk: odometry and loop closure alone; drive: a whole robot"
    )
    parser.add_argument("--length", type=float, default=5000.0, help="metres of the walk (default: 5000)")
    parser.add_argument("--lidar", default="mid_360", help="scanner of the walk (default: mid_360)")
    parser.add_argument(
        "--world", default="campus", help="world of the drive, with a route of its own (default: campus)"
    )
    parser.add_argument("--robot", default="go2", help="robot of the drive, with a LiDAR and an IMU (default: go2)")
    parser.add_argument("--seconds", type=float, default=1800.0, help="seconds of the drive that count (default: 1800)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where the run folder of a drive is made")
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; 1 when memory grew by more than its bar."""
    from ambler.core.errors import BadInputError
    from ambler.sim.hand_rig import LIDARS
    from ambler.studies.bench_memory import PARTS, PERIOD, measure_drive, measure_walk

    if args.lidar not in LIDARS:
        raise BadInputError(f"--lidar {args.lidar}: one of {', '.join(LIDARS)}")
    if not 300.0 <= args.length <= 20000.0:
        raise BadInputError(f"--length {args.length:g}: between 300 and 20000 m")
    least = 2.0 * PARTS * PERIOD
    if not args.seconds >= least:
        raise BadInputError(f"--seconds {args.seconds:g}: at least {least:g} s")
    begin = time.perf_counter()
    if args.what == "walk":
        fields = measure_walk(args.length, args.lidar, args.seed)
    else:
        fields = measure_drive(args.world, args.robot, args.seconds, args.seed, args.out)
    print_fields(fields, 24, ".4g")
    save_json(args, begin, fields)
    return 0 if fields["is_met"] else 1
