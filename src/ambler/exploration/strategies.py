"""Which frontier next. A strategy gives each open frontier a cost in metres; the lowest is the best target.

`nearest`: path distance (Yamauchi 1997). `greedy`: straight distance minus size (the cost of explore_lite). `tour`, the
default: the length of the shortest way through all open frontiers that begins with this one, less a bonus for what it shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.exploration.survey import DistanceField, Survey
from ambler.kernels.frontier_value import shrink_costs, tour_costs

F64 = NDArray[np.float64]


class Strategy(Protocol):
    """Judges the open frontiers of a survey."""

    def costs(self, survey: Survey, map_from_base: SE2) -> F64:
        """Return the cost of each frontier of `survey.open`, float64 (N,), metres, lower is better."""
        ...


class NearestStrategy:
    """The nearest frontier by path."""

    def costs(self, survey: Survey, map_from_base: SE2) -> F64:
        """Return path distances."""
        return np.array([survey.frontiers[i].path_distance for i in survey.open])


@dataclass(frozen=True, slots=True)
class GreedyStrategy:
    """Straight distance to the nearest cell of the frontier minus its size, both in metres."""

    distance_scale: float = 1.0
    size_scale: float = 1.0

    def costs(self, survey: Survey, map_from_base: SE2) -> F64:
        """Return distance_scale * distance - size_scale * size."""
        out = np.empty(len(survey.open))
        for k, i in enumerate(survey.open):
            cells = survey.frontiers[i].cells
            distance = np.hypot(cells[:, 0] - map_from_base.x, cells[:, 1] - map_from_base.y).min()
            size = len(cells) * survey.costs.spec.resolution
            out[k] = self.distance_scale * float(distance) - self.size_scale * size
        return out


@dataclass(frozen=True, slots=True)
class TourConfig:
    """At most `places` frontiers enter the tour, the others count as farther than all of them. Distances between frontiers are
    computed on a grid of cells of about `coarse_cell` (m). A frontier is worth a detour of `gain_weight` (m) for each factor of e
    by which its gain is greater, up to `gain_cap` (m²), so that leftovers wait until they lie on the way."""

    places: int = 10
    coarse_cell: float = 0.2
    gain_weight: float = 5.0
    gain_cap: float = 5.0


class TourStrategy:
    """The first step of the shortest open tour through the nearest open frontiers."""

    def __init__(self, distance_field: DistanceField, config: TourConfig | None = None) -> None:
        self.config = config or TourConfig()
        self._distance_field = distance_field

    def costs(self, survey: Survey, map_from_base: SE2) -> F64:
        """Return tour lengths less bonuses; frontiers beyond the nearest ones get the longest tour plus their path distance."""
        distances = np.array([survey.frontiers[i].path_distance for i in survey.open])
        nearest = np.argsort(distances, kind="stable")[: self.config.places]
        n = len(nearest)
        lengths = np.empty(n)
        between = self._between(survey, [survey.open[k] for k in nearest])
        tour_costs(distances[nearest], between, np.empty((1 << n, n)), lengths)
        out = distances + (lengths.max() if n else 0.0)
        out[nearest] = lengths
        gains = np.clip(survey.gains[list(survey.open)], 1e-3, self.config.gain_cap)
        return np.asarray(out - self.config.gain_weight * np.log(gains))

    def _between(self, survey: Survey, places: list[int]) -> F64:
        """Return path lengths between the goals of the places, float64 (N, N), metres; straight where no path is known."""
        goals = []
        for i in places:
            goal = survey.frontiers[i].goal
            assert goal is not None, "an open frontier has a goal"
            goals.append(goal)
        spec, costs = self._coarse(survey)
        out = np.zeros((len(goals), len(goals)))
        for a, goal in enumerate(goals[:-1]):
            distance = self._distance_field(costs, spec, SE2(*goal))
            for b in range(a + 1, len(goals)):
                iy, ix = spec.cell_of(goals[b][0], goals[b][1])
                straight = math.hypot(goals[b][0] - goal[0], goals[b][1] - goal[1])
                along = float(distance[iy, ix])
                out[a, b] = out[b, a] = max(straight, along) if math.isfinite(along) else straight
        return out

    def _coarse(self, survey: Survey) -> tuple[GridSpec, NDArray[np.uint8]]:
        fine = survey.costs.spec
        factor = max(1, math.floor(self.config.coarse_cell / fine.resolution + 1e-6))
        if factor == 1:
            return fine, survey.costs.data
        spec = GridSpec(
            fine.resolution * factor,
            math.ceil(fine.width / factor),
            math.ceil(fine.height / factor),
            fine.origin_x,
            fine.origin_y,
        )
        costs = np.empty(spec.shape, np.uint8)
        shrink_costs(survey.costs.data, factor, costs)
        return spec, costs


STRATEGIES = ("tour", "nearest", "greedy")


def strategy_named(name: str, distance_field: DistanceField) -> Strategy:
    """Return the strategy of a name of STRATEGIES; raises KeyError."""
    makers: dict[str, Callable[[], Strategy]] = {
        "tour": lambda: TourStrategy(distance_field),
        "nearest": NearestStrategy,
        "greedy": GreedyStrategy,
    }
    return makers[name]()
