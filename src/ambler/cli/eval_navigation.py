"""`ambler eval navigation`: drives to random reachable goals of known maps, judged by the truth."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


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
    parser.add_argument("--json", type=Path, help="write the result as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive and judge; 0 when every goal was reached without a collision."""
    import time

    from ambler.apps.navigation_study import NavigationStudy, run_study
    from ambler.apps.run_report import print_result
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.kernels.warmup import imported_kernel_modules, warm_up

    if args.goals < 1 or args.per_journey < 1:
        raise BadInputError("--goals and --per-journey must be at least 1")
    worlds = tuple(world for world in args.worlds.split(",") if world)
    sizes = (args.goals, args.per_journey, args.seed)
    study = NavigationStudy(worlds, args.robot, *sizes, "kinematic" if args.kinematic else "contact")
    warm_up(imported_kernel_modules())
    started = time.perf_counter()
    fields = run_study(study, args.out)
    print_result(fields, "navigation")
    if args.json:
        names = ",".join(Path(world).name for world in worlds)
        command = (
            f"ambler eval navigation --worlds {names} --robot {args.robot} --goals {args.goals} --seed {args.seed}"
        )
        write_results(args.json, command, args.seed, time.perf_counter() - started, fields)
    reached = sum(v for k, v in fields.items() if k.endswith(".reached"))
    collisions = sum(v for k, v in fields.items() if k.endswith(".collisions"))
    return 0 if reached == args.goals * len(worlds) and collisions == 0 else 1
