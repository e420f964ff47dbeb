"""`ambler eval navigation`: drives to random reachable goals of known maps, judged by the truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings, study_settings


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "navigation", help="drive to random reachable goals of known maps; the pose comes from localization"
    )
    parser.add_argument(
        "--worlds", default="office", help="comma-separated: names, maps' YAML or pictures (default: office)"
    )
    parser.add_argument("--robot", default="diff", help="diff, amr_omni or a URDF file (default: diff)")
    parser.add_argument("--goals", type=int, default=200, help="goals per world (default: 200)")
    parser.add_argument("--per-journey", type=int, default=25, help="goals from one start on (default: 25)")
    parser.add_argument("--seed", type=int, default=0, help="of goals, sensors and wheels (default: 0)")
    parser.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/navigation"), help="journeys; the same folder goes on with them"
    )
    add_settings(parser)
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive and judge; 0 when every goal was reached without a collision."""
    import time

    from ambler.apps.navigation_study import NavigationStudy, run_study
    from ambler.apps.run_report import print_result
    from ambler.core.errors import BadInputError
    from ambler.core.se2 import SE2
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up
    from ambler.nodes.steps import NavigateStep

    if args.goals < 1 or args.per_journey < 1:
        raise BadInputError("--goals and --per-journey must be at least 1")
    worlds = tuple(world for world in args.worlds.split(",") if world)
    sizes = (args.goals, args.per_journey, args.seed)
    settings = study_settings(args)
    settings.check(worlds, [args.robot], (NavigateStep(SE2()),))
    study = NavigationStudy(worlds, args.robot, *sizes, "kinematic" if args.kinematic else "contact", settings)
    warm_up(imported_kernel_modules())
    started = time.perf_counter()
    fields = run_study(study, args.out)
    print_result(fields, "navigation")
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - started, fields)
    reached = sum(v for k, v in fields.items() if k.endswith(".reached"))
    collisions = sum(v for k, v in fields.items() if k.endswith(".collisions"))
    return 0 if reached == args.goals * len(worlds) and collisions == 0 else 1
