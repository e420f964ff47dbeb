"""The memory of dead ends: places at which a robot on its way to a goal had to stand, and how dear it is to come there again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


@dataclass(slots=True)
class DeadEnd:
    """A place in the odom frame, when it was met last, and how often."""

    x: float
    y: float
    stamp: float
    count: int = 1


class DeadEnds:
    """Remembers places for `memory` seconds; being within `radius` metres of one costs up to `weight` metres for each time it was met."""

    def __init__(self, radius: float, weight: float, memory: float) -> None:
        self._radius, self._weight, self._memory = radius, weight, memory
        self.places: list[DeadEnd] = []

    def add(self, here: SE2, now: float) -> DeadEnd:
        """Remember that the robot had to stand here, at a time in seconds."""
        self.forget(now)
        for place in self.places:
            if np.hypot(place.x - here.x, place.y - here.y) < self._radius:
                place.stamp, place.count = now, place.count + 1
                return place
        self.places.append(DeadEnd(here.x, here.y, now))
        return self.places[-1]

    def forget(self, now: float) -> None:
        """Forget what is too long ago."""
        self.places = [place for place in self.places if now - place.stamp <= self._memory]

    def clear(self) -> None:
        """Forget all: there is another goal."""
        self.places = []

    def cost(self, points: F64) -> F64:
        """Return what it costs (m) to be at points (N, 2) of the odom frame; it falls from the weight at a place to nothing at twice the radius."""
        total = np.zeros(len(points))
        for place in self.places:
            away = np.hypot(points[:, 0] - place.x, points[:, 1] - place.y)
            total += self._weight * place.count * np.clip(2.0 - away / self._radius, 0.0, 1.0)
        return total
