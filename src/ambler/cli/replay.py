"""`ambler replay RUN`: feed a recording through the same nodes and compare every output, bit by bit."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

LIVE = "a live run: its nodes ran in parallel, so its outputs cannot come out equal; what it told of its pose is compared instead"


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "replay", help="feed a run's recording through the same nodes and compare the outputs"
    )
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="the folder of a run, such as runs/LATEST")
    parser.add_argument("--out", type=Path, help="folder for what the replay saves (default: RUN/replay)")
    parser.add_argument("--rate", type=float, help="at most this multiple of real time (default: as fast as possible)")
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replay and compare; 1 when an output differs, or a live run's poses more than they may."""
    import time

    from ambler.apps.replay import replay_run
    from ambler.cli.results_output import check_targets
    from ambler.evaluation.pose_difference import TOLERANCE
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.wire.mcap_reader import cut_off

    check_targets(args.json, args.out)
    for note in cut_off(args.run_folder / "recording"):
        print(note)
    warm_up(imported_kernel_modules())
    started = time.perf_counter()
    replay = replay_run(args.run_folder, args.out, args.rate)
    result, poses = replay.comparison, replay.poses
    print(result if poses is None else LIVE)
    if poses is not None:
        print(
            f"{poses.common} of {poses.recorded} poses told again; median {1e3 * poses.median_m:.1f} mm, 95 % within "
            f"{1e3 * poses.p95_m:.1f} mm (tolerance {1e3 * TOLERANCE:.0f} mm)"
        )
    for topic in result.topics:
        print(f"  {topic.topic:<28} {topic.equal_count:7d} of {topic.reference_count} equal")
    if args.json:
        fields = {
            "is_good": replay.is_good,
            "is_live": poses is not None,
            "is_equal": result.is_equal,
            "pose_difference_p95_m": None if poses is None else poses.p95_m,
            "equal_messages": result.equal_count,
            "topics": len(result.topics),
            "first_difference": None if result.first_difference is None else str(result.first_difference),
        }
        write_results(args.json, args.command_line, None, time.perf_counter() - started, fields)
    return 0 if replay.is_good else 1
