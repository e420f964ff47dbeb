"""What an exploration left behind on levels of the ground that the robot is not on, and which of them it has to come back to."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import Frontier, FrontierState


class LeftLevels:
    """A level is gone to at most `tries` times; frontiers within `near` metres of one another are one."""

    def __init__(self, tries: int, near: float) -> None:
        self._tries, self._near = tries, near
        self._tried: Counter[int] = Counter()
        self._left: dict[int, tuple[Frontier, ...]] = {}
        self._settled: tuple[Frontier, ...] = ()  # what was left when nothing was open and the robot set out

    @property
    def frontiers(self) -> tuple[Frontier, ...]:
        """What was open or refused on all of them."""
        return tuple(f for left in self._left.values() for f in left)

    def set_out(self, for_level: int, here: tuple[Frontier, ...]) -> None:
        """The robot sets out for another level; `here` is what is left on this one."""
        self._tried[for_level] += 1
        self._settled = here

    def leave(self, level: int, frontiers: tuple[Frontier, ...]) -> None:
        """The robot is not on a level any more; `frontiers` is what it saw there last."""
        self._left[level] = tuple(map(self._as_settled, frontiers))

    def come_to(self, level: int) -> None:
        """The robot is on a level: what is open there is what it sees."""
        self._settled = ()
        self._left.pop(level, None)

    def unfinished(self) -> set[int]:
        """Return the levels on which something is open, without those that were tried too often."""
        open_on = {k for k, left in self._left.items() if any(f.state is FrontierState.OPEN for f in left)}
        return {k for k in open_on if not self.is_hopeless(k)}

    def is_hopeless(self, level: int, times: int = 1) -> bool:
        """Tell whether a level was tried too often, `times` that often."""
        return self._tried[level] >= times * self._tries

    def _as_settled(self, frontier: Frontier) -> Frontier:
        """A frontier that was judged before the robot set out for another level has not opened because it did."""
        is_open = frontier.state is FrontierState.OPEN
        if not is_open or all(math.dist(f.centroid, frontier.centroid) > self._near for f in self._settled):
            return frontier
        return replace(frontier, state=FrontierState.UNREACHABLE, reason="it was left when nothing else was open")


def nearest_level(level: int, passages: NDArray[np.float64], wanted: set[int]) -> tuple[int, int] | None:
    """Return the nearest of some levels and the next one on the way there, by the fewest `passages` (N, 5) as in core.messages.GroundLevels; None: no way is known."""
    reached = {level: level}
    queue = [level]
    for here in queue:
        if here in wanted:
            return here, reached[here]
        for to_level in passages[passages[:, 0] == here, 1].astype(int).tolist():
            if to_level not in reached:
                reached[to_level] = to_level if here == level else reached[here]
                queue.append(to_level)
    return None
