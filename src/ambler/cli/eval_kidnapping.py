"""`ambler eval kidnapping`: carry a robot elsewhere without notice; does it notice, and find itself again?"""

from __future__ import annotations

import argparse
from typing import Any

NOTICE_LIMIT, RECOVERY_LIMIT, SHARE_LEAST = 2.0, 10.0, 0.95


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    from ambler.cli.eval_relocalization import add_campaign_arguments

    parser: argparse.ArgumentParser = subparsers.add_parser(
        "kidnapping", help="a robot that is carried elsewhere notices and finds itself again"
    )
    add_campaign_arguments(parser, runs=30)
    parser.add_argument(
        "--drives", type=int, default=20, help="random drives per world to draw pairs from (default: 20)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when 95 % noticed within 2 s and were right again within 10 s, and none told a wrong pose after it had noticed."""
    import time

    import numpy as np

    from ambler.apps.localization_study import drawn_map
    from ambler.apps.lost_robot import kidnap, pairs_far_apart
    from ambler.apps.random_drives import record_random_drives
    from ambler.cli.eval_relocalization import campaign_settings, time_fields
    from ambler.evaluation.proportions import wilson_interval
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    settings, config = campaign_settings(args)
    warm_up(imported_kernel_modules())  # else the first robot would wait for the compiler
    started, worlds = time.perf_counter(), args.worlds.split(",")
    noticed: list[float] = []
    recovered: list[float] = []
    good = wrong = 0
    for k, world in enumerate(worlds):
        count = args.runs // len(worlds) + (k < args.runs % len(worlds))
        grid = drawn_map(world, args.robot, args.resolution)
        drives = record_random_drives(world, args.robot, args.drives, args.seed, args.out, print, settings)
        rng = np.random.default_rng([args.seed, *world.encode()])
        for before, after in pairs_far_apart(drives, count, rng):
            result = kidnap(before, after, args.robot, config, grid)
            noticed += [result.noticed] if result.noticed is not None else []
            recovered += [result.found] if result.found is not None else []
            wrong += result.wrong > 0
            in_time = result.noticed is not None and result.noticed <= NOTICE_LIMIT
            is_back = result.found is not None and result.found <= RECOVERY_LIMIT
            good += in_time and is_back
            print(f"{world}: noticed {result.noticed} s, found {result.found} s, {result.wrong} wrong", flush=True)
    low, high = wilson_interval(good, args.runs)
    fields: dict[str, Any] = {
        "runs": args.runs,
        "success_ratio": good / args.runs,
        "success_interval_low": low,
        "success_interval_high": high,
        "noticed": len(noticed),
        "noticed_in_time": sum(t <= NOTICE_LIMIT for t in noticed),
        "recovered_in_time": sum(t <= RECOVERY_LIMIT for t in recovered),
        "wrong": wrong,
        **time_fields(noticed, "noticed_"),
        **time_fields(recovered, "recovered_"),
        "map_resolution_m": args.resolution,
    }
    print(f"{good} of {args.runs} noticed and recovered in time ({low:.1%} to {high:.1%} at 95 %), {wrong} wrong")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    return 0 if good >= SHARE_LEAST * args.runs and wrong == 0 else 1
