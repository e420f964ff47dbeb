"""`ambler eval real3d`: what an IMU alone leads to, and how two clouds are laid on one another, on real recordings with published answers."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ambler.cli.results_output import print_fields, save_json
from ambler.cli.run_options import add_settings, study_settings


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "real3d", help="a real IMU and two real clouds against what is published of them"
    )
    parser.add_argument(
        "--data", type=Path, help="folder with imu_deskew and pair3d (default: $AMBLER_DATA; docs/datasets.md)"
    )
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the two clouds, from above")
    parser.add_argument("--seed", type=int, default=0, help="of the guesses that are drawn")
    add_settings(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; 1 when a drawn guess does not lead to the published relation."""
    from ambler.apps.config import recorded_config
    from ambler.evaluation.cloud_views import draw_laid
    from ambler.recordings.public_data import public_data
    from ambler.studies.real_recordings import measure_inertial, measure_pair

    loops = recorded_config(study_settings(args, takes_faults=False).profile).lio.loops
    inertial, clouds = (args.data / n if args.data else public_data(n) for n in ("imu_deskew", "pair3d"))
    begin = time.perf_counter()
    pair, laid = measure_pair(clouds, args.seed, loops)
    fields = measure_inertial(inertial) | pair
    if args.picture:
        draw_laid(args.picture, laid.target, laid.source)
    print_fields(fields, 40, ".4g")
    save_json(args, begin, fields)
    return 0 if pair["pair.starts_found"] == pair["pair.starts"] else 1
