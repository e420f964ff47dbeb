"""`ambler eval localization`: errors, consistency and told variances of every localizer in an aisle, along a wall, in a building."""

from __future__ import annotations

import argparse
from typing import Any

from ambler.cli.results_output import print_fields
from ambler.cli.run_options import study_settings
from ambler.cli.study_options import add_study_options, conduct_study, seeds_of, write_summary

OWN = ("localizer", "localization.source", "localization.initial_pose", "localization.covariance")


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "localization", help="true errors and told variances of the localizers, in drawn maps or in made ones"
    )
    parser.add_argument("--places", default="aisle,wall,building", help="comma-separated (default: all three)")
    parser.add_argument(
        "--maps",
        choices=("drawn", "made"),
        default="drawn",
        help="drawn from the plans of three places, or made by SLAM in --runs drawn places on another day (default: drawn)",
    )
    parser.add_argument(
        "--robot", help="a robot with planar scanners (default: amr_omni; in made maps diff, which turns anywhere)"
    )
    parser.add_argument("--resolution", type=float, default=0.05, help="of drawn maps, metres (default: 0.05)")
    made = parser.add_argument_group("made maps")
    made.add_argument("--kinds", nargs="+", help="kinds of places, in turn (default: those that are closed)")
    made.add_argument("--drives", type=int, default=4, help="per place (default: 4)")
    made.add_argument("--starts", type=int, default=40, help="of lost robots, per place (default: 40)")
    add_study_options(parser, 1, "moving drives per place; in made maps, places")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; 0 when every method in every place meets the bars while moving: 10 mm in the observable directions, NEES 0.5 to 2."""
    from ambler.apps.config import robot_config
    from ambler.core.errors import BadInputError
    from ambler.evaluation.localization_quality import draw_boxes
    from ambler.sim.robots import robot_named
    from ambler.studies import localization_study as study

    if args.maps == "made":
        return _made_maps(args)
    args.robot = args.robot or "amr_omni"
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


def _made_maps(args: argparse.Namespace) -> int:
    """Measure in maps that SLAM made; 0 when every bar is met."""
    from ambler.core.errors import BadInputError
    from ambler.studies import exploration_campaign as campaign
    from ambler.studies.lost_robot_study import lost_config
    from ambler.studies.made_maps_study import conduct_made_maps

    if args.drives < 1 or args.starts < 0:
        raise BadInputError(
            f"--drives {args.drives} --starts {args.starts}: at least one drive, and no negative number"
        )
    settings, seeds = study_settings(args, *OWN, takes_faults=False), seeds_of(args)
    robot, kinds = args.robot or "diff", list(args.kinds or campaign.CLOSED_KINDS)
    campaign.check_kinds(kinds)
    lost_config(robot, settings)
    worlds = campaign.fresh_places(kinds, seeds)
    fields = conduct_made_maps(
        worlds, seeds, robot, args.drives, args.starts, settings, lambda study: conduct_study(args, study)
    )
    print_fields(fields, 48, ".4g")
    write_summary(args, {"robot": robot, "worlds": ",".join(worlds), "runs": args.runs, **fields}, seeds)
    return 0 if all(value for name, value in fields.items() if name.startswith("bars.")) else 1
