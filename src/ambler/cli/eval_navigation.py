"""`ambler eval navigation`: drives to random reachable goals of known maps, judged by the truth."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary


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
    parser.add_argument("--kinematic", action="store_true", help="no contact physics (faster)")
    add_study_options(parser, 1, "seeds of goals, sensors and wheels")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Drive and judge; 0 when every goal was reached without a collision."""
    from ambler.apps.run_report import print_result
    from ambler.core.errors import BadInputError
    from ambler.core.se2 import SE2
    from ambler.nodes.steps import NavigateStep
    from ambler.studies.navigation_study import journeys_to, navigation_study, summarize_all

    if args.goals < 1 or args.per_journey < 1:
        raise BadInputError("--goals and --per-journey must be at least 1")
    worlds = [world for world in args.worlds.split(",") if world]
    settings, seeds = study_settings(args), seeds_of(args)
    settings.check(worlds, [args.robot], (NavigateStep(SE2()),))
    physics: Any = "kinematic" if args.kinematic else "contact"
    journeys = [
        journey
        for world in worlds
        for seed in seeds
        for journey in journeys_to(world, args.robot, args.goals, args.per_journey, seed, physics, settings)
    ]
    results = conduct_study(args, navigation_study(journeys))
    fields = {
        "robot": args.robot,
        "physics": physics,
        "goals_per_journey": args.per_journey,
        **summarize_all(journeys, results),
    }
    print_result(fields, "navigation")
    write_summary(args, fields, seeds)
    wanted = sum(len(journey.goals) for journey in journeys)
    is_good = sum(r.get("reached", 0) for r in results) == wanted and not any(r.get("collisions") for r in results)
    return 0 if is_good else 1
