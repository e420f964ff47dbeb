"""Path distances from one place to everywhere: the field that all frontiers of a survey share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_INSCRIBED, GridSpec
from ambler.core.se2 import SE2
from ambler.kernels.graph_search import distance_field


def path_distances(costs: NDArray[np.uint8], spec: GridSpec, map_from_base: SE2) -> NDArray[np.float32]:
    """Return the length of the shortest path from a pose to every cell, float32 [iy, ix] in metres.

    Cells of inscribed, lethal or unknown cost are inf, except those through which a robot that stands on one may leave.
    From outside the grid all is inf.
    """
    out = np.empty(spec.shape, np.float32)
    iy, ix = spec.cell_of(map_from_base.x, map_from_base.y)
    if spec.contains_cell(iy, ix):
        distance_field(costs, iy, ix, COST_INSCRIBED, spec.resolution, out)
    else:
        out.fill(np.inf)
    return out
