"""What the robot looked at from near, in passing or at a goal: behind such a surface nothing more can be seen.

Where two submaps place a wall a cell apart, rays along it and people who walk by take it out of their sum again; free cells
then border on the inside of the wall and look like frontiers. Driving to them teaches nothing. That holds from the side from which was looked: who has seen the wall below a ramp has not seen
what lies at its top.
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
from ambler.exploration.frontier_map import FrontierGroups
from ambler.exploration.lattice import carried
from ambler.exploration.side_counts import SideCounts
from ambler.exploration.sides import SIDES, sides_of
from ambler.kernels.frontier import has_any_around, look_around, towards_free

I64 = NDArray[np.int64]
ALL_SIDES = (1 << SIDES) - 1


@dataclass(frozen=True, slots=True)
class CloseLookConfig:
    """A look reaches from `nearest` to `farthest` (m) inside `sector` (middle and half width, rad, in the base frame), where rays are
    dense. It ends at the first cell that is not free, occupied or unknown. A cell at which `looks` more of them ended than passed, each
    on a new map and `most` at most, is a surface to the side that they came from and `aslant` sides beside it; cells within `around` cells of one have been looked at if their free ground lies
    on such a side."""

    looks: int = 3
    most: int = 6
    nearest: float = 0.0
    farthest: float = 2.0
    sector: tuple[float, float] = (0.0, math.pi)
    around: int = 2
    aslant: int = 2
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
    """Counts how often looks from each side ended at each cell; follows the map's geometry as it grows."""

    def __init__(self, config: CloseLookConfig, free_below: int) -> None:
        self.config = config
        self._free_below = free_below
        self._spec: GridSpec | None = None
        self._counts = SideCounts()
        self._corner = (0, 0)  # of the map, in cells of the counts
        self._surfaces: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
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
        at_y, at_x = self._corner[0] + y0, self._corner[1] + x0
        counts = self._counts.read(at_y, at_x, *around.shape)
        counts -= np.minimum(passed, counts)
        iy, ix = np.divmod(np.unique(ends[ends >= 0]), x1 - x0)
        sides = sides_of(y - y0 - iy - 0.5, x - x0 - ix - 0.5)
        for turn in range(-c.aslant, c.aslant + 1):
            at = ((sides + turn) % SIDES, iy, ix)
            counts[at] = np.minimum(counts[at] + 1, c.most)
        self._counts.write(at_y, at_x, counts)
        self._surfaces[y0:y1, x0:x1] = np.packbits(counts >= c.looks, axis=0, bitorder="little")[0]

    def surfaces(self, spec: GridSpec) -> NDArray[np.uint8]:
        """Tell which cells [iy, ix] of a grid are surfaces, whatever the map says of them: bit k for those who look from side k."""
        self._move_to(spec)
        return self._surfaces

    def are_over(self, occupancy: OccupancyGrid, cells: I64) -> NDArray[np.bool_]:
        """Tell which flat frontier cells of a map lie where the robot has looked often enough from the side of their free ground; of cells that are as open to all sides, from any."""
        self._move_to(occupancy.spec)
        sides, is_over = _bits(*self._towards_free(occupancy, cells)), np.empty(len(cells), np.bool_)
        has_any_around(self._surfaces, cells, self.config.around, sides, is_over)
        return is_over

    def free_sides(self, occupancy: OccupancyGrid, groups: FrontierGroups) -> NDArray[np.uint8]:
        """Return the side on which the free ground of each group of frontier cells lies, a bit of those of `surfaces`; all bits for one as open to all sides."""
        self._move_to(occupancy.spec)
        dy, dx = self._towards_free(occupancy, groups.cells)
        return _bits(np.add.reduceat(dy, groups.starts[:-1]), np.add.reduceat(dx, groups.starts[:-1]))

    def _towards_free(self, occupancy: OccupancyGrid, cells: I64) -> tuple[I64, I64]:
        """Return offsets (dy, dx) that lead from what is unknown around flat cells to what is free there."""
        dy, dx = np.empty(len(cells), np.int64), np.empty(len(cells), np.int64)
        towards_free(occupancy.data, cells, self.config.around, self._free_below, dy, dx)
        return dy, dx

    def _move_to(self, spec: GridSpec) -> None:
        """Take another geometry of the same lattice; surfaces outside are forgotten until they are looked at again."""
        old = self._spec
        if spec == old:
            return
        if old is None or old.resolution != spec.resolution:
            self._counts, self._corner = SideCounts(), (0, 0)
        else:
            dy, dx = old.offset_in(spec)
            self._corner = self._corner[0] - dy, self._corner[1] - dx
        self._surfaces, self._spec = carried(self._surfaces, old, spec), spec


def _bits(dy: I64, dx: I64) -> NDArray[np.uint8]:
    """Return the bit of the side on which each offset leads, all bits where it leads nowhere."""
    return np.where((dy == 0) & (dx == 0), ALL_SIDES, 1 << sides_of(dy, dx)).astype(np.uint8)
