"""`ambler eval relocalization`: switch a robot on at random places of known buildings; does it find out where it is?"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambler.cli.run_options import add_settings, study_settings

if TYPE_CHECKING:
    from ambler.apps.config import RobotConfig
    from ambler.apps.study_settings import StudySettings

TIME_LIMIT, SHARE_LEAST = 5.0, 0.97


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "relocalization", help="a robot without a pose finds itself in a known map"
    )
    add_campaign_arguments(parser, runs=100)
    parser.set_defaults(run=run)


def add_campaign_arguments(parser: argparse.ArgumentParser, runs: int) -> None:
    """Add what this campaign and that of kidnappings share."""
    parser.add_argument("--worlds", default="office,warehouse", help="comma-separated (default: office,warehouse)")
    parser.add_argument("--robot", default="amr_omni", help="(default: amr_omni)")
    parser.add_argument("--localizer", choices=("tracker", "particles"), help="(default: tracker)")
    parser.add_argument("--runs", type=int, default=runs, help=f"starts in all worlds together (default: {runs})")
    parser.add_argument("--seed", type=int, default=0, help="seed of every random number (default: 0)")
    parser.add_argument("--resolution", type=float, default=0.05, help="of the known map, metres (default: 0.05)")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/lost"), help="where drives are recorded, and reused from"
    )
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the result as JSON")


def campaign_settings(args: argparse.Namespace) -> tuple[StudySettings, RobotConfig]:
    """Return what the robot of a campaign is told, and what that makes of its defaults; raises BadInputError."""
    from ambler.apps.config import robot_config
    from ambler.sim.robots import robot_named

    settings = study_settings(args, "localization.initial_pose", "localization.covariance", takes_faults=False)
    config = robot_config(robot_named(args.robot).model, settings.profile, has_map=True)
    config.check_localizer()
    return settings, config


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when 97 % knew their place within 5 s and none was wrong."""
    import time

    from ambler.apps.localization_study import drawn_map
    from ambler.apps.lost_robot import relocalize
    from ambler.apps.random_drives import DRIVE_TIME, record_random_drives
    from ambler.evaluation.proportions import wilson_interval
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    settings, config = campaign_settings(args)
    warm_up(imported_kernel_modules())  # else the first robot would wait for the compiler
    started, worlds = time.perf_counter(), args.worlds.split(",")
    fields: dict[str, Any] = {}
    times: list[float] = []
    wrong = ambiguous = right = 0
    for k, world in enumerate(worlds):
        count = args.runs // len(worlds) + (k < args.runs % len(worlds))
        grid = drawn_map(world, args.robot, args.resolution)
        drives = record_random_drives(world, args.robot, count, args.seed, args.out, print, settings)
        here = 0
        for n, drive in enumerate(drives):
            found = relocalize(drive, args.robot, config, grid, DRIVE_TIME)
            wrong += found.wrong > 0
            ambiguous += found.found is None and found.wrong == 0
            is_right = found.found is not None and found.found <= TIME_LIMIT and found.wrong == 0
            right, here = right + is_right, here + is_right
            times += [found.found] if found.found is not None else []
            seconds = "never" if found.found is None else f"{found.found:.1f} s"
            print(f"{world} {n}: {seconds}, {found.wrong} wrong poses, {found.last_state}", flush=True)
        fields |= {f"{world}.runs": count, f"{world}.success_ratio": here / max(count, 1)}
    low, high = wilson_interval(right, args.runs)
    fields = {
        "runs": args.runs,
        "success_ratio": right / args.runs,
        "success_interval_low": low,
        "success_interval_high": high,
        "wrong": wrong,
        "wrong_ratio_at_most": wilson_interval(wrong, args.runs)[1],
        "ambiguous": ambiguous,
        **time_fields(times),
        "map_resolution_m": args.resolution,
        **fields,
    }
    print(f"{right} of {args.runs} within {TIME_LIMIT:g} s ({low:.1%} to {high:.1%} at 95 %), {wrong} wrong")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    return 0 if right >= SHARE_LEAST * args.runs and wrong == 0 else 1


def time_fields(times: list[float], prefix: str = "") -> dict[str, float | None]:
    """Return median and 95th percentile of times in seconds; None without any."""
    import numpy as np

    if not times:
        return {f"{prefix}time_median_s": None, f"{prefix}time_p95_s": None}
    median, p95 = np.percentile(times, [50, 95]).tolist()
    return {f"{prefix}time_median_s": median, f"{prefix}time_p95_s": p95}
