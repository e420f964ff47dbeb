"""`ambler eval program`: explore, dock, undock, drive to random goals and dock again, in one run and in the map just made."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, check_outputs, study_settings

DOCKING_ROBOT, DOCK = "amr_omni", "charger_1"


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    text = "explore, dock, undock, drive to random goals and dock again in one run"
    parser: argparse.ArgumentParser = subparsers.add_parser("program", help=text, description=text)
    parser.add_argument("--world", default="building", help="a world with a dock (default: building)")
    parser.add_argument("--robots", nargs="*", default=["amr_omni", "spot", "diff"], metavar="ROBOT")
    parser.add_argument("--runs", type=int, default=5, help="seeds per robot (default: 5)")
    parser.add_argument("--seed", type=int, default=0, help="the first seed (default: 0)")
    parser.add_argument("--processes", type=int, default=2, help="runs at once (default: 2)")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="where run folders are made (default: runs)")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run all; 0: every program succeeded without a collision."""
    import time

    from ambler.apps.program_study import ProgramCase, run_cases
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results

    if args.runs < 1 or args.processes < 1:
        raise BadInputError("--runs and --processes must be positive")
    settings = study_settings(args)
    settings.check([args.world], args.robots)
    check_outputs(args.json, args.out)
    started = time.perf_counter()
    cases = [
        ProgramCase(args.world, robot, args.seed + k, dock=DOCK if robot == DOCKING_ROBOT else None)
        for robot in args.robots
        for k in range(args.runs)
    ]
    results = run_cases(cases, args.out, args.processes, settings)
    fields: dict[str, Any] = {"world": args.world, "runs": len(cases)}
    for robot in args.robots:
        members = [r for case, r in zip(cases, results, strict=True) if case.robot == robot]
        fields |= _summary(robot, members)
    for case, result in zip(cases, results, strict=True):
        print(f"{case.label}: {result['ended']}, {result['collisions']} collisions, {result['text'] or 'all done'}")
    succeeded = sum(fields[f"{robot}.succeeded"] for robot in args.robots)
    fields |= {"succeeded": succeeded, "collisions": sum(r["collisions"] for r in results)}
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    return 0 if succeeded == len(cases) and fields["collisions"] == 0 else 1


def _summary(robot: str, members: list[dict[str, Any]]) -> dict[str, Any]:
    """Return flat fields `<robot>.<what>`: counts, and the worst values of all runs; what no run knows is None."""
    fields: dict[str, Any] = {
        f"{robot}.runs": len(members),
        f"{robot}.succeeded": sum(m["ended"] == "succeeded" for m in members),
        f"{robot}.ended": ", ".join(m["ended"] for m in members),
        f"{robot}.collisions": sum(m["collisions"] for m in members),
        f"{robot}.goals": sum(m["goals"] for m in members),
        f"{robot}.goals_reached": sum(m["goals_reached"] for m in members),
    }
    worst = {"reachable_coverage_ratio": min, "ate_unaligned_rms_m": max, "worst_goal_error_m": max}
    for name, of in {**worst, "dock_error_m": max, "dock_error_deg": max}.items():
        values = [m[name] for m in members if m.get(name) is not None]
        fields[f"{robot}.{name}_worst"] = of(values) if values else None
    return fields
