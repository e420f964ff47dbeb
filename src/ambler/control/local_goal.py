"""Where a local planner heads next: the farthest point of its path in sight, a way around what blocks it, or a way out of a dead end.

Ways are found in the local window by breadth-first search for the robot's inscribed circle; whether the footprint fits is the primitives' business.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.control.dead_ends import DeadEnds
from ambler.control.local_window import LocalWindow
from ambler.control.path_tracker import PathTracker
from ambler.control.primitives_config import PrimitivesConfig
from ambler.core.se2 import SE2
from ambler.kernels.rollout import spread_path

F64 = NDArray[np.float64]

CANDIDATES = 0.1  # metres between the points of the path that are looked at
STOP = 0.4  # metres before what blocks the path, beside the robot's own length, from where on it is not approached any more
FAR = 1.0  # metres by which a way around may be longer than the path without leading out of a dead end
MEMORY_REACH = 10.0  # metres of path ahead on which remembered dead ends are looked for
THERE = 0.6  # metres from the end of a way out at which it has been taken
RIM = 1  # cells from the window's rim at which a place counts as out of it


@dataclass(frozen=True, slots=True)
class LocalGoal:
    """A point of the odom frame; `is_end` when it is the path's own end, `is_detour` when it lies off the path."""

    x: float
    y: float
    is_end: bool = False
    is_detour: bool = False


