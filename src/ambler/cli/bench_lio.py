"""`ambler bench lio`: LiDAR-inertial odometry per scan beside kiss-icp, one thread, medians of processor time."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "lio", help="LiDAR-inertial odometry per scan, beside kiss-icp"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the hall (default: 0)")
    parser.add_argument("--runs", type=int, default=100, help="scans to measure (default: 100)")
    parser.add_argument("--no-peer", action="store_true", help="without kiss-icp")
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; 1 when one is slower than its bar."""
    from ambler.kernels.warmup import warm_up
    from ambler.studies.bench_lio import measure, meets_bars
    from ambler.studies.lio_peer import INSTALL, is_installed

    warm_up(["bvh", "inertial", "raycast", "voxel_map"])
    if not args.no_peer and not is_installed():
        print(f"without the peer: {INSTALL}")
    begin = time.perf_counter()
    fields = measure(args.seed, args.runs, peer=not args.no_peer)
    print_fields(fields, 24, ".4g")
    save_json(args, begin, fields)
    return 0 if meets_bars(fields) else 1
