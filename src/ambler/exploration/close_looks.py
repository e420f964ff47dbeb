"""Frontier cells that the robot looked at from near, in passing or at a goal, and that stayed: nothing can be seen behind them.

Such cells are left where the map disagrees with itself: a wall that two submaps place a cell apart, seen at a glancing angle or
through somebody who walks by, may vanish from their sum, and free cells then border on the inside of the wall. Driving there
again teaches nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.kernels.frontier import seen_frontier

I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CloseLookConfig:
    """A look at a cell counts between `nearest` and `farthest` (m) and inside `sector` (middle and half width, rad, in the base
    frame), where rays are dense; after `looks` maps made while it was in view a cell has been looked at."""

    looks: int = 3
    nearest: float = 0.0
    farthest: float = 2.0
    sector: tuple[float, float] = (0.0, math.pi)

    @classmethod
    def from_robot(cls, robot: RobotModel) -> CloseLookConfig:
        """Take what the scanners see; several of them, or a cloud, see all around."""
        mounts = [m for m in robot.sensors if m.kind in ("scan", "cloud")]
        nearest = min((m.range_min for m in mounts), default=0.0)
        if len(mounts) != 1 or mounts[0].kind == "cloud":
            return cls(nearest=nearest)
        low, high = mounts[0].azimuth
        middle = mounts[0].base_from_sensor.to_se2().yaw + 0.5 * (low + high)
        return cls(nearest=nearest, sector=(middle, 0.5 * (high - low)))


class CloseLooks:
    """Counts looks per cell of the map's lattice, whatever part of it the newest map covers."""

    def __init__(self, config: CloseLookConfig, free_below: int) -> None:
        self.config = config
        self._free_below = free_below
        self._counts: dict[int, int] = {}
        self._over: I64 = np.empty(0, np.int64)
        self._stamp_ns: int | None = None

    def add(self, occupancy: OccupancyGrid, cells: I64, map_from_base: SE2) -> None:
        """Count a look at those of the flat frontier cells of a map that the robot sees from near; once per map."""
        if occupancy.stamp_ns == self._stamp_ns or len(cells) == 0:
            return
        self._stamp_ns = occupancy.stamp_ns
        spec, c = occupancy.spec, self.config
        y = (map_from_base.y - spec.origin_y) / spec.resolution
        x = (map_from_base.x - spec.origin_x) / spec.resolution
        reach = (c.nearest / spec.resolution, c.farthest / spec.resolution)
        sector = (map_from_base.yaw + c.sector[0], c.sector[1])
        is_seen = np.empty(len(cells), np.bool_)
        seen_frontier(occupancy.data, self._free_below, cells, y, x, reach, sector, is_seen)
        over = []
        for key in _keys(spec, cells[is_seen]).tolist():
            self._counts[key] = self._counts.get(key, 0) + 1
            if self._counts[key] == c.looks:
                over.append(key)
        if over:
            self._over = np.union1d(self._over, np.array(over, np.int64))

    def are_over(self, spec: GridSpec, cells: I64) -> NDArray[np.bool_]:
        """Tell which flat cells of a grid have been looked at often enough."""
        return np.isin(_keys(spec, cells), self._over)


def _keys(spec: GridSpec, cells: I64) -> I64:
    """Return numbers of flat cells that do not depend on the grid's size and corner."""
    iy, ix = np.divmod(cells, spec.width)
    row = iy + round(spec.origin_y / spec.resolution)
    column = ix + round(spec.origin_x / spec.resolution)
    return np.asarray((row << 32) + column, np.int64)
