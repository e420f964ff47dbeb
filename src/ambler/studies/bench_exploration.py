"""Path lengths and times of each strategy, with an ideal scanner and robot and the real mission, beside the tour of somebody who knows
the plan.

Places are the simulator's worlds, seen with the scanner of `diff`, and floor plans, seen as far as their authors saw (80 pixels).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambler.core.errors import BadInputError
from ambler.exploration.grid_world import GridWorld
from ambler.exploration.known_tour import KnownTour, known_tour
from ambler.exploration.strategies import STRATEGIES, Strategy, strategy_named
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.missions.drive_to import DriveTo
from ambler.missions.explore import ExploreMission
from ambler.missions.explore_commands import (
    Ended,
    ExploreConfig,
    ExploreState,
    ExploreView,
    StopDriving,
    TurnAround,
)
from ambler.planning.distance import distance_field
from ambler.runtime.tasks import ExploreGoal
from ambler.studies.exploration_places import Place

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


LEAST_TOUR = 10.0  # metres; shorter tours see their place from the start or nearly so, and a ratio to them says nothing


@dataclass(frozen=True, slots=True)
class Findings:
    """The explorations of each strategy and the tours with full knowledge, both in the order of the places."""

    explorations: dict[str, list[Exploration]]
    tours: list[KnownTour]

    @property
    def is_good(self) -> bool:
        """Whether every exploration ended with proof, and saw enough."""
        return all(e.is_good for explorations in self.explorations.values() for e in explorations)


def measure(places: Sequence[Place], strategies: Sequence[str], tell: Callable[[str], None]) -> Findings:
    """Explore every place with every strategy, and plan its tour with full knowledge; tells a line of each place."""
    found = Findings({name: [] for name in strategies}, [])
    for label, make in places:
        for name in strategies:
            found.explorations[name].append(explore(make(), strategy_named(name, distance_field)))
        found.tours.append(known_tour(make()))
        words = ", ".join(found.explorations[name][-1].words(name) for name in strategies)
        tell(f"{label}: {words}; with full knowledge {found.tours[-1].length:.0f} m")
    return found


def check_strategies(names: Sequence[str]) -> None:
    """Raise BadInputError for a strategy that there is not."""
    if unknown := [n for n in names if n not in STRATEGIES]:
        raise BadInputError(f"no strategy {unknown[0]!r}, only {', '.join(STRATEGIES)}")


def compare(results: Mapping[str, Sequence[Exploration]]) -> dict[str, Any]:
    """Return the means of each strategy, and the first one's lengths over those of each other one."""
    fields: dict[str, Any] = {}
    for name, explorations in results.items():
        for column, mean in zip(COLUMNS, np.mean([e.row() for e in explorations], axis=0), strict=True):
            fields[f"{name}_{column}_mean"] = round(float(mean), 4)
    first, *peers = results
    for peer in peers:
        for column in ("path_at_98pct_m", "path_explored_m", "path_total_m", "path_weighted_m"):
            ratio = fields[f"{first}_{column}_mean"] / fields[f"{peer}_{column}_mean"]
            fields[f"{column}_ratio_vs_{peer}"] = round(ratio, 4)
    return fields


def compare_with_tours(found: Findings) -> dict[str, Any]:
    """Return, over the places whose tour with full knowledge is LEAST_TOUR long, the medians of the tours and of the strategies' whole ways
    in metres, and of the ratios of the ways to the tours, with their highest."""
    tours = np.array([tour.length for tour in found.tours])
    counts = tours >= LEAST_TOUR
    fields: dict[str, Any] = {"places_with_tour": int(counts.sum())}
    if not counts.any():
        return fields
    fields |= {
        "known_tour_m_median": round(float(np.median(tours[counts])), 4),
        "known_tour_coverage_ratio_least": round(min(t.coverage for t in found.tours), 4),
    }
    for name, explorations in found.explorations.items():
        ways = np.array([e.total for e in explorations])[counts]
        ratios = ways / tours[counts]
        fields |= {
            f"{name}_way_m_median": round(float(np.median(ways)), 4),
            f"{name}_ratio_vs_known_tour_median": round(float(np.median(ratios)), 4),
            f"{name}_ratio_vs_known_tour_max": round(float(ratios.max()), 4),
        }
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
    def is_good(self) -> bool:
        """Whether it ended with proof, and at least 98 % were seen."""
        return self.code == "SUCCEEDED" and self.coverage >= 0.98

    @property
    def at_98(self) -> float:
        return self.at_coverage[1]

    def words(self, name: str) -> str:
        """Return what it came to, for a line about the strategy of that name."""
        text = f"{name} {self.at_98:.0f}/{self.explored:.0f}/{self.total:.0f} m {self.coverage:.1%}"
        return text if self.code == "SUCCEEDED" else f"{text}, {self.code}"

    def row(self) -> tuple[float, ...]:
        """Return the values of COLUMNS; the weighted length is the mean of that at 98 % and that to the proof and home."""
        weighted = 0.5 * (self.at_98 + self.total)
        times = (self.seconds_at_98, self.seconds)
        return (*self.at_coverage, self.explored, self.total, weighted, *times, self.coverage)


def explore(world: GridWorld, strategy: Strategy, *, speed: float = 0.5, max_updates: int = 5000) -> Exploration:
    """Run the exploration mission in a grid world, one update per simulated second."""
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
