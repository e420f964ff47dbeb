"""The default strategy: the first step of the best tour through all open frontiers, small ones too, so that nothing is left behind
that would have to be fetched later.

Every frontier enters with its real path lengths. A leftover is thus taken when its detour now is cheaper than its detour later. Unknown
area is urgent: the tour's cost is its length plus `urgency` times the mean distance after which the area is seen (TARE plans a
tour in the same way; the weights turn it towards the travelling repairman's problem).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.exploration.survey import DistanceField, Survey
from ambler.exploration.wide import cropped, shrunk
from ambler.kernels.tour import near_tour_costs, tour_costs

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TourConfig:
    """The nearest `places` frontiers enter the tour, which is exact up to `exact_places` of them, found by `sweeps` of local search
    above; the others count as farther than all of them. Distances between frontiers are computed on cells of about
    `coarse_cell` (m), on ways that stay within `around` (m) of the box about all of them; where they lie so far
    apart that this would take more than `work` cells, fewer enter, but no fewer than `exact_places`. A gain counts up to `gain_cap` (m²). A frontier is mostly seen before the robot stands at its goal: each leg
    counts `seen_from` (m) less, but at least three tenths of its length."""

    places: int = 24
    exact_places: int = 11
    sweeps: int = 2
    coarse_cell: float = 0.2
    around: float = 15.0
    work: float = 1.5e6
    urgency: float = 0.3
    gain_cap: float = 5.0
    seen_from: float = 1.5


class TourStrategy:
    """The first step of the best open tour through the open frontiers."""

    def __init__(self, distance_field: DistanceField, config: TourConfig | None = None) -> None:
        self.config = config or TourConfig()
        self._distance_field = distance_field

    def costs(self, survey: Survey, map_from_base: SE2) -> F64:
        """Return the cost of the best tour that begins with each frontier."""
        c = self.config
        distances = np.array([survey.frontiers[i].path_distance for i in survey.open])
        nearest = self._affordable(survey, np.argsort(distances, kind="stable")[: c.places])
        indices = [survey.open[k] for k in nearest]
        gains = np.clip(survey.gains[indices], 1e-3, c.gain_cap)
        legs, first_legs = self._leg(self._between(survey, indices)), self._leg(distances[nearest])
        tours = self._tours(first_legs, legs, gains / gains.sum())
        out = distances * (1.0 + c.urgency) + (tours.max() if len(tours) else 0.0)
        out[nearest] = tours
        return out

    def _affordable(self, survey: Survey, nearest: NDArray[np.intp]) -> NDArray[np.intp]:
        """Leave out the farthest places while the fields between all would cover more cells than `work`."""
        goals = np.array([survey.frontiers[survey.open[k]].goal for k in nearest])[:, :2]
        n = len(nearest)
        while n > self.config.exact_places:
            size = np.ptp(goals[:n], axis=0) + 2.0 * self.config.around
            if n * size[0] * size[1] <= self.config.work * self.config.coarse_cell**2:
                break
            n -= 1
        return nearest[:n]

    def _tours(self, first_legs: F64, legs: F64, weights: F64) -> F64:
        n, c = len(first_legs), self.config
        out = np.empty(n)
        if n <= c.exact_places:
            tour_costs(first_legs, legs, weights, c.urgency, np.empty(1 << n), np.empty((1 << n, n)), out)
        else:
            near_tour_costs(first_legs, legs, weights, c.urgency, c.sweeps, np.empty((3, n), np.int64), out)
        return out

    def _leg(self, lengths: F64) -> F64:
        return np.maximum(lengths - self.config.seen_from, 0.3 * lengths)

    def _between(self, survey: Survey, places: list[int]) -> F64:
        """Return path lengths between the goals of the places, float64 (N, N), metres; straight where no path is known."""
        goals = []
        for i in places:
            goal = survey.frontiers[i].goal
            assert goal is not None, "an open frontier has a goal"
            goals.append(goal)
        points = np.array([goal[:2] for goal in goals])
        costs, spec = cropped(survey.costs.data, survey.costs.spec, points, self.config.around)
        costs, spec = shrunk(costs, spec, self.config.coarse_cell)
        out = np.zeros((len(goals), len(goals)))
        for a, goal in enumerate(goals[:-1]):
            distance = self._distance_field(costs, spec, SE2(*goal))
            for b in range(a + 1, len(goals)):
                iy, ix = spec.cell_of(goals[b][0], goals[b][1])
                straight = math.hypot(goals[b][0] - goal[0], goals[b][1] - goal[1])
                along = float(distance[iy, ix])
                out[a, b] = out[b, a] = max(straight, along) if math.isfinite(along) else straight
        return out
