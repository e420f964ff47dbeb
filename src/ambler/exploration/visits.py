"""How often the robot has looked at a place: frontiers there may have another shape each time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import Frontier, OccupancyGrid
from ambler.exploration.lattice import carried


@dataclass(frozen=True, slots=True)
class VisitsConfig:
    """A look counts for what lies within `around` (m) of the frontier that was looked at, once in `apart` seconds. A frontier has been
    looked at as often as the place where `share` of its cells lie."""

    around: float = 0.5
    apart: float = 10.0
    share: float = 0.5


class Visits:
    """Counts looks cell by cell; follows the map's geometry as it grows."""

    def __init__(self, config: VisitsConfig) -> None:
        self.config = config
        self._spec: GridSpec | None = None
        self._counts: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
        self._last_s: NDArray[np.float32] = np.zeros((0, 0), np.float32)

    def add(self, frontier: Frontier, occupancy: OccupancyGrid) -> None:
        """Take down that the robot looked at a frontier, at the time of this map."""
        self._move_to(occupancy.spec)
        reach = round(self.config.around / occupancy.spec.resolution)
        is_beside = np.zeros(self._counts.shape, np.bool_)
        for iy, ix in occupancy.spec.cells_of(frontier.cells).tolist():
            is_beside[max(0, iy - reach) : max(0, iy + reach + 1), max(0, ix - reach) : max(0, ix + reach + 1)] = True
        now = np.float32(occupancy.stamp_ns * 1e-9)
        is_new = is_beside & ((self._counts == 0) | (now - self._last_s >= self.config.apart))
        self._counts[is_new & (self._counts < 255)] += 1
        self._last_s[is_new] = now

    def at(self, frontier: Frontier, spec: GridSpec) -> int:
        """Return how often the place of a frontier has been looked at."""
        self._move_to(spec)
        iy, ix = spec.cells_of(frontier.cells).T
        is_inside = (iy >= 0) & (iy < spec.height) & (ix >= 0) & (ix < spec.width)
        counts = np.zeros(len(iy), np.uint8)
        counts[is_inside] = self._counts[iy[is_inside], ix[is_inside]]
        return int(np.quantile(counts, 1.0 - self.config.share, method="lower"))

    def _move_to(self, spec: GridSpec) -> None:
        """Take another geometry of the same lattice; what lies outside is forgotten."""
        if spec == self._spec:
            return
        self._counts = carried(self._counts, self._spec, spec)
        self._last_s, self._spec = carried(self._last_s, self._spec, spec), spec
