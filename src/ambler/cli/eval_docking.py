"""`ambler eval docking`: how precisely docks are seen, how exactly, how often and how fast the robot docks, beside the source."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, study_settings

PARTS = ("sights", "approach", "random", "faults")
WORLD, DOCK = "dock_hall", "charger_1"
OUT = "runs/docking"


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser("docking", help="precision, success and times of docking")
    parser.add_argument("--runs", type=int, default=20, help="random starts (default: 20; 60 before a release)")
    parser.add_argument("--fault-runs", type=int, default=2, help="runs per fault (default: 2; 20 before a release)")
    parser.add_argument("--fault", action="append", metavar="NAME", help="only this fault; may be repeated")
    parser.add_argument("--looks", type=int, default=100, help="pictures per series of looks (default: 100)")
    parser.add_argument("--world", default=WORLD, help=f"a world with docks (default: {WORLD})")
    parser.add_argument(
        "--dock", default=DOCK, help=f"the dock; only {DOCK} has approaches and faults (default: {DOCK})"
    )
    parser.add_argument("--only", choices=PARTS, action="append", help="only this part; may be repeated")
    parser.add_argument("--seed", type=int, default=0, help="first seed (default: 0)")
    parser.add_argument("--out", type=Path, help=f"results of every run, pictures (default: {OUT}, or {OUT}_DOCK)")
    parser.add_argument("--pictures", type=Path, help="where box plots go (default: --out)")
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the summary as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; a study that was interrupted goes on. 0: all docked within two attempts, or failed by a fault with a name."""
    import time

    from ambler.apps import docking_study as study
    from ambler.apps.config import robot_config
    from ambler.apps.docking_scans import measure_scan_sights
    from ambler.core.errors import BadInputError
    from ambler.evaluation import docking, docking_pictures
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.nodes.steps import DockStep
    from ambler.sim.robots import robot_named

    if min(args.runs, args.fault_runs, args.looks) < 1:
        raise BadInputError("--runs, --fault-runs and --looks must be positive")
    is_standard = (args.world, args.dock) == (WORLD, DOCK)
    all_parts = PARTS if is_standard else ("sights", "random")
    parts = tuple(args.only) if args.only else all_parts
    if not set(parts) <= set(all_parts):
        raise BadInputError(
            f"approaches and faults are those of {DOCK} in {WORLD}; other docks have {', '.join(all_parts)}"
        )
    is_marked = study.is_marked(args.world, args.dock)
    if is_marked and not is_standard and "sights" in parts:
        raise BadInputError(f"looks at markers are those at {DOCK} in {WORLD}: choose --only random")
    settings = study_settings(args)
    if settings.faults and "sights" in parts:
        raise BadInputError(f"{args.profile}: looks at a dock take no faults: choose --only random")
    settings.check([args.world], [study.ROBOT], (DockStep(args.dock),))
    out = args.out if args.out is not None else Path(OUT if is_standard else f"{OUT}_{args.dock}")
    warm_up(imported_kernel_modules())
    started = time.perf_counter()
    cases = []
    if "approach" in parts:
        cases += study.approach_cases(args.seed)
    if "random" in parts:
        cases += study.random_cases(args.runs, args.seed, args.world, args.dock)
    if "faults" in parts:
        wanted = args.fault or study.FAULTS
        if unknown := set(wanted) - set(study.FAULTS):
            raise BadInputError(f"no fault {min(unknown)!r}; there are {', '.join(study.FAULTS)}")
        cases += [case for case in study.fault_cases(args.fault_runs, args.seed) if case.kind in wanted]
    outcomes = []
    for outcome in study.run_cases(cases, out, args.world, args.dock, settings):
        outcomes.append(outcome)
        print(_line(outcome), flush=True)
    fields: dict[str, Any] = docking.summarize(outcomes)
    pictures = args.pictures if args.pictures is not None else out
    if "sights" in parts:
        if is_marked:
            sights = study.measure_sights(args.seed, args.looks)
        else:
            scanners = robot_config(robot_named(study.ROBOT).model, settings.profile, has_map=True).scanners
            sights = measure_scan_sights(args.seed, args.looks, args.world, study.ROBOT, args.dock, scanners)
        for series in sights:
            fields |= series.summary()
        docking_pictures.draw_sights(pictures / "docking_sights.png", sights)
    if any(o.is_docked for o in outcomes):
        docking_pictures.draw_final_errors(pictures / "docking_errors.png", outcomes)
        docking_pictures.draw_times(pictures / "docking_times.png", outcomes)
    print(docking.table(fields))
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    return 0 if all(_is_good(o) for o in outcomes) else 1


def _is_good(outcome: Any) -> bool:
    from ambler.runtime.tasks import DOCK_FAILURES

    is_fault = outcome.kind not in ("random", "approach")
    is_ended = (outcome.is_docked and outcome.attempts <= 2) or (is_fault and outcome.code in DOCK_FAILURES)
    return is_ended and outcome.collisions == 0


def _line(outcome: Any) -> str:
    error = "" if outcome.error is None else f" {1e3 * outcome.error:.2f} mm {outcome.error_yaw_deg:+.3f}°"
    approach = "" if outcome.approach_seconds is None else f" approach {outcome.approach_seconds:.1f} s"
    final = "" if outcome.docking_seconds is None else f" docking {outcome.docking_seconds:.1f} s"
    who = f"{outcome.kind} {outcome.seed} ({outcome.distance:.1f} m)"
    return f"{who}: {outcome.code}, {outcome.attempts} attempts{approach}{final}{error}"
