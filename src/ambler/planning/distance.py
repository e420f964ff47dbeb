"""Path distances from one place to everywhere, for choosing among many targets with one sweep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import StartOutsideMapError
from ambler.core.grid import COST_INSCRIBED, GridSpec
from ambler.core.se2 import SE2
from ambler.kernels import graph_search as kernels
from ambler.planning.escape import find_escape


def distance_field(
    costs: NDArray[np.uint8], spec: GridSpec, start: SE2, *, escape_radius: float = 0.6, way_out: float = 0.0
) -> NDArray[np.float32]:
    """Return the shortest path's length from `start` to every cell's centre, float32 [iy, ix] metres, inf where none leads.

    Inscribed, lethal and unknown cells are forbidden; a start on one, or in a pocket between such, begins at the nearest allowed cell, as the planner does.
    Raises StartOutsideMapError or StartOccupiedError.
    """
    if not spec.contains(start.x, start.y):
        raise StartOutsideMapError(f"the robot at ({start.x:.2f}, {start.y:.2f}) is outside the map")
    iy, ix = spec.cell_of(start.x, start.y)
    costs = np.ascontiguousarray(costs)
    radius, reach = escape_radius / spec.resolution, way_out / spec.resolution
    iy, ix = find_escape(costs, costs < COST_INSCRIBED, (iy, ix), radius, reach)[-1]
    out = np.empty(costs.shape, np.float32)
    kernels.distance_field(costs, iy, ix, COST_INSCRIBED, spec.resolution, out)
    return out
