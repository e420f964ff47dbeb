"""Frontier search on synthetic maps, whole and incremental, and one whole survey."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.core.messages import CostGrid, OccupancyGrid
from ambler.core.se2 import SE2
from ambler.exploration.frontier_map import Box, FrontierMap
from ambler.exploration.strategies import STRATEGIES, strategy_named
from ambler.exploration.survey import FrontierSurvey, SurveyConfig
from ambler.planning.distance import distance_field
from ambler.studies.timing import elapsed_ms, median_ms

BAR_FULL_1000_MS = 16.0
BAR_INCREMENTAL_4000_MS = 5.0
CHANGED_SIDE_CELLS = 224


def measure(runs: int, seed: int) -> dict[str, Any]:
    """Return medians of `runs` searches of each kind, milliseconds, and how much there was to find."""
    rng = np.random.default_rng(seed)
    fields: dict[str, Any] = {}
    for cells in (1000, 4000):
        occupancy = explored_map(cells, rng)
        spec = GridSpec(0.05, cells, cells, 0.0, 0.0)
        frontiers = FrontierMap()
        groups = frontiers.update(spec, occupancy)
        fields[f"free_cells_{cells}"] = int(np.count_nonzero(occupancy == 0))
        fields[f"frontier_cells_{cells}"] = len(groups.cells)
        fields[f"frontiers_{cells}"] = len(groups)
        fields[f"search_{cells}_ms"] = median_ms(partial(frontiers.update, spec, occupancy), runs, uncounted_runs=1)
        corners = rng.integers(0, cells - CHANGED_SIDE_CELLS, (runs + 1, 2))
        times = [_after_change_ms(frontiers, spec, occupancy, int(iy), int(ix)) for iy, ix in corners]
        fields[f"incremental_{cells}_ms"] = float(np.median(times[1:]))
    fields["survey_1000_ms"] = _survey_ms(runs, rng)
    return fields


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether the whole search and the search after a change are quick enough."""
    return bool(
        fields["search_1000_ms"] <= BAR_FULL_1000_MS and fields["incremental_4000_ms"] <= BAR_INCREMENTAL_4000_MS
    )


def explored_map(cells: int, rng: np.random.Generator) -> NDArray[np.int8]:
    """Draw overlapping explored rooms with walls, int8 (cells, cells): about a fifth of the map is known."""
    out = np.full((cells, cells), -1, np.int8)
    rooms = round(cells * cells / 25_000)
    height, width = rng.integers(30, 130, rooms), rng.integers(30, 130, rooms)
    y, x = rng.integers(1, cells - 131, rooms), rng.integers(1, cells - 131, rooms)
    for k in range(rooms):
        box = np.s_[y[k] : y[k] + height[k], x[k] : x[k] + width[k]]
        out[box] = np.where(out[box] < 0, 100, out[box])
        inner = np.s_[y[k] + 1 : y[k] + height[k] - 1, x[k] + 1 : x[k] + width[k] - 1]
        out[inner] = 0
        if k % 5:
            out[y[k] + height[k] // 4 : y[k] + height[k] // 2, x[k] + width[k] - 1] = -1
    return out


def _after_change_ms(frontiers: FrontierMap, spec: GridSpec, occupancy: NDArray[np.int8], iy: int, ix: int) -> float:
    """Turn a box of the map upside down and time the search that is told of it."""
    box = Box(iy, ix, iy + CHANGED_SIDE_CELLS, ix + CHANGED_SIDE_CELLS)
    cells = np.s_[box.iy0 : box.iy1, box.ix0 : box.ix1]
    occupancy[cells] = np.flipud(occupancy[cells]).copy()
    return elapsed_ms(partial(frontiers.update, spec, occupancy, box))


def _survey_ms(runs: int, rng: np.random.Generator) -> float:
    """Time everything that one look takes: search, distance field, goals, gains, the order of the default strategy."""
    occupancy = explored_map(1000, rng)
    spec = GridSpec(0.05, 1000, 1000, 0.0, 0.0)
    costs = np.where(occupancy < 0, COST_UNKNOWN, np.where(occupancy > 0, COST_LETHAL, 0)).astype(np.uint8)
    iy, ix = np.argwhere(occupancy == 0)[len(occupancy) // 2]
    pose = SE2(*spec.center_of(int(iy), int(ix)))
    survey = FrontierSurvey(SurveyConfig(), distance_field)
    strategy = strategy_named(STRATEGIES[0], distance_field)

    def look() -> None:
        survey.forget_map()
        result = survey.update(OccupancyGrid(0, "map", spec, occupancy), CostGrid(0, "map", spec, costs), pose)
        strategy.costs(result, pose)

    return median_ms(look, runs, uncounted_runs=1)
