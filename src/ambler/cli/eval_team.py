"""`ambler eval team`: two robots explore one building in one process; both must end with proof, and both recordings must replay."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, check_outputs, study_settings


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "two robots explore one building in one process, told apart by a prefix"
    parser: argparse.ArgumentParser = subparsers.add_parser("team", help=text, description=text)
    parser.add_argument("--world", default="building", help="a world (default: building)")
    parser.add_argument("--robot", default="diff", help="what both are (default: diff)")
    parser.add_argument("--runs", type=int, default=1, help="seeds (default: 1)")
    parser.add_argument("--seed", type=int, default=0, help="the first seed (default: 0)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0: all ended with proof, without a collision, and replayed to the same bits."""
    import time

    from ambler.apps.program_study import run_team
    from ambler.evaluation.results import write_results

    settings = study_settings(args)
    settings.check([args.world], [args.robot])
    check_outputs(args.json, args.out)
    started = time.perf_counter()
    fields: dict[str, Any] = {"world": args.world, "robot": args.robot, "runs": args.runs}
    is_good = True
    for seed in range(args.seed, args.seed + args.runs):
        for name, result in run_team(args.world, args.robot, seed, args.out, settings).items():
            for key in ("ended", "collisions", "reachable_coverage_ratio", "ate_rms_m", "is_replay_equal"):
                fields[f"{seed}.{name}.{key}"] = result[key]
            fields[f"{seed}.sim_seconds"] = result["sim_seconds"]
            fields[f"{seed}.real_time_factor"] = result["real_time_factor"]
            is_good &= result["ended"] == "finished" and result["collisions"] == 0 and result["is_replay_equal"]
            print(f"{name}, seed {seed}: {result['ended']}, {result['collisions']} collisions", flush=True)
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    return 0 if is_good else 1
