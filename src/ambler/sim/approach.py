"""Who walked into whom: how fast the touched point of a robot moved towards a person shortly before a contact.

The point stays where it is on the robot; its velocity is taken over 20 ms, towards where the person was at that moment. A robot that a
person has just touched may be pushed into something else: then what counts is how fast it drove itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2

WINDOW = 0.5  # seconds before a contact that count
SPAN = 0.02  # seconds over which a velocity is taken


class ApproachMemory:
    """Remembers where robots and people were within the last half second, one entry per tick of `tick` seconds."""

    def __init__(self, tick: float) -> None:
        self._steps = round(SPAN / tick)
        self._span = self._steps * tick
        self._past: deque[tuple[tuple[SE2, ...], tuple[tuple[float, float], ...]]] = deque(
            maxlen=round(WINDOW / tick) + self._steps
        )
        self._driven: deque[tuple[BodyVelocity, ...]] = deque(maxlen=round(WINDOW / tick))
        self._ticks = 0
        self._window = round(WINDOW / tick)
        self._touched: dict[int, int] = {}

    def note(
        self,
        world_from_bases: Sequence[SE2],
        people: Sequence[tuple[float, float]],
        driven: Sequence[BodyVelocity] = (),
        touched: Sequence[int] = (),
    ) -> None:
        """Take where everybody is at the end of a tick, what the robots drove in it themselves, and which of them people touch."""
        self._past.append((tuple(world_from_bases), tuple(people)))
        self._driven.append(tuple(driven))
        self._ticks += 1
        self._touched |= dict.fromkeys(touched, self._ticks)

    def is_pushed(self, robot: int) -> bool:
        """Whether somebody touched a robot within the window."""
        return robot in self._touched and self._ticks - self._touched[robot] <= self._window

    def driven_speed(self, robot: int, point: tuple[float, float]) -> float:
        """Return how fast the point of a robot that is at `point` in the world now was driven by the robot itself within the window at most."""
        x, y = self._past[-1][0][robot].inverse().transform(np.array([point]))[0]
        return max(math.hypot(v[robot].vx - v[robot].wz * y, v[robot].vy + v[robot].wz * x) for v in self._driven)

    def approach(self, robot: int, person: int, point: tuple[float, float]) -> float:
        """Return the fastest speed (m/s) at which the point of a robot that is at `point` in the world now moved towards a person within the
        window, negative if it only moved away; 0 when nothing is remembered."""
        if len(self._past) <= self._steps:
            return 0.0
        point_base = self._past[-1][0][robot].inverse().transform(np.array([point]))
        places = [bases[robot].transform(point_base)[0] for bases, _ in self._past]
        fastest = -math.inf
        for k in range(len(places) - self._steps):
            away = np.array(self._past[k][1][person]) - places[k]
            length = math.hypot(*away)
            if length > 0.0:
                moved = places[k + self._steps] - places[k]
                fastest = max(fastest, float(moved @ away) / length / self._span)
        return fastest
