"""How fast a robot may drive onto ground that nobody has seen: a map of ground assumes it where the sensor cannot see it, as around the start of a level LiDAR, and a kerb may lie there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_ASSUMED
from ambler.core.messages import OccupancyGrid

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class UnseenGroundConfig:
    """At most `speed` (m/s) where ground is only assumed within `ahead` metres along the path."""

    speed: float = 0.4
    ahead: float = 1.2

    def __post_init__(self) -> None:
        if min(self.speed, self.ahead) <= 0.0:
            raise BadInputError("unseen ground: speed and ahead must be positive")


class UnseenGround:
    """Asks a map of ground what lies ahead. Before the first map nothing is known to be assumed."""

    def __init__(self, config: UnseenGroundConfig) -> None:
        self.config = config
        self._map: OccupancyGrid | None = None

    def set_map(self, ground: OccupancyGrid) -> None:
        """Take a map of ground in place of the last one."""
        self._map = ground

    def speed_most(self, path: F64, left: float) -> float:
        """Return how fast (m/s) a robot may follow a path (N, >= 2) of the map frame of which `left` metres are left; inf where its next metres were seen."""
        if self._map is None or len(path) == 0:
            return math.inf
        lengths = np.concatenate((np.hypot(*np.diff(path[:, :2], axis=0).T), [0.0]))
        to_end = np.cumsum(lengths[::-1])[::-1]
        next_metres = path[(to_end <= left + 1e-6) & (to_end >= left - self.config.ahead), :2]
        cells, spec = self._map.spec.cells_of(next_metres), self._map.spec
        cells = cells[(cells >= 0).all(axis=1) & (cells < spec.shape).all(axis=1)]
        is_unseen = bool((self._map.data[cells[:, 0], cells[:, 1]] == OCC_ASSUMED).any())
        return self.config.speed if is_unseen else math.inf
