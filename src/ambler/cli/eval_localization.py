"""`ambler eval localization`: errors, consistency and told variances of every localizer in an aisle, along a wall, in a building."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary

OWN = ("localizer", "localization.source", "localization.initial_pose", "localization.covariance")


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "localization", help="true errors and told variances of the localizers in three places"
    )
    parser.add_argument("--places", default="aisle,wall,building", help="comma-separated (default: all three)")
    parser.add_argument("--robot", default="amr_omni", help="a robot with planar scanners (default: amr_omni)")
    parser.add_argument("--resolution", type=float, default=0.05, help="of the known map, metres (default: 0.05)")
    add_study_options(parser, 1, "moving drives per place")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; 0 when every method in every place meets the bars while moving: 10 mm in the observable directions, NEES 0.5 to 2."""
    from ambler.apps.config import robot_config
    from ambler.core.errors import BadInputError
    from ambler.evaluation.localization_quality import draw_boxes
    from ambler.sim.robots import robot_named
    from ambler.studies import localization_study as study

    names = args.places.split(",")
    places = [place for place in study.PLACES if place.name in names]
    if len(places) != len(names):
        raise BadInputError(f"--places {args.places}: there are {', '.join(p.name for p in study.PLACES)}")
    settings, seeds = study_settings(args, *OWN, takes_faults=False), seeds_of(args)
    robot_config(robot_named(args.robot).model, settings.profile, has_map=True)
    cases = study.cases_of(places, args.robot, seeds, args.resolution, settings)
    results = study.joined_errors(conduct_study(args, study.localization_study(cases)))
    for place in places:
        for is_moving, how in ((True, "moving"), (False, "static")):
            boxes = {m.name: results[place.name, m.name, is_moving] for m in study.METHODS}
            print(draw_boxes(args.out / "localization" / f"{place.name}_{how}.png", f"{place.name}, {how}", boxes))
    fields = study.study_fields(places, results)
    write_summary(args, {"map_resolution_m": args.resolution, "runs": args.runs, **fields}, seeds)
    met = [fields[f"{place.name}.{method.name}.is_met"] for place in places for method in study.METHODS]
    print(
        f"{sum(met)} of {len(met)} meet {1e3 * study.ERROR_MOST:g} mm in every observable direction and NEES 0.5 to 2"
    )
    return 0 if all(met) else 1
