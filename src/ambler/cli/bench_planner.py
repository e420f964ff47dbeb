"""`ambler bench planner`: the global planner on four grids at two sizes, its costs checked against SciPy's Dijkstra, its times (of
the processor, one thread) beside those of SciPy in the same run, and held against bars."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ambler.core.protocols import PlanResult

# How long a plan may take on a 2-core x86-64, milliseconds
BAR_MS = {
    1000: {"open": 32.6, "clutter": 36.6, "rooms": 42.6, "serpentine": 25.0},
    4000: {"open": 818.0, "clutter": 858.0, "rooms": 898.0, "serpentine": 448.0},
}
RESOLUTION = 0.05


def add_parser(subparsers: Any) -> None:
    """Add the sub-verb."""
    parser = subparsers.add_parser("planner", help="global planner: optimality and time beside SciPy's Dijkstra")
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 4000])
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--oracle-up-to",
        type=int,
        default=4000,
        help="largest size whose costs SciPy checks (4000: 4 GB, a minute each)",
    )
    parser.add_argument("--json", type=Path)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Plan on every grid; exit 1 when a cost differs from the oracle's or a median exceeds its bar."""
    import numpy as np

    from ambler.cli.planner_worlds import WORLDS, inflated, make_world
    from ambler.evaluation.results import write_results

    begin = time.perf_counter()
    fields: dict[str, Any] = {"ratios_are_of": "median time to that of the peer in the same run"}
    is_good = True
    for n in args.sizes:
        for name in WORLDS:
            costs = inflated(make_world(name, n, np.random.default_rng(args.seed)))
            median, result = _measure(costs, n, args.runs)
            key = f"{name}_{n}"
            fields |= {f"{key}_ms": median, f"{key}_cost_m": result.cost, f"{key}_points": len(result.path)}
            text = f"{key}: {median:.1f} ms, cost {result.cost:.2f} m"
            if n in BAR_MS:
                is_good &= median <= BAR_MS[n][name]
                text += f" (bar: {BAR_MS[n][name]} ms)"
            if n <= args.oracle_up_to:
                peer_ms, difference, missed = _compare(costs, n, result)
                fields |= {f"{key}_cost_difference": difference, f"{key}_goals_missed": missed}
                fields |= {f"peer_scipy_{key}_ms": peer_ms, f"ratio_vs_scipy_{key}": median / peer_ms}
                is_good &= difference == 0.0 and missed == 0
                text += f", SciPy {peer_ms:.0f} ms (graph given), cost difference {difference}, reachable cells missed {missed}"
            print(text, flush=True)
    if args.json:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0 if is_good else 1


def _measure(costs: NDArray[np.uint8], n: int, runs: int) -> tuple[float, PlanResult]:
    """Return the median CPU time of whole plans (weights, search, path, shortcuts; one thread) in ms, and the last result."""
    import statistics

    from ambler.cli.planner_worlds import MARGIN
    from ambler.core.grid import GridSpec
    from ambler.core.se2 import SE2
    from ambler.planning.grid_planner import GridPlanner

    spec = GridSpec(RESOLUTION, n, n, 0.0, 0.0)
    planner = GridPlanner()
    start, goal = (SE2(*spec.center_of(at, at)) for at in (MARGIN, n - MARGIN - 1))
    result = planner.plan(costs, spec, start, goal)
    times = []
    for _ in range(runs):
        begin = time.process_time()
        result = planner.plan(costs, spec, start, goal)
        times.append(1e3 * (time.process_time() - begin))
    return statistics.median(times), result


def _compare(costs: NDArray[np.uint8], n: int, result: PlanResult) -> tuple[float, float, int]:
    """Return SciPy's time in ms, the difference of the goal's cost in the integers of the search, and how many cells that
    SciPy reaches a full sweep of ours does not."""
    import numpy as np

    from ambler.cli.planner_worlds import MARGIN
    from ambler.kernels import graph_search as kernels
    from ambler.planning.grid_planner import INT32_LIMIT, PlannerConfig, weight_table
    from ambler.planning.oracle import grid_graph, sweep

    config = PlannerConfig()
    table = weight_table(config)
    graph = grid_graph(table[costs])
    begin = time.process_time()
    theirs = sweep(graph, MARGIN * n + MARGIN).reshape(n, n)
    peer_ms = 1e3 * (time.process_time() - begin)
    at = n - MARGIN - 1
    ours = round(result.cost / RESOLUTION * 2 * kernels.STRAIGHT * config.neutral)
    weights, state = np.zeros((n + 2, n + 2), np.uint16), np.zeros((n + 2, n + 2), np.uint8)
    cost = np.full((n + 2, n + 2), INT32_LIMIT, np.int32)
    kernels.weigh(costs, table, weights)
    kernels.search(weights, MARGIN + 1, MARGIN + 1, -1, -1, config.neutral, int(table.max()), cost, state)
    swept = cost[1:-1, 1:-1]
    missed = int((np.isfinite(theirs) & (swept == INT32_LIMIT)).sum())
    is_reached = np.isfinite(theirs)
    worst = float(np.abs(swept[is_reached] - theirs[is_reached]).max())
    return peer_ms, max(worst, abs(float(ours - theirs[at, at]))), missed
