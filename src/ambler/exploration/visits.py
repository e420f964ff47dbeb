"""How often the robot has looked at a place, and from which side: frontiers there may have another shape each time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import Frontier, OccupancyGrid
from ambler.exploration.lattice import carried
from ambler.exploration.sides import SIDES, sides_of


@dataclass(frozen=True, slots=True)
class VisitsConfig:
    """A look counts for what lies within `around` (m) of the frontier that was looked at, from the side of its goal and those beside it, once in `apart` seconds: who has looked at
    the wall below a ramp has not looked at what lies at its top. A frontier has been looked at as often as the place where `share` of its cells lie."""

    around: float = 0.5
    apart: float = 10.0
    share: float = 0.5


class Visits:
    """Counts looks cell by cell, [side, iy, ix]; follows the map's geometry as it grows."""

    def __init__(self, config: VisitsConfig) -> None:
        self.config = config
        self._spec: GridSpec | None = None
        self._counts: NDArray[np.uint8] = np.zeros((SIDES, 0, 0), np.uint8)
        # By whatever clock: no float32 tells the seconds of a time of day apart.
        self._last_s: NDArray[np.float64] = np.zeros((SIDES, 0, 0), np.float64)

    def add(self, frontier: Frontier, occupancy: OccupancyGrid) -> None:
        """Take down that the robot looked at a frontier, at the time of this map."""
        spec = occupancy.spec
        self._move_to(spec)
        reach = round(self.config.around / spec.resolution)
        is_beside = np.zeros(spec.shape, np.bool_)
        for iy, ix in spec.cells_of(frontier.cells).tolist():
            is_beside[max(0, iy - reach) : max(0, iy + reach + 1), max(0, ix - reach) : max(0, ix + reach + 1)] = True
        rows, columns = np.nonzero(is_beside)
        sides = _sides(spec.centers_of(np.column_stack((rows, columns))), frontier)
        now = occupancy.stamp_ns * 1e-9
        for turn in range(SIDES) if frontier.goal is None else (-1, 0, 1):
            cells = ((sides + turn) % SIDES, rows, columns)
            counts, last = self._counts[cells], self._last_s[cells]
            is_new = (counts == 0) | (now - last >= self.config.apart)
            self._counts[cells] = counts + (is_new & (counts < 255))
            self._last_s[cells] = np.where(is_new, now, last)

    def at(self, frontier: Frontier, spec: GridSpec) -> int:
        """Return how often the place of a frontier has been looked at from the side of its goal; of one without a goal, from the side from which it was most often."""
        self._move_to(spec)
        iy, ix = spec.cells_of(frontier.cells).T
        is_inside = (iy >= 0) & (iy < spec.height) & (ix >= 0) & (ix < spec.width)
        looks = self._counts[:, iy[is_inside], ix[is_inside]]
        counts = np.zeros(len(iy), np.uint8)
        sides = _sides(frontier.cells[is_inside], frontier)
        counts[is_inside] = looks.max(axis=0) if frontier.goal is None else looks[sides, np.arange(len(sides))]
        return int(np.quantile(counts, 1.0 - self.config.share, method="lower"))

    def _move_to(self, spec: GridSpec) -> None:
        """Take another geometry of the same lattice; what lies outside is forgotten."""
        if spec == self._spec:
            return
        self._counts = np.stack([carried(side, self._spec, spec) for side in self._counts])
        self._last_s = np.stack([carried(side, self._spec, spec) for side in self._last_s])
        self._spec = spec


def _sides(points: NDArray[np.floating], frontier: Frontier) -> NDArray[np.int64]:
    """Return from which of the sides the goal of a frontier looks at points (N, 2); 0 for one without a goal, which is looked at from all of them."""
    if frontier.goal is None:
        return np.zeros(len(points), np.int64)
    return sides_of(frontier.goal[1] - points[:, 1], frontier.goal[0] - points[:, 0])
