"""The global planner on four grids at any size: its search checked against SciPy's Dijkstra, its times (of the processor, one thread)
beside those of SciPy in the same run; and the costs of its paths beside those down the gradient of a full potential, on drawn grids."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.protocols import PlanResult
from ambler.core.se2 import SE2
from ambler.kernels import graph_search as kernels
from ambler.kernels.any_angle import path_cost
from ambler.planning.grid_planner import INT32_LIMIT, GridPlanner, PlannerConfig, weight_table
from ambler.planning.oracle import gradient_path, grid_graph, sweep
from ambler.studies.planner_worlds import MARGIN, WORLDS, inflated, make_world
from ambler.studies.timing import median_ms

# Milliseconds per plan that navfn, Dijkstra as ROS 1 runs it, took on another day (docs/planning.md): bars, no peers
BARS_MS = {
    1000: {"open": 32.6, "clutter": 36.6, "rooms": 42.6, "serpentine": 25.0},
    4000: {"open": 818.0, "clutter": 858.0, "rooms": 898.0, "serpentine": 448.0},
}
RESOLUTION = 0.05
GRADIENT_WORLDS = ("open", "clutter", "rooms")
GRADIENT_SIZES = (200, 400, 1000)
HIGHEST_END = 200  # cost of a drawn start or goal, at most


def measure(
    sizes: Sequence[int], runs: int, seed: int, oracle_up_to: int, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Plan on every grid, up to one size also with SciPy; tells a line of each."""
    fields: dict[str, Any] = {"ratios_are_of": "median time to that of the peer"}
    for n in sizes:
        for name in WORLDS:
            costs = inflated(make_world(name, n, np.random.default_rng(seed)))
            median, result = _plan(costs, n, runs)
            key = f"{name}_{n}"
            fields |= {f"{key}_ms": median, f"{key}_cost_m": result.cost, f"{key}_points": len(result.path)}
            text = f"{key}: {median:.1f} ms, cost {result.cost:.2f} m"
            if n <= oracle_up_to:
                peer_ms, difference, missed = _compare(costs, n)
                fields |= {f"{key}_cost_difference": difference, f"{key}_goals_missed": missed}
                fields |= {f"peer_scipy_{key}_ms": peer_ms, f"ratio_vs_scipy_{key}": median / peer_ms}
                text += f", SciPy {peer_ms:.0f} ms (graph given), cost difference {difference}, reachable cells missed {missed}"
            tell(text)
    return fields


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether every checked cost is the oracle's, and every size that has a bar is planned in time."""
    is_right = all(v == 0 for name, v in fields.items() if name.endswith(("_cost_difference", "_goals_missed")))
    bars = {f"{world}_{n}_ms": bar for n, of_worlds in BARS_MS.items() for world, bar in of_worlds.items()}
    is_cheap = all(v <= 1.0 for name, v in fields.items() if name.endswith("_ratio_vs_gradient_mean"))
    return is_right and is_cheap and all(fields[name] <= bar for name, bar in bars.items() if name in fields)


def compare_with_gradient(paths: int, seed: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Plan between drawn places of drawn grids, about `paths` a world, and down the gradient of the full potential; tells a line of
    each world: costs by one measure, the integral of the cell weights along the final polyline."""
    fields: dict[str, Any] = {}
    for name in GRADIENT_WORLDS if paths else ():
        ratios = np.array([r for k in range(paths // 4) for r in _gradient_ratios(name, (seed, k))])
        dearer = ratios[ratios > 1.0 + 1e-6]
        fields |= {
            f"{name}_paths": len(ratios),
            f"{name}_cost_ratio_vs_gradient_median": float(np.median(ratios)),
            f"{name}_cost_ratio_vs_gradient_mean": float(ratios.mean()),
            f"{name}_cost_ratio_vs_gradient_max": float(ratios.max()),
            f"{name}_dearer_paths": len(dearer),
        }
        tell(
            f"{name}: {len(ratios)} drawn paths, cost against the gradient's: median {np.median(ratios):.4f},"
            f" mean {ratios.mean():.4f}, highest {ratios.max():.4f}, dearer {len(dearer)}"
        )
    return fields


def _gradient_ratios(name: str, seed: tuple[int, int]) -> list[float]:
    """Return the ratios of ours to the gradient's cost for four pairs of places in one drawn grid; not where the gradient finds no way,
    or cuts the corner of a forbidden cell."""
    rng = np.random.default_rng(seed)
    n = int(rng.choice(GRADIENT_SIZES))
    costs = inflated(make_world(name, n, rng))
    weights = np.zeros((n + 2, n + 2), np.uint16)
    kernels.weigh(costs, weight_table(PlannerConfig()), weights)
    spec, planner = GridSpec(RESOLUTION, n, n, 0.0, 0.0), GridPlanner()
    ends = np.argwhere(costs < HIGHEST_END)
    out = []
    for _ in range(4):
        a, b = ends[rng.integers(len(ends), size=2)]
        peer = gradient_path(weights, (a[0] + 1, a[1] + 1), (b[0] + 1, b[1] + 1))
        if peer is None or not math.isfinite(path_cost(weights, peer)):
            continue
        path = planner.plan(costs, spec, SE2(*spec.center_of(*a)), SE2(*spec.center_of(*b))).path
        ours = path_cost(weights, path[:, 1::-1] / RESOLUTION + 1.0)
        out.append(ours / path_cost(weights, peer))
    return out


def _plan(costs: NDArray[np.uint8], n: int, runs: int) -> tuple[float, PlanResult]:
    """Return the median CPU time of whole plans (weights, search, path, shortcuts; one thread) in ms, and the result."""
    spec = GridSpec(RESOLUTION, n, n, 0.0, 0.0)
    planner = GridPlanner()
    start, goal = (SE2(*spec.center_of(at, at)) for at in (MARGIN, n - MARGIN - 1))
    plan = partial(planner.plan, costs, spec, start, goal)
    result = plan()
    return median_ms(plan, runs, time.process_time), result


def _compare(costs: NDArray[np.uint8], n: int) -> tuple[float, float, int]:
    """Return SciPy's time in ms, the greatest difference of a cell's cost in the integers of the search (the goal's also when searched
    for alone), and how many cells that SciPy reaches a full sweep of ours does not."""
    config = PlannerConfig()
    table = weight_table(config)
    graph = grid_graph(table[costs])
    begin = time.process_time()
    theirs = sweep(graph, MARGIN * n + MARGIN).reshape(n, n)
    peer_ms = 1e3 * (time.process_time() - begin)
    at = n - MARGIN - 1
    weights, state = np.zeros((n + 2, n + 2), np.uint16), np.zeros((n + 2, n + 2), np.uint8)
    cost = np.full((n + 2, n + 2), INT32_LIMIT, np.int32)
    kernels.weigh(costs, table, weights)
    kernels.search(weights, MARGIN + 1, MARGIN + 1, -1, -1, config.neutral, int(table.max()), cost, state)
    swept = cost[1:-1, 1:-1].copy()
    cost.fill(INT32_LIMIT)
    ends = (MARGIN + 1, MARGIN + 1, at + 1, at + 1)
    kernels.search(weights, *ends, config.neutral, int(table.max()), cost, state)
    missed = int((np.isfinite(theirs) & (swept == INT32_LIMIT)).sum())
    is_reached = np.isfinite(theirs)
    worst = float(np.abs(swept[is_reached] - theirs[is_reached]).max())
    return peer_ms, max(worst, abs(float(cost[at + 1, at + 1] - theirs[at, at]))), missed
