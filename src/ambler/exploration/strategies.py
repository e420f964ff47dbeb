"""Which frontier next. A strategy gives each open frontier a cost in metres; the lowest is the best target.

`nearest`: path distance (Yamauchi 1997). `greedy`: straight distance minus size, weighed as explore_lite is shipped. `tour`, the
default: the best tour through all open frontiers that begins with this one (`exploration/tour.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.exploration.survey import DistanceField, Survey
from ambler.exploration.tour import TourStrategy

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
    """Straight distance to the nearest cell of the frontier minus its size, both in metres. The scales are those that explore_lite is
    shipped with: potential 3, gain 1, orientation 0."""

    distance_scale: float = 3.0
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


STRATEGIES = ("tour", "nearest", "greedy")


def strategy_named(name: str, distance_field: DistanceField) -> Strategy:
    """Return the strategy of a name of STRATEGIES; raises KeyError."""
    makers: dict[str, Callable[[], Strategy]] = {
        "tour": lambda: TourStrategy(distance_field),
        "nearest": NearestStrategy,
        "greedy": GreedyStrategy,
    }
    return makers[name]()
