"""The inflation layer: costs that fall with the distance to the nearest lethal cell, after costmap_2d.

cost(d) = 254 at d = 0, 253 up to the inscribed radius (the robot's centre there means contact), then
252 exp(-scaling (d - inscribed)) up to the inflation radius. Distances are exact, between cell centres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_INSCRIBED, COST_LETHAL
from ambler.core.robot import RobotModel
from ambler.costmap.layer import Box
from ambler.kernels import distance_transform as kernels

U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class InflationConfig:
    """`radius` and `inscribed_radius` in metres, `scaling` in 1/m. None means: from the footprint. The automatic radius reaches
    half a metre beyond the circumscribed circle, so that the cost still falls in the middle of a doorway and paths keep to it."""

    radius: float | None = None
    inscribed_radius: float | None = None
    scaling: float = 3.0


LOCAL_INFLATION = InflationConfig(radius=0.01)


class Inflation:
    """Inflates whole grids, or a box of one after its source changed there."""

    def __init__(self, config: InflationConfig, robot: RobotModel, resolution: float) -> None:
        self.inscribed_radius = robot.inscribed_radius if config.inscribed_radius is None else config.inscribed_radius
        self.radius = robot.circumscribed_radius + 0.5 if config.radius is None else config.radius
        if not (self.radius >= 0.0 and self.inscribed_radius >= 0.0 and config.scaling >= 0.0):
            raise BadInputError(f"inflation: {config} holds a negative value")
        self.radius_cells = math.floor(self.radius / resolution + 1e-9)
        self.table = cost_table(self.radius_cells, resolution, self.inscribed_radius, config.scaling)

    def inflate(self, source: U8, out: U8, box: Box | None = None) -> Box:
        """Write the inflated `source` uint8 [iy, ix] into `out`; with `box` (y0, y1, x0, x1), half open, only what a change of the
        source inside that box can change. Returns the box that was written."""
        height, width = source.shape
        r = self.radius_cells
        y0, y1, x0, x1 = (0, height, 0, width) if box is None else box
        y0, y1, x0, x1 = max(0, y0 - r), min(height, y1 + r), max(0, x0 - r), min(width, x1 + r)
        if r == 0:
            out[y0:y1, x0:x1] = source[y0:y1, x0:x1]
        elif y1 > y0 and x1 > x0:
            kernels.inflate(source, y0, y1, x0, x1, r, self.table, out)
        return y0, y1, x0, x1


def cost_table(radius_cells: int, resolution: float, inscribed_radius: float, scaling: float) -> U8:
    """Return the cost by squared distance in cells, uint8 (radius_cells^2 + 2,); the last entry, 0, stands for all beyond."""
    d = np.sqrt(np.arange(radius_cells * radius_cells + 2)) * resolution
    table = np.floor((COST_INSCRIBED - 1) * np.exp(-scaling * np.maximum(0.0, d - inscribed_radius)))
    table[d <= inscribed_radius + 1e-9] = COST_INSCRIBED
    table[0] = COST_LETHAL
    table[-1] = 0
    return np.asarray(table, np.uint8)


def turning_cost(robot: RobotModel, config: InflationConfig) -> int:
    """Return the cost at the circumscribed radius: where it is not exceeded, the robot can turn on the spot."""
    inscribed = robot.inscribed_radius if config.inscribed_radius is None else config.inscribed_radius
    beyond = max(0.0, robot.circumscribed_radius - inscribed)
    return math.floor((COST_INSCRIBED - 1) * math.exp(-config.scaling * beyond))
