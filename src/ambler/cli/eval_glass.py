"""`ambler eval glass`: explore a world of glass with and without ultrasonic ring and glass layers, and count contacts."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, study_settings


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "glass", help="contacts with glass, with and without the layers that know it"
    )
    parser.add_argument("--world", default="glass", help="a world with panes of glass (default: glass)")
    parser.add_argument("--robots", default="diff,amr_omni", help="comma-separated (default: diff,amr_omni)")
    parser.add_argument("--only", choices=("with_layers", "without_layers"), help="one of the two variants")
    parser.add_argument("--seed", type=int, default=0, help="first seed (default: 0)")
    parser.add_argument("--runs", type=int, default=3, help="seeds per robot and variant (default: 3)")
    parser.add_argument("--time-limit", type=float, default=600.0, help="simulated seconds per run (default: 600)")
    parser.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    parser.add_argument("--processes", type=int, default=1, help="runs at the same time (default: 1)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    parser.add_argument("--resume", action="store_true", help="keep the runs whose results are in --out already")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the summary as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when every run with the layers ended with proof and without a contact."""
    import time

    from ambler.apps.glass_study import WITH, WITHOUT, GlassStudy, run_study, summarize
    from ambler.evaluation.results import write_results

    robots = tuple(args.robots.split(","))
    settings = study_settings(args, "glass")
    settings.check([args.world], [*robots, *(f"{robot}+ultrasonic" for robot in robots)])
    variants = (WITH, WITHOUT) if args.only is None else (args.only,)
    seeds = tuple(range(args.seed, args.seed + args.runs))
    study = GlassStudy(args.world, robots, variants, seeds, args.time_limit, args.kinematic, settings)
    started = time.perf_counter()
    results = run_study(study, args.out, args.processes, is_resumed=args.resume)
    fields = summarize(results)
    for name, value in fields.items():
        print(f"{name:<48} {value:.4g}" if isinstance(value, float) else f"{name:<48} {value}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    judged = [r for r in results if r["variant"] == WITH]
    return 0 if all(r["ended"] == "finished" and r.get("contacts") == 0 for r in judged) else 1
