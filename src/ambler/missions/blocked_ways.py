"""Ways that the planner offers and the controller cannot follow: after three failures at one place it is marked, and planned around.

The map may have lost a wall that is there, or the robot does not fit where its footprint says that it does. Without a mark the planner
offers the same way again and again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import Path
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BlockedWaysConfig:
    """`failures` within `near` metres of each other and `memory` s make a mark of `length` metres of the path and `width` across, so
    that it is not passed by a hand's breadth; it begins `ahead` metres before the robot: far enough for it to turn away. A mark holds for `keep` s, because whoever stood there may have left, and twice as
    long each time that it comes back at the same place, up to `keep_most`."""

    failures: int = 3
    near: float = 1.0
    memory: float = 120.0
    ahead: float = 0.6
    length: float = 0.6
    width: float = 0.5
    keep: float = 60.0
    keep_most: float = 960.0

    def __post_init__(self) -> None:
        if self.failures < 1 or min(self.near, self.memory, self.ahead, self.length, self.keep) <= 0.0:
            raise BadInputError("blocked ways: counts and lengths must be positive")


@dataclass(slots=True, eq=False)
class _Mark:
    place: F64
    points: F64
    until_ns: int
    keep: float


class BlockedWays:
    """Counts failures and holds the marks; all places are in the map frame."""

    def __init__(self, config: BlockedWaysConfig | None = None) -> None:
        self.config = config or BlockedWaysConfig()
        self._failures: list[tuple[int, float, float]] = []
        self._marks: list[_Mark] = []

    def fail(self, path: Path, map_from_base: SE2, now_ns: int) -> bool:
        """Take that the controller could not follow a path here; returns whether that made a mark."""
        c = self.config
        line = _ahead(path, map_from_base, c.ahead, c.length)
        x, y = line[0].tolist()
        since_ns = now_ns - round(c.memory * 1e9)
        self._failures = [f for f in self._failures if f[0] >= since_ns]
        self._failures.append((now_ns, x, y))
        if sum(math.hypot(fx - x, fy - y) <= c.near for _, fx, fy in self._failures) < c.failures:
            return False
        self._failures = [f for f in self._failures if math.hypot(f[1] - x, f[2] - y) > c.near]
        keep = c.keep
        for old in [m for m in self._marks if math.hypot(*(m.place - line[0])) <= c.near]:
            keep = min(max(keep, 2.0 * old.keep), c.keep_most)
            self._marks.remove(old)
        self._marks.append(_Mark(line[0], _widened(line, c.width), now_ns + round(keep * 1e9), keep))
        return True

    def points(self, now_ns: int) -> F64:
        """Return the marked points (N, 2) that hold now. Marks that have run out are remembered for a while, for the doubling."""
        self._marks = [m for m in self._marks if now_ns < m.until_ns + round(self.config.keep_most * 1e9)]
        return np.concatenate([np.empty((0, 2)), *(m.points for m in self._marks if now_ns < m.until_ns)])


def _widened(line: F64, width: float) -> F64:
    """Return parallels of a line (N, 2), 5 cm apart."""
    along = line[-1] - line[0]
    length = math.hypot(along[0], along[1])
    if length == 0.0:
        return line
    across = np.array([-along[1], along[0]]) / length
    offsets = np.linspace(-0.5 * width, 0.5 * width, 1 + math.ceil(width / 0.05))
    return (line[:, None] + offsets[:, None] * across).reshape(-1, 2)


def _ahead(path: Path, map_from_base: SE2, begin: float, length: float) -> F64:
    """Return the points (N, 2) of a path from `begin` metres after its point nearest to the robot, 5 cm apart; its last point at least."""
    xy = np.asarray(path.poses[:, :2], np.float64)
    nearest = int(np.argmin(np.hypot(xy[:, 0] - map_from_base.x, xy[:, 1] - map_from_base.y)))
    rest = xy[nearest:]
    if len(rest) < 2:
        return rest
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(rest, axis=0).T))))
    at = np.arange(begin, begin + length, 0.05)
    at = at[at <= along[-1]] if along[-1] > begin else along[-1:]
    return np.stack([np.interp(at, along, rest[:, axis]) for axis in (0, 1)], axis=1)