class LocalGoals:
    """Picks local goals in a window. A way out of a dead end is kept until it is reached or does not exist any more."""

    def __init__(self, config: PrimitivesConfig, window: LocalWindow, memory: DeadEnds) -> None:
        self._config = config
        self._window = window
        self._memory = memory
        self._radius = window.inscribed_radius + config.padding
        self._steps = np.empty((0, 0), np.int32)
        self._label = np.empty((0, 0), np.int32)
        self._exit: tuple[float, float] | None = None
        self._nose = window.radius - window.inscribed_radius + 0.1
        self.has_taken_exit = False
        """Whether the end of the last way out has been reached."""
        self.blocked_at: tuple[float, float] | None = None
        """The first point of the path that is blocked, when there was nowhere to head."""

    @property
    def is_blocked_by_memory(self) -> bool:
        """Whether it is only remembered that the path is blocked there."""
        return self.blocked_at is not None and bool(self._memory.covers(np.array([self.blocked_at]))[0])

    def reset(self) -> None:
        """Forget the way out that was being taken."""
        self._exit = None
        self.has_taken_exit = False

    @property
    def is_leaving(self) -> bool:
        """Whether a way out of a dead end is being taken."""
        return self._exit is not None

    def pick(self, start: SE2, tracker: PathTracker, left: float, now: float) -> LocalGoal | None:
        """Return where to head, or None when the path is blocked just ahead and there is no way around in sight (`blocked_at`)."""
        reach = min(self._config.range, left)
        s = np.append(np.arange(0.0, reach, CANDIDATES), reach)
        points = np.array([tracker.point_at(float(at)) for at in s])
        is_blocked = self._blocked(points)
        self.blocked_at = None
        if self._exit is None and not is_blocked.any():
            return self._farthest_in_sight(start, s, points, left)
        self._spread(start)
        if self._exit is not None:
            goal = None if self._is_exit_over(start, points, is_blocked) else self._towards(self._exit, start)
            if goal is not None:
                return goal
            self._exit = None
            if not is_blocked.any():
                return self._farthest_in_sight(start, s, points, left)
        first = int(np.argmax(is_blocked))
        at = float(points[first, 0]), float(points[first, 1])
        beyond = max(float(s[first]), self._remembered_to(tracker, left))
        for k in range(len(s) - 1, int(np.searchsorted(s, beyond, side="right")) - 1, -1):
            walk = None if is_blocked[k] else self._walk(points[k])
            if walk is None or walk > s[k] + self._config.detour:
                continue
            if walk > s[k] + FAR:  # a way back out, seen in time: it must not be forgotten half-way
                self._memory.add(SE2(*at), at, now)
                self._exit = float(points[k, 0]), float(points[k, 1])
            return self._towards(points[k], start)
        is_remembered = bool(self._memory.covers(points[first : first + 1])[0])
        before = int((s[first] - self._nose) / CANDIDATES)
        if s[first] > self._nose + STOP and not is_remembered:
            return self._farthest_in_sight(start, s[:before], points[:before], left)
        self.blocked_at = at
        return None

    def forget_opened(self) -> None:
        """Forget the dead ends in the window whose blocked point is free now."""
        w = self._window
        for place in list(self._memory.places):
            point = np.array([[place.blocked_x, place.blocked_y]])
            (iy, ix), rim = w.spec.cell_of(place.blocked_x, place.blocked_y), math.ceil(1.0 / w.spec.resolution)
            is_inside = rim <= iy < w.spec.height - rim and rim <= ix < w.spec.width - rim
            if is_inside and self._distance(point)[0] >= self._radius:
                self._memory.places.remove(place)

    def leave(self, start: SE2, goal: SE2) -> LocalGoal | None:
        """Choose the best way out of the window that the memory leaves; None when there is none."""
        self._spread(start)
        w = self._window
        reached = np.argwhere(self._steps >= 0)
        if len(reached) == 0:
            return None
        places = w.spec.centers_of(reached)
        to_goal = np.hypot(places[:, 0] - goal.x, places[:, 1] - goal.y)
        height, width = self._steps.shape
        iy, ix = reached.T
        is_exit = (iy <= RIM) | (iy >= height - 1 - RIM) | (ix <= RIM) | (ix >= width - 1 - RIM) | (to_goal < 0.2)
        if not is_exit.any():
            return None
        walk = self._steps[reached[:, 0], reached[:, 1]] * w.spec.resolution
        cost = np.where(is_exit, walk + to_goal + self._memory.cost(places), np.inf)
        best = int(np.argmin(cost))
        self._exit = float(places[best, 0]), float(places[best, 1])
        return self._towards(self._exit, start)

    def _is_exit_over(self, start: SE2, points: F64, is_blocked: NDArray[np.bool_]) -> bool:
        """Whether the way out has been taken, or leads nowhere any more, or is not needed: the path ahead is free and can be walked to."""
        assert self._exit is not None
        self.has_taken_exit = math.hypot(self._exit[0] - start.x, self._exit[1] - start.y) < THERE
        if self.has_taken_exit or self._walk(self._exit) is None:
            return True
        walk = None if is_blocked.any() else self._walk(points[-1])
        return walk is not None and walk <= 1.3 * math.hypot(points[-1, 0] - start.x, points[-1, 1] - start.y) + 0.5

    def _blocked(self, points: F64) -> NDArray[np.bool_]:
        """Which points of the path the inscribed circle cannot pass, or lie where the way was a dead end."""
        return np.asarray((self._distance(points) < self._window.inscribed_radius) | self._memory.covers(points))

    def _remembered_to(self, tracker: PathTracker, left: float) -> float:
        """Return how far ahead (m) the last dead end on the path lies, 0 without any."""
        if not self._memory.places:
            return 0.0
        s = np.arange(0.0, min(left, MEMORY_REACH), 0.25)
        covered = np.flatnonzero(
            self._memory.covers(np.array([tracker.point_at(float(at)) for at in s]).reshape(-1, 2))
        )
        return float(s[covered[-1]]) if len(covered) else 0.0

    def _farthest_in_sight(self, start: SE2, s: F64, points: F64, left: float) -> LocalGoal:
        """Return the farthest of some points of the path in sight, or one a little ahead."""
        for k in range(len(s) - 1, -1, -1):
            if s[k] <= 0.4 or self._is_in_sight(start, points[k]):
                k = min(len(s) - 1, max(k, int(0.5 / CANDIDATES)))
                return LocalGoal(float(points[k, 0]), float(points[k, 1]), is_end=bool(s[k] >= left - 1e-6))
        raise AssertionError("the first point is always near")

    def _is_in_sight(self, start: SE2, place: Sequence[float] | F64) -> bool:
        """Whether the inscribed circle can move to a place in a straight line; where the robot stands, it is."""
        away = math.hypot(place[0] - start.x, place[1] - start.y)
        count = max(1, math.ceil(away / self._config.sight_step))
        share = (np.arange(1, count + 1) / count)[:, None]
        points = np.array([[start.x, start.y]]) + share * np.array([[place[0] - start.x, place[1] - start.y]])
        return bool((self._distance(points) >= self._radius).all())

    def _distance(self, points: F64) -> F64:
        """Return the distance to lethal cells at points of the odom frame; what lies outside of the window is free."""
        w = self._window
        cells = np.floor((points - (w.spec.origin_x, w.spec.origin_y)) / w.spec.resolution).astype(int)
        inside = (cells >= 0).all(axis=1) & (cells < (w.spec.width, w.spec.height)).all(axis=1)
        out = np.full(len(points), np.inf)
        out[inside] = w.distance[cells[inside, 1], cells[inside, 0]]
        return out

    def _spread(self, start: SE2) -> None:
        """Search the window from where the robot stands, which may be closer to something than it likes."""
        w = self._window
        if self._steps.shape != w.spec.shape:
            self._steps, self._label = np.empty(w.spec.shape, np.int32), np.empty(w.spec.shape, np.int32)
        iy, ix = w.spec.cell_of(start.x, start.y)
        cells = [(iy + dy, ix + dx) for dy in range(-2, 3) for dx in range(-2, 3)]
        cells.sort(key=lambda cell: abs(cell[0] - iy) + abs(cell[1] - ix))
        queue = np.empty(w.spec.width * w.spec.height, np.int32)
        spread_path(np.array(cells, np.int32), w.distance, self._radius, self._steps, self._label, queue)

    def _cell(self, place: Sequence[float] | F64) -> tuple[int, int] | None:
        iy, ix = self._window.spec.cell_of(float(place[0]), float(place[1]))
        height, width = self._steps.shape
        return (iy, ix) if 0 <= iy < height and 0 <= ix < width else None

    def _walk(self, place: Sequence[float] | F64) -> float | None:
        """Return how far it is to walk to a place (m, along rows and columns, shortened as if half of it were diagonal), or None."""
        cell = self._cell(place)
        if cell is None or self._steps[cell] < 0:
            return None
        return 0.85 * float(self._steps[cell]) * self._window.spec.resolution

    def _towards(self, place: Sequence[float] | F64, start: SE2) -> LocalGoal | None:
        """Return the farthest place in sight on the way to one that can be walked to."""
        cell = self._cell(place)
        if cell is None or self._steps[cell] < 0:
            return None
        way = [cell]
        while self._steps[cell] > 0:
            cell = self._step_back(cell)
            way.append(cell)
        centers = self._window.spec.centers_of(np.array(way))
        for x, y in centers:
            if self._is_in_sight(start, (float(x), float(y))):
                return LocalGoal(float(x), float(y), is_detour=True)
        x, y = centers[max(0, len(centers) - 1 - round(0.5 / self._window.spec.resolution))]
        return LocalGoal(float(x), float(y), is_detour=True)

    def _step_back(self, cell: tuple[int, int]) -> tuple[int, int]:
        iy, ix = cell
        height, width = self._steps.shape
        for ny, nx in ((iy - 1, ix), (iy + 1, ix), (iy, ix - 1), (iy, ix + 1)):
            if 0 <= ny < height and 0 <= nx < width and self._steps[ny, nx] == self._steps[cell] - 1:
                return ny, nx
        return cell if self._steps[cell] == 0 else (iy, ix)
