"""Who walked into whom: how fast the touched point of a robot moved towards a person shortly before a contact.

The point stays where it is on the robot; its velocity is taken over 20 ms, towards where the person was at that moment. A robot that a
person has touched may be pushed, into something else, or round, so that another corner of it goes towards him: from then on what counts is how fast it drove itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import dropwhile

import numpy as np
from numpy.typing import NDArray

from ambler.core.protocols import BodyVelocity
from ambler.core.se2 import SE2

WINDOW = 0.5  # seconds before a contact that count
SPAN = 0.02  # seconds over which a velocity is taken
Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Tick:
    bases: tuple[SE2, ...]
    people: tuple[Place, ...]
    driven: tuple[BodyVelocity, ...]
    touched: frozenset[int]


class ApproachMemory:
    """Remembers where robots and people were within the last half second, one entry per tick of `tick` seconds."""

    def __init__(self, tick: float) -> None:
        self._steps = round(SPAN / tick)
        self._span = self._steps * tick
        self._window = round(WINDOW / tick)
        self._past: deque[_Tick] = deque(maxlen=self._window + self._steps)

    def note(
        self,
        world_from_bases: Sequence[SE2],
        people: Sequence[Place],
        driven: Sequence[BodyVelocity],
        touched: Sequence[int] = (),
    ) -> None:
        """Take where everybody is at the end of a tick, what the robots drove in it themselves, and which of them people touch."""
        self._past.append(_Tick(tuple(world_from_bases), tuple(people), tuple(driven), frozenset(touched)))

    def is_pushed(self, robot: int) -> bool:
        """Whether somebody touched a robot within the window."""
        return any(robot in tick.touched for tick in self._newest)

    def driven_speed(self, robot: int, point: Place) -> float:
        """Return how fast the point of a robot that is at `point` in the world now was driven by the robot itself at most, since somebody touched it within the window."""
        point_base = self._past[-1].bases[robot].inverse().transform(np.array([point]))[0]
        pushed = dropwhile(lambda tick: robot not in tick.touched, self._newest)
        return max((math.hypot(*_driven(tick, robot, point_base)) for tick in pushed), default=0.0)

    def approach(self, robot: int, person: int, point: Place) -> float:
        """Return the fastest speed (m/s) at which the point of a robot that is at `point` in the world now moved towards a person within the
        window, negative if it only moved away; 0 when nothing is remembered."""
        past = list(self._past)
        if len(past) <= self._steps:
            return 0.0
        point_base = past[-1].bases[robot].inverse().transform(np.array([point]))
        places = [tick.bases[robot].transform(point_base)[0] for tick in past]
        pushed = next((k for k, tick in enumerate(past) if robot in tick.touched), len(past))
        fastest = -math.inf
        for k, (then, now) in enumerate(zip(past, past[self._steps :], strict=False)):
            away = np.array(then.people[person]) - places[k]
            length = math.hypot(*away)
            if length > 0.0:
                is_pushed = k + self._steps >= pushed
                velocity = (
                    _driven(now, robot, point_base[0])
                    if is_pushed
                    else (places[k + self._steps] - places[k]) / self._span
                )
                fastest = max(fastest, float(velocity @ away) / length)
        return fastest

    @property
    def _newest(self) -> list[_Tick]:
        return list(self._past)[-self._window :]


def _driven(tick: _Tick, robot: int, point_base: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the velocity (2,) in the world that a robot drove a point of itself with."""
    v, (x, y), yaw = tick.driven[robot], point_base, tick.bases[robot].yaw
    vx, vy = v.vx - v.wz * y, v.vy + v.wz * x
    return np.array([math.cos(yaw) * vx - math.sin(yaw) * vy, math.sin(yaw) * vx + math.cos(yaw) * vy])
