"""The way from one level of a map of ground to another: which passage next. It knows neither bus nor costs.

Robots plan and drive on one level at a time, because a planar path cannot say on which of two sheets of ground it lies. So a way to another level is a chain of
drives, each to a passage, whatever planner finds them. Passages are chosen by the shortest chain of straight lines through them (Dijkstra); one that cannot be reached, or that does
not lead where it should, is left out, and the next best chain is taken.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from dataclasses import dataclass

from ambler.core.messages import GroundLevels
from ambler.core.se2 import SE2

Key = tuple[int, int, float, float]


@dataclass(frozen=True, slots=True)
class Hop:
    """A change of level: `map_from_place` is on both."""

    of_level: int
    to_level: int
    map_from_place: SE2

    @property
    def key(self) -> Key:
        """What tells it from other passages."""
        return self.of_level, self.to_level, self.map_from_place.x, self.map_from_place.y


class LevelRoute:
    """The passages of one drive: which were tried how often, and which comes next. A passage that was tried `tries` times is left out."""

    def __init__(self, tries: int) -> None:
        self._tries = tries
        self._tried: Counter[Key] = Counter()

    def next_hop(self, levels: GroundLevels, base: SE2, level: int, goal: SE2) -> Hop | None:
        """Return the first passage of the shortest chain from `base` on the level where the robot is to `goal` on another `level`; None when no chain is left."""
        hops = [hop for hop in hops_of(levels) if self._tried[hop.key] < self._tries]
        queue: list[tuple[float, int, int]] = []
        best = [math.inf] * len(hops)
        first = list(range(len(hops)))

        def reach(k: int, metres: float, through: int) -> None:
            if metres < best[k]:
                best[k], first[k] = metres, through
                heapq.heappush(queue, (metres, k, hops[k].to_level))

        for k, hop in enumerate(hops):
            if hop.of_level == levels.active:
                reach(k, base.distance_to(hop.map_from_place), k)
        shortest, found = math.inf, None
        while queue:
            metres, k, here = heapq.heappop(queue)
            if metres > best[k]:
                continue
            if metres >= shortest:
                break
            place = hops[k].map_from_place
            if here == level and metres + place.distance_to(goal) < shortest:
                shortest, found = metres + place.distance_to(goal), hops[first[k]]
            for m, hop in enumerate(hops):
                if hop.of_level == here:
                    reach(m, metres + place.distance_to(hop.map_from_place), first[k])
        return found

    def try_hop(self, hop: Hop) -> None:
        """Count that a passage was tried."""
        self._tried[hop.key] += 1

    def leave_out(self, hop: Hop) -> None:
        """Take that a passage cannot be used."""
        self._tried[hop.key] = self._tries


def hops_of(levels: GroundLevels) -> list[Hop]:
    """Return the passages of a message as records."""
    return [Hop(round(of), round(to), SE2(x, y, yaw)) for of, to, x, y, yaw in levels.passages.tolist()]
