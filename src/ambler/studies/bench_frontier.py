"""`ambler bench frontier`: frontier search on synthetic maps, whole and incremental, and one whole survey."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

BAR_FULL_1000_MS = 16.0
BAR_INCREMENTAL_4000_MS = 5.0
CHANGED_SIDE_CELLS = 224


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("frontier", help="frontier search: whole map, changed box, whole survey")
    parser.add_argument("--runs", type=int, default=21)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def explored_map(cells: int, rng: np.random.Generator) -> NDArray[np.int8]:
    """Draw overlapping explored rooms with walls, int8 (cells, cells): about a fifth of the map is known."""
    import numpy as np

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


def run(args: argparse.Namespace) -> int:
    """Measure medians; exit 1 when a bar is missed."""
    import numpy as np

    from ambler.core.grid import GridSpec
    from ambler.evaluation.results import write_results
    from ambler.exploration.frontier_map import Box, FrontierMap

    begin = time.perf_counter()
    rng = np.random.default_rng(args.seed)
    fields: dict[str, Any] = {}
    for cells in (1000, 4000):
        occupancy = explored_map(cells, rng)
        spec = GridSpec(0.05, cells, cells, 0.0, 0.0)
        frontiers = FrontierMap()
        groups = frontiers.update(spec, occupancy)
        fields[f"free_cells_{cells}"] = int(np.count_nonzero(occupancy == 0))
        fields[f"frontier_cells_{cells}"] = len(groups.cells)
        fields[f"frontiers_{cells}"] = len(groups)
        fields[f"search_{cells}_ms"] = median_ms(args.runs, partial(frontiers.update, spec, occupancy))
        corners = iter(rng.integers(0, cells - CHANGED_SIDE_CELLS, (args.runs + 1, 2)))

        def change(f: FrontierMap = frontiers, s: GridSpec = spec, o: Any = occupancy, c: Any = corners) -> float:
            iy, ix = (int(v) for v in next(c))
            box = Box(iy, ix, iy + CHANGED_SIDE_CELLS, ix + CHANGED_SIDE_CELLS)
            o[box.iy0 : box.iy1, box.ix0 : box.ix1] = np.flipud(o[box.iy0 : box.iy1, box.ix0 : box.ix1]).copy()
            started = time.perf_counter()
            f.update(s, o, box)
            return 1e3 * (time.perf_counter() - started)

        fields[f"incremental_{cells}_ms"] = float(np.median([change() for _ in range(args.runs + 1)][1:]))
    fields["survey_1000_ms"] = _survey_ms(args.runs, rng)
    for key, value in fields.items():
        print(f"{key:24} {value:.3f}" if isinstance(value, float) else f"{key:24} {value}")
    if args.json is not None:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    is_good = fields["search_1000_ms"] <= BAR_FULL_1000_MS and fields["incremental_4000_ms"] <= BAR_INCREMENTAL_4000_MS
    return 0 if is_good else 1


def median_ms(runs: int, work: Callable[[], object]) -> float:
    """Return the median time of some runs in milliseconds, after one that does not count."""
    import numpy as np

    times = []
    for _ in range(runs + 1):
        started = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - started))
    return float(np.median(times[1:]))


def _survey_ms(runs: int, rng: np.random.Generator) -> float:
    """Time everything that one look takes: search, distance field, goals, gains, the order of the default strategy."""
    import numpy as np

    from ambler.core.grid import COST_LETHAL, COST_UNKNOWN, GridSpec
    from ambler.core.messages import CostGrid, OccupancyGrid
    from ambler.core.se2 import SE2
    from ambler.exploration.strategies import STRATEGIES, strategy_named
    from ambler.exploration.survey import FrontierSurvey, SurveyConfig
    from ambler.planning.distance import distance_field

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

    return median_ms(runs, look)
