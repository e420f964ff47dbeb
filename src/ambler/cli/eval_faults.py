"""`ambler eval faults`: an exploration under every fault of the simulator, held against stated limits."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "faults", help="explore under every fault; no collision, and limits or a named failure"
    )
    parser.add_argument("--only", default="", help="comma-separated names of cases (default: all)")
    parser.add_argument("--robots", default="diff,amr_omni", help="comma-separated (default: diff,amr_omni)")
    add_study_options(parser, 1, "seeds per case")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0 when no limit of any run is broken."""
    from ambler.core.errors import BadInputError
    from ambler.studies.fault_study import WORLD, FaultRun, fault_cases, fault_study, summarize, told

    wanted = set(filter(None, args.only.split(",")))
    names = sorted({case.name for case in fault_cases()})
    if wanted - set(names):
        raise BadInputError(f"no case {', '.join(sorted(wanted - set(names)))}; there are {', '.join(names)}")
    robots = set(args.robots.split(","))
    of_robots = [case for case in fault_cases() if case.robot.partition("+")[0] in robots]
    cases = [case for case in of_robots if not wanted or case.name in wanted]
    if not cases:
        raise BadInputError(f"no case for {args.robots}; there are some for diff and amr_omni")
    settings, seeds = study_settings(args), seeds_of(args)
    settings.check([WORLD], {case.robot for case in cases})
    runs = [FaultRun(case, seed, settings) for case in cases for seed in seeds]
    results = [told(run, r) for run, r in zip(runs, conduct_study(args, fault_study(runs)), strict=True)]
    _print_table(results)
    write_summary(args, summarize(results), seeds)
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
