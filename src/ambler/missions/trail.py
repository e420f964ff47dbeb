"""The way that a robot has come, and where it is shut now: from there it sees when it opens again."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_INSCRIBED, COST_LETHAL, COST_UNKNOWN
from ambler.core.messages import CostGrid
from ambler.core.se2 import SE2

SPACING = 0.2  # metres between the places that are remembered
LOOK_FROM = 1.2  # metres before what shuts the way, along it
NEAR = 0.5  # metres from the lookout at which the robot is there


class Trail:
    """Places of the map that the robot has passed, oldest first."""

    def __init__(self) -> None:
        self._places: list[tuple[float, float]] = []

    def add(self, map_from_base: SE2) -> None:
        """Remember where the robot is."""
        here = (map_from_base.x, map_from_base.y)
        if not self._places or math.dist(here, self._places[-1]) >= SPACING:
            self._places.append(here)

    def back(self, way: float) -> SE2 | None:
        """Return the place that lies `way` metres back along the trail, or its beginning, looking as the robot did there; None without a trail."""
        if not self._places:
            return None
        k, left = len(self._places) - 1, way
        while k > 0 and left > 0.0:
            left -= math.dist(self._places[k], self._places[k - 1])
            k -= 1
        (x, y), (to_x, to_y) = self._places[k], self._places[min(k + 1, len(self._places) - 1)]
        return SE2(x, y, math.atan2(to_y - y, to_x - x))

    def away(self, map_from_base: SE2, distance: float) -> SE2 | None:
        """Return where the robot was last at least `distance` metres from here, looking here; None if nowhere."""
        here = (map_from_base.x, map_from_base.y)
        for x, y in reversed(self._places):
            if math.dist((x, y), here) >= distance:
                return SE2(x, y, math.atan2(here[1] - y, here[0] - x))
        return None

    def nearest(self, points: NDArray[np.floating]) -> SE2 | None:
        """Return the place of the trail that is nearest to any of `points` (N, 2), looking at them; None without a trail or points."""
        if not self._places or len(points) == 0:
            return None
        gaps = np.hypot(*(np.array(self._places)[:, None, :] - points[None, :, :]).transpose(2, 0, 1))
        k, to = np.unravel_index(int(gaps.argmin()), gaps.shape)
        (x, y), (to_x, to_y) = self._places[k], points[to].tolist()
        return SE2(x, y, math.atan2(to_y - y, to_x - x))

    def lookout(self, costs: CostGrid, map_from_base: SE2) -> SE2 | None:
        """Return from where to watch the place at which an obstacle cuts the way back, looking at it; None when nothing does, or when the
        robot is there already. `costs` are in the map frame."""
        places = self._fine(costs.spec.resolution)[::-1]
        cells = costs.spec.cells_of(places)
        height, width = costs.spec.shape
        is_inside = (cells >= 0).all(axis=1) & (cells[:, 0] < height) & (cells[:, 1] < width)
        values = np.full(len(places), COST_UNKNOWN)
        values[is_inside] = costs.data[cells[is_inside, 0], cells[is_inside, 1]]
        shut = np.flatnonzero(values == COST_LETHAL)
        if len(shut) == 0:
            return None
        first = int(shut[0])
        before = math.ceil(LOOK_FROM / costs.spec.resolution)
        stands = np.flatnonzero(values[: max(0, first - before)] < COST_INSCRIBED)
        if len(stands) == 0:
            return None
        (x, y), (at_x, at_y) = places[stands[-1]], places[first]
        place = SE2(float(x), float(y), math.atan2(at_y - y, at_x - x))
        return None if place.distance_to(map_from_base) <= NEAR else place

    def _fine(self, spacing: float) -> NDArray[np.float64]:
        """The trail as points (N, 2) no farther apart than `spacing`."""
        ends = np.array(self._places).reshape(-1, 2)
        if len(ends) < 2:
            return ends
        lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(ends, axis=0).T))))
        at = np.linspace(0.0, lengths[-1], max(2, math.ceil(lengths[-1] / spacing) + 1))
        return np.stack([np.interp(at, lengths, ends[:, axis]) for axis in (0, 1)], axis=1)
