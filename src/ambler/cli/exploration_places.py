"""Places for comparing strategies: floor plans from pictures, and the built-in worlds cut at the scanner's height.

The plans are pictures: 127 is solid, everything else is free, 203 marks the start (the public dungeon maps of `datasets.md`).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ambler.exploration.grid_world import GridWorld

SOLID, START = 127, 203
SCANNER_HEIGHT = 0.28


def plan_world(plan: Path, resolution: float, sensor_range: float) -> GridWorld:
    """Read a floor plan; raises BadInputError when it is no picture or has no start."""
    import cv2
    import numpy as np

    from ambler.core.errors import BadInputError
    from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, GridSpec
    from ambler.core.se2 import SE2
    from ambler.exploration.grid_world import GridWorld
    from ambler.planning.distance import distance_field

    pixels = cv2.imread(str(plan), cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise BadInputError(f"{plan}: not a picture")
    pixels = np.ascontiguousarray(pixels[::-1])
    ys, xs = np.nonzero(pixels == START)
    if len(ys) == 0:
        raise BadInputError(f"{plan}: no pixel of {START}, which marks the start")
    truth = np.where(pixels == SOLID, OCC_OCCUPIED, OCC_FREE).astype(np.int8)
    spec = GridSpec(resolution, pixels.shape[1], pixels.shape[0], 0.0, 0.0)
    start = SE2(*spec.center_of(int(ys.mean()), int(xs.mean())))
    return GridWorld(spec, truth, start, distance_field, sensor_range=sensor_range)


def built_in_world(name: str, sensor_range: float) -> GridWorld:
    """Cut a world of the simulator; raises BadInputError for an unknown name."""
    import numpy as np

    from ambler.core.grid import OCC_FREE, OCC_OCCUPIED
    from ambler.core.se2 import SE2
    from ambler.exploration.grid_world import GridWorld
    from ambler.planning.distance import distance_field
    from ambler.sim.truth import truth_grid
    from ambler.sim.world import load_world

    spec, grid = truth_grid(load_world(name), SCANNER_HEIGHT, 0.05)
    truth = np.where(grid == OCC_FREE, OCC_FREE, OCC_OCCUPIED).astype(np.int8)
    return GridWorld(spec, truth, SE2(), distance_field, sensor_range=sensor_range)
