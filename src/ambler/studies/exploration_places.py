"""Places for comparing strategies: floor plans from pictures, and the built-in worlds cut at the scanner's height."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED
from ambler.core.se2 import SE2
from ambler.exploration.grid_world import GridWorld
from ambler.planning.distance import distance_field
from ambler.sim.floorplan import START_GREY, read_picture
from ambler.sim.truth import truth_grid
from ambler.sim.world_file import load_world

SCANNER_HEIGHT = 0.28

Place = tuple[str, Callable[[], GridWorld]]
"""A label, and what makes the place anew."""


def plans_in(folder: Path, every: int, resolution: float, sensor_range: float) -> list[Place]:
    """Return each `every`-th floor plan in or below a folder; raises BadInputError without any."""
    plans = sorted(folder.rglob("*.png"))[::every]
    if not plans:
        raise BadInputError(f"no *.png in {folder}")
    return [(f"{p.parent.name}/{p.stem}", partial(plan_world, p, resolution, sensor_range)) for p in plans]


def worlds_named(names: str, sensor_range: float) -> list[Place]:
    """Return the built-in worlds of names that are separated by commas."""
    return [(name, partial(built_in_world, name, sensor_range)) for name in names.split(",") if name]


def plan_world(plan: Path, resolution: float, sensor_range: float) -> GridWorld:
    """Read a floor plan; raises BadInputError when it is no picture or has no start."""
    spec, occupancy, start = read_picture(plan, resolution)
    if start is None:
        raise BadInputError(f"{plan}: no pixel of {START_GREY}, which marks the start")
    truth = np.where(occupancy == OCC_FREE, OCC_FREE, OCC_OCCUPIED).astype(np.int8)
    return GridWorld(spec, truth, start, distance_field, sensor_range=sensor_range)


def built_in_world(name: str, sensor_range: float) -> GridWorld:
    """Cut a world of the simulator; raises BadInputError for an unknown name."""
    spec, grid = truth_grid(load_world(name).from_start(), SCANNER_HEIGHT, 0.05)
    truth = np.where(grid == OCC_FREE, OCC_FREE, OCC_OCCUPIED).astype(np.int8)
    return GridWorld(spec, truth, SE2(), distance_field, sensor_range=sensor_range)
