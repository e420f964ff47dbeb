"""Ways that the planner offers and the controller cannot follow: after three failures at one place it is marked, and planned around.

The map may have lost a wall that is there, or the robot does not fit where its footprint says that it does. Without a mark the planner
offers the same way again and again. The only way out is not marked: a robot that is shut in by its own marks finds nothing any more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_INSCRIBED
from ambler.core.messages import CostGrid, Path
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]
TOUCH = 0.08  # metres: a mark that a body touches would hold it itself


@dataclass(frozen=True, slots=True)
class BlockedWaysConfig:
    """`failures` within `near` metres of each other and `memory` s make a mark of `length` metres of the path and `width` across, so
    that it is not passed by a hand's breadth; it begins `ahead` metres before the robot: far enough for it to turn away. A mark holds for `keep` s, among people, who leave, for `keep_company` s, and twice as
    long each time that it comes back at the same place, up to `keep_most`. What holds the robot and no sensor shows is marked at once, for `keep_held` s: `width_held` metres across, from `front` metres before the base, where its body
    ends, on. Held again within `same_thing` metres, it has met the same thing twice: that is marked from place to place and `beyond` metres farther to both sides, for `keep_same` s: a kerb does not walk away. Among people the robot may be held by one of
    them: such a mark begins with `keep_company` s, too, and gets no wider."""

    failures: int = 3
    near: float = 1.0
    memory: float = 120.0
    ahead: float = 0.6
    length: float = 0.6
    width: float = 0.5
    keep: float = 60.0
    keep_most: float = 960.0
    keep_company: float = 10.0
    front: float = 0.3
    width_held: float = 1.0
    keep_held: float = 240.0
    keep_same: float = 3600.0
    same_thing: float = 4.0
    beyond: float = 2.5
    least_left: float = (
        0.5  # of what the robot could reach; a mark that leaves it less would shut it in, not lead it around
    )

    def __post_init__(self) -> None:
        if self.failures < 1 or min(self.near, self.memory, self.ahead, self.length, self.keep) <= 0.0:
            raise BadInputError("blocked ways: counts and lengths must be positive")


@dataclass(slots=True, eq=False)
class _Mark:
    place: F64
    points: F64
    until_ns: int
    keep: float
    is_held: bool = False


class BlockedWays:
    """Counts failures and holds the marks; all places are in the map frame."""

    def __init__(self, config: BlockedWaysConfig | None = None) -> None:
        self.config = config or BlockedWaysConfig()
        self._failures: list[tuple[int, float, float]] = []
        self._marks: list[_Mark] = []

    def fail(
        self,
        path: Path,
        map_from_base: SE2,
        now_ns: int,
        costs: CostGrid | None = None,
        *,
        is_in_company: bool = False,
    ) -> bool:
        """Take that the controller could not follow a path here; returns whether that made a mark. On `costs` (global, in the map frame) it is
        seen whether that would shut the robot in. `is_in_company`: people are about, who may have stood there."""
        c = self.config
        line = _ahead(path, map_from_base, c.ahead, c.length)
        x, y = line[0].tolist()
        since_ns = now_ns - round(c.memory * 1e9)
        self._failures = [f for f in self._failures if f[0] >= since_ns]
        self._failures.append((now_ns, x, y))
        if sum(math.hypot(fx - x, fy - y) <= c.near for _, fx, fy in self._failures) < c.failures:
            return False
        self._failures = [f for f in self._failures if math.hypot(f[1] - x, f[2] - y) > c.near]
        keep = c.keep_company if is_in_company else c.keep
        old = [m for m in self._marks if math.hypot(*(m.place - line[0])) <= c.near]
        for mark in old:
            keep = min(max(keep, 2.0 * mark.keep), c.keep_most)
        new = _Mark(line[0], _widened(line, c.width), now_ns + round(keep * 1e9), keep)
        return self._add(new, old, map_from_base, now_ns, costs)

    def hold(
        self,
        path: Path,
        map_from_base: SE2,
        now_ns: int,
        costs: CostGrid | None = None,
        *,
        is_in_company: bool = False,
    ) -> bool:
        """Take that something which no sensor shows (glass, the end of a kerb) holds the robot on a path here; returns whether it is marked. As a rule it goes on to both sides;
        among people it may be one of them."""
        c = self.config
        x, y = _ahead(path, map_from_base, c.ahead, c.length)[0].tolist()
        yaw = math.atan2(y - map_from_base.y, x - map_from_base.x)
        along = _steps((c.front + TOUCH, c.front + TOUCH + c.length))
        line = np.array([map_from_base.x, map_from_base.y]) + along[:, None] * (math.cos(yaw), math.sin(yaw))
        points, keep = [_widened(line, c.width_held)], c.keep_company if is_in_company else c.keep_held
        for other in self._marks:
            away = math.hypot(*(other.place - line[0]))
            if not other.is_held or away > c.same_thing:
                continue
            if is_in_company:
                keep = min(max(keep, 2.0 * other.keep), c.keep_held)
            elif away > 0.0 and now_ns < other.until_ns:
                points.append(_through(other.place, line[0], c.beyond))
                keep = c.keep_same
        mark = _Mark(line[0], np.concatenate(points), now_ns + round(keep * 1e9), keep, is_held=True)
        return self._add(mark, [], map_from_base, now_ns, costs)

    def _add(self, mark: _Mark, old: list[_Mark], map_from_base: SE2, now_ns: int, costs: CostGrid | None) -> bool:
        """Put a mark in the place of old ones, unless it would shut the robot in; returns whether it holds."""
        before = self._marks
        self._marks = [m for m in before if m not in old] + [mark]
        points, c = self.points(now_ns), self.config
        if costs is None or reachable_share(costs, map_from_base, points, c.width) >= c.least_left:
            return True
        self._marks = before
        return False

    def points(self, now_ns: int) -> F64:
        """Return the marked points (N, 2) that hold now. Marks that have run out are remembered for a while, for the doubling."""
        self._marks = [m for m in self._marks if now_ns < m.until_ns + round(self.config.keep_most * 1e9)]
        return np.concatenate([np.empty((0, 2)), *(m.points for m in self._marks if now_ns < m.until_ns)])


def reachable_share(costs: CostGrid, map_from_base: SE2, points: F64, around: float) -> float:
    """Return which share of the cells that the robot could reach it can still reach when nothing passes within `around` metres of `points` (N, 2)
    of the map; 0 when it stands in none."""
    spec = costs.spec
    free = (costs.data < COST_INSCRIBED).astype(np.uint8)
    cells = spec.cells_of(points)
    cells = cells[(cells >= 0).all(axis=1) & (cells < np.array(spec.shape)).all(axis=1)]
    marked = np.zeros(spec.shape, np.uint8)
    marked[cells[:, 0], cells[:, 1]] = 1
    n = max(1, round(around / spec.resolution))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * n + 1, 2 * n + 1))
    is_marked = cv2.dilate(marked, disc) > 0
    iy, ix = spec.cell_of(map_from_base.x, map_from_base.y)
    window = (slice(max(0, iy - n), iy + n + 1), slice(max(0, ix - n), ix + n + 1))
    left = np.where(is_marked, 0, free).astype(np.uint8)
    counts = [_region(cells_free, left[window], window) for cells_free in (free, left)]
    return counts[1] / counts[0] if counts[0] else 0.0


def _region(free: NDArray[np.uint8], near: NDArray[np.uint8], window: tuple[slice, slice]) -> int:
    """Return how many cells are connected with those that are `near` the robot in a window of a grid."""
    labels = cv2.connectedComponents(free, connectivity=4)[1]
    found = labels[window][near > 0]
    return int(np.count_nonzero(labels == np.bincount(found).argmax())) if len(found) else 0


def _widened(line: F64, width: float) -> F64:
    """Return parallels of a line (N, 2), 5 cm apart."""
    along = line[-1] - line[0]
    length = math.hypot(along[0], along[1])
    if length == 0.0:
        return line
    across = np.array([-along[1], along[0]]) / length
    offsets = np.linspace(-0.5 * width, 0.5 * width, 1 + math.ceil(width / 0.05))
    return (line[:, None] + offsets[:, None] * across).reshape(-1, 2)


def _through(a: F64, b: F64, beyond: float) -> F64:
    """Return points (N, 2), 5 cm apart, on the line through two places from `beyond` metres before the one to as far behind the other."""
    apart = math.hypot(*(b - a))
    return a + _steps((-beyond, apart + beyond))[:, None] * (b - a) / apart


def _ahead(path: Path, map_from_base: SE2, begin: float, length: float) -> F64:
    """Return the points (N, 2) of a path from `begin` metres after its point nearest to the robot, 5 cm apart; its last point at least."""
    xy = np.asarray(path.poses[:, :2], np.float64)
    nearest = int(np.argmin(np.hypot(xy[:, 0] - map_from_base.x, xy[:, 1] - map_from_base.y)))
    rest = xy[nearest:]
    if len(rest) < 2:
        return rest
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(rest, axis=0).T))))
    at = _steps((begin, begin + length))
    at = at[at <= along[-1]] if along[-1] > begin else along[-1:]
    return np.stack([np.interp(at, along, rest[:, axis]) for axis in (0, 1)], axis=1)


def _steps(reach: tuple[float, float]) -> F64:
    """Return places 5 cm apart from one distance to another."""
    return np.arange(*reach, 0.05)
