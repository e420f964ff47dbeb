"""Driving to a goal on any level of a map of ground: through passages to the level of the goal, then to the goal itself. It knows no bus.

`begin`, `came_to`, `passage_ended` and `looked` return what is to be done next; who carries it out answers with what became of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import GroundLevels
from ambler.core.se2 import SE2
from ambler.runtime.tasks import LEVEL_NOT_REACHED, NO_PASSAGE

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LevelRouteConfig:
    """A passage is driven to within `tolerance` m; who stands there is given `patience` s to be on the next level; after `tries` drives on one level without that it is given up.
    On a new level the map is given `settle` s."""

    tolerance: float = 0.3
    patience: float = 2.0
    tries: int = 3
    settle: float = 1.0


@dataclass(frozen=True, slots=True)
class ToPassage:
    """Choose `level`, and drive to a place that it shares with the present one."""

    level: int
    place: SE2


@dataclass(frozen=True, slots=True)
class ToGoal:
    """Drive to the goal: it is on the present level."""


@dataclass(frozen=True, slots=True)
class Look:
    """Wait `seconds` and call `looked`."""

    seconds: float


@dataclass(frozen=True, slots=True)
class RouteFailed:
    """Give up, with the name of the failure and why."""

    code: str
    text: str


Leg = ToPassage | ToGoal | Look | RouteFailed


class LevelRoute:
    """One way to a goal on `level`."""

    def __init__(self, level: int, config: LevelRouteConfig | None = None) -> None:
        self.level = level
        self.config = config if config is not None else LevelRouteConfig()
        self._tries = 0

    def begin(self, levels: GroundLevels | None) -> Leg:
        """Return the first leg."""
        if levels is None:
            return RouteFailed(NO_PASSAGE, "there is no map of levels yet")
        if not 0 <= self.level < levels.count:
            return RouteFailed(NO_PASSAGE, f"there is no level {self.level}: the map of ground has {levels.count}")
        if levels.active == self.level:
            return ToGoal()
        following = next_level(levels.passages, levels.active, self.level)
        if following is None:
            return RouteFailed(NO_PASSAGE, f"no passage is known from level {levels.active} on the way to {self.level}")
        rows = levels.passages
        row = rows[(rows[:, 0] == levels.active) & (rows[:, 1] == following)][0]
        return ToPassage(following, SE2(*row[2:].tolist()))

    def came_to(self) -> Leg:
        """Another level than that of the last leg: what was planned on that one is void."""
        self._tries = 0
        return Look(self.config.settle)

    def passage_ended(self) -> Leg:
        """A drive to a passage is over, however: whoever stands there may be told to be on the next level a moment later."""
        self._tries += 1
        return Look(self.config.patience)

    def looked(self, levels: GroundLevels) -> Leg:
        """Return the next leg after waiting."""
        if self._tries >= self.config.tries and levels.active != self.level:
            text = f"{self._tries} drives to the passage did not lead from level {levels.active} to the next"
            return RouteFailed(LEVEL_NOT_REACHED, text)
        return self.begin(levels)


def next_level(passages: F64, here: int, wanted: int) -> int | None:
    """Return the next level on the way to another one, by the fewest passages (N, 5); None: no way is known."""
    reached: dict[int, int] = {here: here}
    queue = [here]
    for level in queue:
        for to_level in passages[passages[:, 0] == level, 1].astype(int).tolist():
            if to_level not in reached:
                reached[to_level] = to_level if level == here else reached[level]
                queue.append(to_level)
    return reached.get(wanted)
