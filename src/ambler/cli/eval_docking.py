"""`ambler eval docking`: how precisely docks are seen, how exactly, how often and how fast the robot docks, beside the source."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, first_seed, write_summary

PARTS = ("sights", "approach", "random", "faults")
WORLD, DOCK = "dock_hall", "charger_1"


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser("docking", help="precision, success and times of docking")
    parser.add_argument("--fault-runs", type=int, default=2, help="runs per fault (default: 2; 20 before a release)")
    parser.add_argument("--fault", action="append", default=[], metavar="NAME", help="only this fault; may be repeated")
    parser.add_argument("--looks", type=int, default=100, help="pictures per series of looks (default: 100)")
    parser.add_argument("--world", default=WORLD, help=f"a world with docks (default: {WORLD})")
    parser.add_argument(
        "--dock", default=DOCK, help=f"the dock; only {DOCK} has approaches and faults (default: {DOCK})"
    )
    parser.add_argument(
        "--imperfections",
        choices=("drawn", "exact"),
        default="drawn",
        help="mounting, lens, markers, contacts, floor and wheels off by what real ones are off by, drawn per run, every random start "
        "untaught and taught; or exactly as told (default: drawn)",
    )
    parser.add_argument("--only", choices=PARTS, action="append", default=[], help="only this part; may be repeated")
    parser.add_argument("--pictures", type=Path, help="where box plots go (default: a folder below --out)")
    add_study_options(parser, 20, "random starts; 60 before a release")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure. 0: all docked within two attempts, or failed by a fault with a name."""
    from ambler.core.errors import BadInputError
    from ambler.evaluation import docking, docking_pictures
    from ambler.nodes.steps import DockStep
    from ambler.studies import docking_study as study

    if min(args.fault_runs, args.looks) < 1:
        raise BadInputError("--fault-runs and --looks must be positive")
    parts = study.parts_of(args.world, args.dock, args.only)
    settings, seed = study_settings(args), first_seed(args)
    if settings.faults and "sights" in parts:
        raise BadInputError(f"{args.profile}: looks at a dock take no faults: choose --only random")
    settings.check([args.world], [study.ROBOT], (DockStep(args.dock),))
    sizes = (args.runs, args.fault_runs, args.fault)
    cases = study.cases_of(parts, *sizes, seed, args.world, args.dock)
    if args.imperfections == study.DRAWN:
        cases = study.imperfect(cases)
    outcomes = [study.outcome_of(r) for r in conduct_study(args, study.docking_study(cases, settings))]
    sights = study.detections_of(seed, args.looks, args.world, args.dock, settings) if "sights" in parts else []
    fields: dict[str, Any] = {"imperfections": args.imperfections, **docking.summarize(outcomes)}
    for series in sights:
        fields |= series.summary()
    pictures = args.pictures or args.out / "docking" / f"{args.world}-{args.dock}"
    docking_pictures.draw_all(pictures, outcomes, sights)
    print(docking.table(fields))
    write_summary(args, fields, [seed])
    return 0 if all(map(study.is_good, outcomes)) else 1
