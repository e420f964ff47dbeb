"""What the robot looked at from near, in passing or at a goal: behind such a surface nothing more can be seen.

Where two submaps place a wall a cell apart, rays along it and people who walk by take it out of their sum again; free cells
then border on the inside of the wall and look like frontiers. Driving to them teaches nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid
from ambler.core.robot import RobotModel, SensorKind
from ambler.core.se2 import SE2
from ambler.exploration.lattice import carried
from ambler.kernels.frontier import look_around

I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CloseLookConfig:
    """A look reaches from `nearest` to `farthest` (m) inside `sector` (middle and half width, rad, in the base frame), where rays are
    dense. It ends at the first cell that is not free, occupied or unknown. A cell at which `looks` more of them ended than passed, each
    on a new map and `most` at most, is a surface; all cells within `around` cells of one have been looked at."""

    looks: int = 3
    most: int = 6
    nearest: float = 0.0
    farthest: float = 2.0
    sector: tuple[float, float] = (0.0, math.pi)
    around: int = 2
    rays: int = 720

    @classmethod
    def from_robot(cls, robot: RobotModel) -> CloseLookConfig:
        """Take what the scanners see; several of them, or a cloud, see all around."""
        mounts = [m for m in robot.sensors if m.kind in (SensorKind.SCAN, SensorKind.CLOUD)]
        nearest = min((m.range_min for m in mounts), default=0.0)
        if len(mounts) != 1 or mounts[0].kind is SensorKind.CLOUD:
            return cls(nearest=nearest)
        low, high = mounts[0].azimuth
        middle = mounts[0].base_from_sensor.to_se2().yaw + 0.5 * (low + high)
        return cls(nearest=nearest, sector=(middle, 0.5 * (high - low)))


class CloseLooks:
    """Counts how often looks ended at each cell; follows the map's geometry as it grows."""

    def __init__(self, config: CloseLookConfig, free_below: int) -> None:
        self.config = config
        self._free_below = free_below
        self._spec: GridSpec | None = None
        self._counts: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
        self._stamp_ns: int | None = None

    def add(self, occupancy: OccupancyGrid, map_from_base: SE2) -> None:
        """Look around in a map from the robot's place; once per map."""
        if occupancy.stamp_ns == self._stamp_ns:
            return
        self._stamp_ns = occupancy.stamp_ns
        self._move_to(occupancy.spec)
        spec, c = occupancy.spec, self.config
        y = (map_from_base.y - spec.origin_y) / spec.resolution
        x = (map_from_base.x - spec.origin_x) / spec.resolution
        reach = (c.nearest / spec.resolution, c.farthest / spec.resolution)
        border = math.ceil(reach[1]) + 2  # only what a look can reach is touched, however large the map is
        y0, x0 = max(0, math.floor(y) - border), max(0, math.floor(x) - border)
        y1, x1 = min(spec.height, math.floor(y) + border), min(spec.width, math.floor(x) + border)
        if y1 <= y0 or x1 <= x0:
            return
        around = np.ascontiguousarray(occupancy.data[y0:y1, x0:x1])
        ends, passed = np.empty(c.rays, np.int64), np.zeros(around.shape, np.uint8)
        sector = (map_from_base.yaw + c.sector[0], c.sector[1])
        look_around(around, self._free_below, y - y0, x - x0, sector, reach, ends, passed)
        counts = self._counts[y0:y1, x0:x1]
        counts -= np.minimum(passed, counts)
        iy, ix = np.divmod(np.unique(ends[ends >= 0]), x1 - x0)
        counts[iy, ix] = np.minimum(counts[iy, ix] + 1, c.most)

    def surfaces(self, spec: GridSpec) -> NDArray[np.bool_]:
        """Tell which cells [iy, ix] of a grid are surfaces, whatever the map says of them."""
        self._move_to(spec)
        return self._counts >= self.config.looks

    def are_over(self, spec: GridSpec, cells: I64) -> NDArray[np.bool_]:
        """Tell which flat cells of a grid lie where the robot has looked often enough."""
        self._move_to(spec)
        reach, n = self.config.around, self._counts.shape
        iy, ix = np.divmod(cells, spec.width)
        is_over = np.zeros(len(cells), np.bool_)
        for dy in range(-reach, reach + 1):
            rows = np.clip(iy + dy, 0, n[0] - 1)
            for dx in range(-reach, reach + 1):
                is_over |= self._counts[rows, np.clip(ix + dx, 0, n[1] - 1)] >= self.config.looks
        return is_over

    def _move_to(self, spec: GridSpec) -> None:
        """Take another geometry of the same lattice; what lies outside is forgotten."""
        if spec == self._spec:
            return
        self._counts, self._spec = carried(self._counts, self._spec, spec), spec
