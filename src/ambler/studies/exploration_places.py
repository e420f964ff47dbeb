"""Places for comparing strategies: floor plans from pictures, and the built-in worlds cut at the scanner's height."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ambler.exploration.grid_world import GridWorld

SCANNER_HEIGHT = 0.28


def plan_world(plan: Path, resolution: float, sensor_range: float) -> GridWorld:
    """Read a floor plan; raises BadInputError when it is no picture or has no start."""
    import numpy as np

    from ambler.core.errors import BadInputError
    from ambler.core.grid import OCC_FREE, OCC_OCCUPIED
    from ambler.exploration.grid_world import GridWorld
    from ambler.planning.distance import distance_field
    from ambler.sim.floorplan import START_GREY, read_picture

    spec, solid, start = read_picture(plan, resolution)
    if start is None:
        raise BadInputError(f"{plan}: no pixel of {START_GREY}, which marks the start")
    truth = np.where(solid, OCC_OCCUPIED, OCC_FREE).astype(np.int8)
    return GridWorld(spec, truth, start, distance_field, sensor_range=sensor_range)


def built_in_world(name: str, sensor_range: float) -> GridWorld:
    """Cut a world of the simulator; raises BadInputError for an unknown name."""
    import numpy as np

    from ambler.core.grid import OCC_FREE, OCC_OCCUPIED
    from ambler.core.se2 import SE2
    from ambler.exploration.grid_world import GridWorld
    from ambler.planning.distance import distance_field
    from ambler.sim.truth import truth_grid
    from ambler.sim.world_file import load_world

    spec, grid = truth_grid(load_world(name).from_start(), SCANNER_HEIGHT, 0.05)
    truth = np.where(grid == OCC_FREE, OCC_FREE, OCC_OCCUPIED).astype(np.int8)
    return GridWorld(spec, truth, SE2(), distance_field, sensor_range=sensor_range)
