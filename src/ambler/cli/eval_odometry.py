"""`ambler eval odometry BAG`: wheels and gyroscope of a real robot, fused, against its satellite positions."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, study_settings


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "odometry", help="fused odometry of a recorded drive outdoors, against satellite positions"
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="ROS 1 or ROS 2 bag with odometry, IMU and NavSatFix")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the tracks")
    parser.add_argument("--seed", type=int, default=0, help="recorded in the result; nothing is random here")
    add_settings(parser)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compare wheels alone and the filter; exit 1 when fusing does not help."""
    import time

    from ambler.apps.config import recorded_config
    from ambler.evaluation.odometry_quality import fused, largest_step, read_odometry_record, way_of, wheels_alone
    from ambler.evaluation.pictures import draw_tracks
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.wire.mcap_reader import cut_off

    config = recorded_config(study_settings(args, takes_faults=False).profile).odometry
    warm_up(imported_kernel_modules())
    begin = time.perf_counter()
    for note in cut_off(args.bag):
        print(note)
    record = read_odometry_record(args.bag)
    tracks = {
        "wheels": wheels_alone(record),
        "fused": fused(record, config),
    }
    fields: dict[str, Any] = {
        "seconds": (record.wheels[-1].stamp_ns - record.wheels[0].stamp_ns) * 1e-9,
        "way_m": way_of(tracks["wheels"]),
        "fixes": len(record.fixes),
    }
    for name, track in tracks.items():
        fields |= {
            f"{name}_error_rms_m": track.error.ate_rms_m,
            f"{name}_error_max_m": track.error.ate_max_m,
            f"{name}_largest_step_m": largest_step(track),
        }
    for name, value in fields.items():
        print(f"{name:24s} {value:10.3f}" if isinstance(value, float) else f"{name:24s} {value:10d}")
    if args.picture:
        drawn = {n: t.error.truth_from_estimate.transform(t.poses[:, :2]) for n, t in tracks.items()}
        draw_tracks(args.picture, {"satellites": record.fixes, **drawn})
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0 if fields["fused_error_rms_m"] < fields["wheels_error_rms_m"] else 1
