"""`ambler eval exploration`: many demonstrations over worlds, robots and seeds, each in its own process, and their summary."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, study_settings


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "exploration", help="explore worlds with robots over several seeds and summarize"
    )
    parser.add_argument("--worlds", nargs="+", default=["office"], help="default: office")
    parser.add_argument("--robots", nargs="+", default=["diff", "spot"], help="default: diff spot")
    parser.add_argument("--strategies", nargs="+", help="default: that of the settings, else tour")
    parser.add_argument("--seed", type=int, default=0, help="first seed (default: 0)")
    parser.add_argument("--runs", type=int, default=3, help="seeds per world and robot (default: 3)")
    parser.add_argument("--processes", type=int, default=1, help="runs at the same time (default: 1)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    parser.add_argument("--resume", action="store_true", help="keep the results that the folder of --out holds already")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the summary as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when every run ended with proof and without a collision."""
    import time

    from ambler.apps.campaign import Campaign, run_campaign, summarize
    from ambler.evaluation.results import write_results

    settings = study_settings(args)
    worlds, robots = _names(args.worlds), _names(args.robots)
    settings.check(worlds, robots)
    strategies = _names(args.strategies or [settings.profile.get("strategy", "tour")])
    campaign = Campaign(worlds, robots, strategies, tuple(range(args.seed, args.seed + args.runs)), settings)
    started = time.perf_counter()
    results = run_campaign(campaign, args.out, args.processes, is_resumed=args.resume)
    fields = summarize(results)
    for name, value in fields.items():
        print(f"{name:<48} {value:.4g}" if isinstance(value, float) else f"{name:<48} {value}")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    is_good = all(r.get("ended") == "finished" and r.get("collisions") == 0 for r in results)
    return 0 if is_good else 1


def _names(words: list[str]) -> tuple[str, ...]:
    """Return names given as words, with or without commas."""
    return tuple(name for word in words for name in word.split(",") if name)
