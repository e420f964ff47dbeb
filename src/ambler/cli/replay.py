"""`ambler replay RUN`: feed a recording through the same nodes and compare every output, bit by bit."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "replay", help="feed a run's recording through the same nodes and compare the outputs"
    )
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="a folder that `ambler demo` made")
    parser.add_argument("--out", type=Path, help="folder for what the replay saves (default: RUN/replay)")
    parser.add_argument("--rate", type=float, help="at most this multiple of real time (default: as fast as possible)")
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replay and compare; 1 when an output differs."""
    import time

    from ambler.apps.replay import replay_run
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    warm_up(imported_kernel_modules())
    started = time.perf_counter()
    result = replay_run(args.run_folder, args.out, args.rate)
    print(result)
    for topic in result.topics:
        print(f"  {topic.topic:<28} {topic.equal_count:7d} of {topic.reference_count} equal")
    if args.json:
        fields = {
            "is_equal": result.is_equal,
            "equal_messages": result.equal_count,
            "topics": len(result.topics),
            "first_difference": None if result.first_difference is None else str(result.first_difference),
        }
        write_results(args.json, f"ambler replay {args.run_folder}", None, time.perf_counter() - started, fields)
    return 0 if result.is_equal else 1
