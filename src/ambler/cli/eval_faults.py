"""`ambler eval faults`: an exploration under every fault of the simulator, held against stated limits."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, study_settings


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "faults", help="explore under every fault; no collision, and limits or a named failure"
    )
    parser.add_argument("--only", default="", help="comma-separated names of cases (default: all)")
    parser.add_argument("--robots", default="diff,amr_omni", help="comma-separated (default: diff,amr_omni)")
    parser.add_argument("--seed", type=int, default=0, help="first seed (default: 0)")
    parser.add_argument("--runs", type=int, default=1, help="seeds per case (default: 1)")
    parser.add_argument("--processes", type=int, default=1, help="runs at the same time (default: 1)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    parser.add_argument("--resume", action="store_true", help="keep the runs whose results are in --out already")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the summary as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when no limit of any run is broken."""
    import time

    from ambler.apps.fault_study import WORLD, fault_cases, run_cases, summarize
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results

    wanted = set(filter(None, args.only.split(",")))
    names = sorted({case.name for case in fault_cases()})
    if wanted - set(names):
        raise BadInputError(f"no case {', '.join(sorted(wanted - set(names)))}; there are {', '.join(names)}")
    robots = set(args.robots.split(","))
    of_robots = [case for case in fault_cases() if case.robot.partition("+")[0] in robots]
    cases = [case for case in of_robots if not wanted or case.name in wanted]
    if not cases:
        raise BadInputError(f"no case for {args.robots}; there are some for diff and amr_omni")
    settings = study_settings(args)
    settings.check([WORLD], {case.robot for case in cases})
    started = time.perf_counter()
    seeds = range(args.seed, args.seed + args.runs)
    results = run_cases(cases, seeds, args.out, args.processes, settings, is_resumed=args.resume)
    _print_table(results)
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, summarize(results))
    return 0 if not any(result["broken"] for result in results) else 1


def _print_table(results: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="faults", title_justify="left")
    for column in ("fault", "robot", "seed", "ended", "collisions", "coverage", "error", "limits", "verdict"):
        table.add_column(column)
    for r in results:
        coverage, error = r.get("coverage_ratio"), r.get("ate_rms_m")
        table.add_row(
            *(r["fault"], r["robot"], str(r["seed"]), r["ended"], str(r.get("collisions"))),
            "unknown" if coverage is None else f"{coverage:.1%}",
            "unknown" if error is None else f"{100.0 * error:.1f} cm",
            *(r["limits"], "; ".join(r["broken"]) or "passed"),
        )
    Console(width=160).print(table)
