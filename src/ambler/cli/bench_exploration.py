"""`ambler bench exploration`: path length to coverage of each strategy on floor plans, with an ideal scanner and robot.

The plans are pictures: 127 is solid, everything else is free, 203 marks the start (the public dungeon maps of `datasets.md`).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.exploration.grid_world import GridWorld
    from ambler.exploration.strategies import Strategy

COVERAGES = (0.9, 0.98, 0.99)
SOLID, START = 127, 203


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("exploration", help="path length of the exploration strategies on floor plans")
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("../shared/data/exploration"),
        help="folder with floor plans, *.png, also deeper",
    )
    parser.add_argument("--strategies", default="tour,nearest,greedy", help="names, separated by commas")
    parser.add_argument("--resolution", type=float, default=0.0625, help="metres per pixel")
    parser.add_argument("--every", type=int, default=1, help="take each n-th plan only")
    parser.add_argument("--seed", type=int, default=0, help="unused: nothing is random here")
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore every plan with every strategy; exit 1 when an exploration ends without proof or below 98 % coverage."""
    import numpy as np

    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.exploration.strategies import STRATEGIES, strategy_named
    from ambler.planning.distance import distance_field

    begin = time.perf_counter()
    names = args.strategies.split(",")
    if unknown := [n for n in names if n not in STRATEGIES]:
        raise BadInputError(f"no strategy {unknown[0]!r}, only {', '.join(STRATEGIES)}")
    plans = sorted(args.data.rglob("*.png"))[:: args.every]
    if not plans:
        raise BadInputError(f"no *.png in {args.data}")
    lengths: dict[str, list[tuple[float, ...]]] = {n: [] for n in names}
    is_good = True
    for plan in plans:
        words = []
        for name in names:
            world = load_world(plan, args.resolution)
            result = explore(world, strategy_named(name, distance_field))
            is_good &= result.code == "SUCCEEDED" and result.coverage >= 0.98
            reached = [np.nan if m is None else m for m in result.at_coverage]
            lengths[name].append((*reached, result.explored, result.total, result.coverage))
            words.append(f"{name} {reached[1]:.0f}/{result.explored:.0f}/{result.total:.0f} m {result.coverage:.1%}")
            if result.code != "SUCCEEDED":
                words.append(result.code)
        print(f"{plan.parent.name}/{plan.stem}: " + ", ".join(words), flush=True)
    fields: dict[str, Any] = {"plans": len(plans)}
    columns = (
        *(f"path_at_{round(100 * c)}pct_m" for c in COVERAGES),
        "path_explored_m",
        "path_total_m",
        "coverage_ratio",
    )
    for name in names:
        for column, mean in zip(columns, np.mean(lengths[name], axis=0), strict=True):
            fields[f"{name}_{column}_mean"] = round(float(mean), 4)
    for peer in names[1:]:
        for column in ("path_at_98pct_m", "path_explored_m"):
            ratio = fields[f"{names[0]}_{column}_mean"] / fields[f"{peer}_{column}_mean"]
            fields[f"{column}_ratio_vs_{peer}"] = round(ratio, 4)
    for key, value in fields.items():
        print(f"{key:45} {value}")
    if args.json is not None:
        write_results(args.json, "bench exploration", args.seed, time.perf_counter() - begin, fields)
    return 0 if is_good else 1


def load_world(plan: Path, resolution: float) -> GridWorld:
    """Read a floor plan; raises BadInputError when it is no picture or has no start."""
    import cv2
    import numpy as np

    from ambler.core.errors import BadInputError
    from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, GridSpec
    from ambler.core.se2 import SE2
    from ambler.exploration.grid_world import GridWorld
    from ambler.planning.distance import distance_field

    pixels = cv2.imread(str(plan), cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise BadInputError(f"{plan}: not a picture")
    pixels = np.ascontiguousarray(pixels[::-1])
    ys, xs = np.nonzero(pixels == START)
    if len(ys) == 0:
        raise BadInputError(f"{plan}: no pixel of {START}, which marks the start")
    truth = np.where(pixels == SOLID, OCC_OCCUPIED, OCC_FREE).astype(np.int8)
    spec = GridSpec(resolution, pixels.shape[1], pixels.shape[0], 0.0, 0.0)
    start = SE2(*spec.center_of(int(ys.mean()), int(xs.mean())))
    return GridWorld(spec, truth, start, distance_field)


@dataclass(frozen=True, slots=True)
class Exploration:
    """Driven metres at each coverage of COVERAGES (None: not reached), at the end of exploring and at home; how it ended."""

    at_coverage: tuple[float | None, ...]
    explored: float
    total: float
    coverage: float
    code: str
    updates: int


def explore(world: GridWorld, strategy: Strategy, *, speed: float = 0.8, max_updates: int = 5000) -> Exploration:
    """Run the exploration mission in a grid world, one update per simulated second."""
    from ambler.exploration.survey import FrontierSurvey, SurveyConfig
    from ambler.missions.explore import ExploreMission
    from ambler.missions.explore_commands import (
        DriveTo,
        Ended,
        ExploreConfig,
        ExploreState,
        ExploreView,
        StopDriving,
        TurnAround,
    )
    from ambler.planning.distance import distance_field
    from ambler.runtime.tasks import ExploreGoal

    survey = FrontierSurvey(SurveyConfig(), distance_field)
    mission = ExploreMission(ExploreConfig(), survey, strategy)
    mission.begin(ExploreGoal(), 0)
    reached: list[float | None] = [None] * len(COVERAGES)
    goal: DriveTo | None = None
    explored = 0.0
    for k in range(max_updates):
        now_ns = k * 1_000_000_000
        commands = mission.update(ExploreView(now_ns, world.map(now_ns), world.costs(now_ns), world.pose), now_ns)
        for command in commands:
            match command:
                case DriveTo():
                    goal = command
                case TurnAround():
                    mission.drive_ended(command.drive, "SUCCEEDED", "")
                case StopDriving():
                    goal = None
                case Ended():
                    return Exploration(tuple(reached), explored, world.driven, world.coverage(), command.code, k)
        if goal is not None:
            has_arrived = world.drive(goal.map_from_goal, speed)
            if has_arrived is None:
                mission.drive_ended(goal.drive, "NO_VALID_PATH", "no path")
                goal = None
            elif has_arrived:
                mission.drive_ended(goal.drive, "SUCCEEDED", "")
                goal = None
        coverage = world.coverage()
        for i, wanted in enumerate(COVERAGES):
            if reached[i] is None and coverage >= wanted:
                reached[i] = world.driven
        if mission.state is ExploreState.DRIVING:
            explored = world.driven
    return Exploration(tuple(reached), explored, world.driven, world.coverage(), "TOO_LONG", max_updates)
