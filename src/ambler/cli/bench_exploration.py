"""`ambler bench exploration`: path lengths and times of each strategy, with an ideal scanner and robot and the real mission.

Places are the simulator's worlds, seen with the scanner of `diff`, and floor plans, seen as far as their authors saw (80 pixels).
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ambler.exploration.grid_world import GridWorld
    from ambler.exploration.strategies import Strategy

COVERAGES = (0.9, 0.98, 0.99)
COLUMNS = (
    *(f"path_at_{round(100 * c)}pct_m" for c in COVERAGES),
    "path_explored_m",
    "path_total_m",
    "path_weighted_m",
    "time_at_98pct_s",
    "time_total_s",
    "coverage_ratio",
)


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("exploration", help="path length of the exploration strategies on floor plans")
    parser.add_argument(
        "--data", type=Path, help="folder with floor plans, *.png, also deeper (default: $AMBLER_DATA/exploration)"
    )
    parser.add_argument("--strategies", default="tour,nearest,greedy", help="names, separated by commas")
    parser.add_argument("--resolution", type=float, default=0.0625, help="metres per pixel")
    parser.add_argument("--every", type=int, default=1, help="take each n-th plan only")
    parser.add_argument(
        "--worlds",
        default="office,lab_empty,lab_obstacle,warehouse,maze,corridor,building",
        help="built-in worlds, separated by commas",
    )
    parser.add_argument("--plan-range", type=float, default=5.0, help="how far the scanner sees in plans, metres")
    parser.add_argument("--world-range", type=float, default=20.0, help="how far the scanner sees in worlds, metres")
    parser.add_argument("--seed", type=int, default=0, help="unused: nothing is random here")
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Explore every plan with every strategy; exit 1 when an exploration ends without proof or below 98 % coverage."""
    from ambler.cli.exploration_places import built_in_world, plan_world
    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.exploration.strategies import STRATEGIES, strategy_named
    from ambler.planning.distance import distance_field
    from ambler.recordings.public_data import public_data

    begin = time.perf_counter()
    names = args.strategies.split(",")
    if unknown := [n for n in names if n not in STRATEGIES]:
        raise BadInputError(f"no strategy {unknown[0]!r}, only {', '.join(STRATEGIES)}")
    data = public_data("exploration") if args.data is None else args.data
    plans = sorted(data.rglob("*.png"))[:: args.every]
    if not plans:
        raise BadInputError(f"no *.png in {data}")
    places: list[tuple[str, Callable[[], GridWorld]]] = [
        (name, partial(built_in_world, name, args.world_range)) for name in args.worlds.split(",") if name
    ]
    places += [(f"{p.parent.name}/{p.stem}", partial(plan_world, p, args.resolution, args.plan_range)) for p in plans]
    rows: dict[str, list[tuple[float, ...]]] = {n: [] for n in names}
    is_good = True
    for label, make in places:
        words = []
        for name in names:
            result = explore(make(), strategy_named(name, distance_field))
            is_good &= result.code == "SUCCEEDED" and result.coverage >= 0.98
            rows[name].append(result.row())
            words.append(f"{name} {result.at_98:.0f}/{result.explored:.0f}/{result.total:.0f} m {result.coverage:.1%}")
            if result.code != "SUCCEEDED":
                words.append(result.code)
        print(f"{label}: " + ", ".join(words), flush=True)
    fields = {"plans": len(plans), "places": len(places), **compare(rows)}
    for key, value in fields.items():
        print(f"{key:45} {value}")
    if args.json is not None:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0 if is_good else 1


def compare(rows: dict[str, list[tuple[float, ...]]]) -> dict[str, Any]:
    """Return the means of each strategy, and the first one's lengths over those of each other one."""
    import numpy as np

    fields: dict[str, Any] = {}
    for name, values in rows.items():
        for column, mean in zip(COLUMNS, np.mean(values, axis=0), strict=True):
            fields[f"{name}_{column}_mean"] = round(float(mean), 4)
    first, *peers = rows
    for peer in peers:
        for column in ("path_at_98pct_m", "path_explored_m", "path_total_m", "path_weighted_m"):
            ratio = fields[f"{first}_{column}_mean"] / fields[f"{peer}_{column}_mean"]
            fields[f"{column}_ratio_vs_{peer}"] = round(ratio, 4)
    return fields


@dataclass(frozen=True, slots=True)
class Exploration:
    """Driven metres at each coverage of COVERAGES (NaN: not reached), at the end of exploring and at home, seconds at 98 % and at
    the end, and how it ended."""

    at_coverage: tuple[float, ...]
    explored: float
    total: float
    coverage: float
    code: str
    seconds_at_98: float
    seconds: float

    @property
    def at_98(self) -> float:
        return self.at_coverage[1]

    def row(self) -> tuple[float, ...]:
        """Return the values of COLUMNS; the weighted length is the mean of that at 98 % and that to the proof and home."""
        weighted = 0.5 * (self.at_98 + self.total)
        times = (self.seconds_at_98, self.seconds)
        return (*self.at_coverage, self.explored, self.total, weighted, *times, self.coverage)


def explore(world: GridWorld, strategy: Strategy, *, speed: float = 0.5, max_updates: int = 5000) -> Exploration:
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
    reached = [math.nan] * len(COVERAGES)
    seconds_at_98 = math.nan
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
                    return Exploration(
                        tuple(reached), explored, world.driven, world.coverage(), command.code, seconds_at_98, k
                    )
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
            if math.isnan(reached[i]) and coverage >= wanted:
                reached[i] = world.driven
        if math.isnan(seconds_at_98) and not math.isnan(reached[1]):
            seconds_at_98 = k + 1.0
        if mission.state is ExploreState.DRIVING:
            explored = world.driven
    return Exploration(tuple(reached), explored, world.driven, world.coverage(), "TOO_LONG", seconds_at_98, max_updates)
