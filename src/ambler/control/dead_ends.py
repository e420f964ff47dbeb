"""The memory of dead ends: places at which a robot on its way to a goal had to stand, and how dear it is to come there again."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


@dataclass(slots=True)
class DeadEnd:
    """A place in the odom frame, the point ahead of it that was blocked, when it was met last, and how often."""

    x: float
    y: float
    blocked_x: float
    blocked_y: float
    stamp: float
    count: int = 1


class DeadEnds:
    """Remembers places for `memory` seconds; being within `radius` metres of one costs up to `weight` metres for each time it was met."""

    def __init__(self, radius: float, weight: float, memory: float) -> None:
        self._radius, self._weight, self._memory = radius, weight, memory
        self.places: list[DeadEnd] = []

    def add(self, here: SE2, blocked: tuple[float, float], now: float) -> DeadEnd:
        """Remember that the robot had to stand here before what blocks a point, at a time in seconds."""
        self.forget(now)
        for place in self.places:
            if math.hypot(place.x - here.x, place.y - here.y) < self._radius:
                place.blocked_x, place.blocked_y, place.stamp, place.count = *blocked, now, place.count + 1
                return place
        self.places.append(DeadEnd(here.x, here.y, *blocked, now))
        return self.places[-1]

    def visit(self, here: SE2, now: float) -> None:
        """Remember that the robot came here on its way out of the newest dead end, and that the way is still blocked."""
        if self.places:
            newest = max(self.places, key=lambda place: place.stamp)
            self.add(here, (newest.blocked_x, newest.blocked_y), now)

    def forget(self, now: float) -> None:
        """Forget what is too long ago."""
        self.places = [place for place in self.places if now - place.stamp <= self._memory]

    def clear(self) -> None:
        """Forget all: there is another goal."""
        self.places = []

    def covers(self, points: F64) -> NDArray[np.bool_]:
        """Say which of points (N, 2) of the odom frame lie within the radius of such a place, or of what blocked it."""
        near = np.zeros(len(points), np.bool_)
        for place in self.places:
            for x, y in ((place.x, place.y), (place.blocked_x, place.blocked_y)):
                near |= np.hypot(points[:, 0] - x, points[:, 1] - y) < self._radius
        return near

    def cost(self, points: F64) -> F64:
        """Return what it costs (m) to be at points (N, 2) of the odom frame; it falls from the weight at a place to nothing at twice the radius."""
        total = np.zeros(len(points))
        for place in self.places:
            away = np.hypot(points[:, 0] - place.x, points[:, 1] - place.y)
            total += self._weight * place.count * np.clip(2.0 - away / self._radius, 0.0, 1.0)
        return total
