"""Where a local planner heads next: the farthest point of its path in sight, a way around what blocks it, or a way out of a dead end.

Ways are found in the local window by breadth-first search for the robot's inscribed circle; whether the footprint fits is the primitives' business.
"""

from __future__ import annotations

import math
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

CANDIDATES = 0.1  # metres between the points of the path that are tried
EXIT = 0.9  # of the way to the window's rim from where on a place counts as out of it


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

    def reset(self) -> None:
        """Forget the way out that was being taken."""
        self._exit = None

    @property
    def is_leaving(self) -> bool:
        """Whether a way out of a dead end is being taken."""
        return self._exit is not None

    def pick(self, start: SE2, tracker: PathTracker, left: float) -> LocalGoal | None:
        """Return where to head, or None when the path is blocked and there is no way around it in sight."""
        reach = min(self._config.range, left)
        if self._exit is None and self._sees_path(start, tracker, reach):
            x, y = tracker.point_at(reach)
            return LocalGoal(x, y, is_end=reach >= left - 1e-6)
        self._spread(start)
        if self._exit is not None and not self._is_exit_over(start, tracker, reach):
            return self._towards(self._exit, start)
        self._exit = None
        free = self._free_stretch(tracker, reach)
        if free > 0.0:  # the path is free, only not straight
            for s in np.arange(free, 0.3, -CANDIDATES):
                place = tracker.point_at(float(s))
                if self._is_in_sight(start, place):
                    return LocalGoal(*place, is_end=bool(s >= left - 1e-6))
        for s in np.arange(reach, 0.0, -CANDIDATES):
            place = tracker.point_at(float(s))
            walk = self._walk(place)
            if walk is not None and walk <= s + self._config.detour:
                return self._towards(place, start)
        return None

    def leave(self, start: SE2, goal: SE2) -> LocalGoal | None:
        """Choose the best way out of the window that the memory leaves; None when there is none."""
        self._spread(start)
        w = self._window
        reached = np.argwhere(self._steps >= 0)
        if len(reached) == 0:
            return None
        places = w.spec.centers_of(reached)
        half = 0.5 * min(w.spec.width, w.spec.height) * w.spec.resolution
        from_robot = np.maximum(np.abs(places[:, 0] - start.x), np.abs(places[:, 1] - start.y))
        to_goal = np.hypot(places[:, 0] - goal.x, places[:, 1] - goal.y)
        is_exit = (from_robot >= EXIT * half - 0.15) | (to_goal < 0.2)
        if not is_exit.any():
            return None
        walk = self._steps[reached[:, 0], reached[:, 1]] * w.spec.resolution
        cost = np.where(is_exit, walk + to_goal + self._memory.cost(places), np.inf)
        best = int(np.argmin(cost))
        self._exit = float(places[best, 0]), float(places[best, 1])
        return self._towards(self._exit, start)

    def _is_exit_over(self, start: SE2, tracker: PathTracker, reach: float) -> bool:
        """Whether the way out has been taken, or leads nowhere any more, or is not needed: the path can be walked to again by a way that costs no more."""
        assert self._exit is not None
        walk = self._walk(self._exit)
        if walk is None or math.hypot(self._exit[0] - start.x, self._exit[1] - start.y) < 0.4:
            return True
        again = self._walk(tracker.point_at(reach))
        return again is not None and again <= reach + 0.5 * self._config.detour

    def _sees_path(self, start: SE2, tracker: PathTracker, reach: float) -> bool:
        return self._is_in_sight(start, tracker.point_at(reach))

    def _is_in_sight(self, start: SE2, place: tuple[float, float]) -> bool:
        """Whether the inscribed circle can move to a place in a straight line; where the robot stands, it is."""
        away = math.hypot(place[0] - start.x, place[1] - start.y)
        count = max(1, math.ceil(away / self._config.sight_step))
        share = (np.arange(1, count + 1) / count)[:, None]
        points = np.array([[start.x, start.y]]) + share * np.array([[place[0] - start.x, place[1] - start.y]])
        return bool((self._distance(points) >= self._radius).all())

    def _free_stretch(self, tracker: PathTracker, reach: float) -> float:
        """Return the length of the path ahead (m, at most `reach`) on which the inscribed circle is free; 0 unless all of it is."""
        points = tracker.ahead(reach)[:, :2]
        if not (self._distance(points) >= self._radius).all():
            return 0.0
        return reach

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

    def _cell(self, place: tuple[float, float]) -> tuple[int, int] | None:
        iy, ix = self._window.spec.cell_of(*place)
        height, width = self._steps.shape
        return (iy, ix) if 0 <= iy < height and 0 <= ix < width else None

    def _walk(self, place: tuple[float, float]) -> float | None:
        """Return how far it is to walk to a place (m, along rows and columns, shortened as if half of it were diagonal), or None."""
        cell = self._cell(place)
        if cell is None or self._steps[cell] < 0:
            return None
        return 0.85 * float(self._steps[cell]) * self._window.spec.resolution

    def _towards(self, place: tuple[float, float], start: SE2) -> LocalGoal | None:
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
