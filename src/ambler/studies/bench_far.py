"""The visibility graph at work: updates from what changes around a robot, and searches across a site, in processor time.

A site of random blocks has the wanted number of nodes. In each frame a robot at a random place sees the cells within `SEEN` metres, in which some
people-sized obstacles have moved; the graph is updated with that box. Searches go between random free places of the whole site.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.planning.clearance_map import FORBIDDEN, FREE
from ambler.planning.visibility_graph import VisibilityGraph, VisibilityGraphConfig

U8 = NDArray[np.uint8]
RESOLUTION = 0.1
SEEN = 7.5  # metres: the range of terrain in FAR's own indoor configuration
MOVERS = 6  # obstacles that moved within a frame's box
RATE_HZ = 5.0  # updates per second of FAR's own configuration
REFRESH = 40  # nodes joined anew per update where something was freed


def make_site(nodes: int, rng: np.random.Generator) -> tuple[GridSpec, U8]:
    """Return a site in which blocks of 1 to 4 m make about so many nodes, and its cells."""
    side = round(np.sqrt(nodes / 4.6) * 4.0 / RESOLUTION)
    cells = np.full((side, side), FREE, np.uint8)
    for _ in range(round(nodes / 4.6)):
        y, x = rng.integers(8, side - 48, 2)
        h, w = rng.integers(10, 40, 2)
        cells[y : y + h, x : x + w] = FORBIDDEN
    return GridSpec(RESOLUTION, side, side, 0.0, 0.0), cells


def measure(nodes: int, frames: int, searches: int, seed: int) -> dict[str, Any]:
    """Return flat fields: nodes and edges, medians and 95 % quantiles of updates and searches in ms of one core, and the share of a core."""
    rng = np.random.default_rng(seed)
    spec, cells = make_site(nodes, rng)
    graph = VisibilityGraph(VisibilityGraphConfig(refresh=REFRESH))
    graph.update(spec, cells.copy())
    built = graph.node_count
    updates = [_frame(graph, spec, cells, rng) for _ in range(frames + 5)][5:]
    found = [_search(graph, spec, cells, rng) for _ in range(searches + 5)][5:]
    seconds = [s for s, _ in found]
    return {
        "nodes": built,
        "edges": graph.edge_count,
        "frames": frames,
        "searches": searches,
        "paths_found": sum(is_found for _, is_found in found),
        "update_median_ms": 1e3 * float(np.median(updates)),
        "update_p95_ms": 1e3 * float(np.quantile(updates, 0.95)),
        "search_median_ms": 1e3 * float(np.median(seconds)),
        "search_p95_ms": 1e3 * float(np.quantile(seconds, 0.95)),
        "core_share_pct": 100.0 * RATE_HZ * (float(np.mean(updates)) + float(np.mean(seconds))),
    }


def meets_bars(fields: dict[str, Any]) -> bool:
    """Whether searches and updates take at most 3 ms each in the median, with at least 2000 nodes where so many were asked for, and at most a fifth of a core
    at five updates and searches per second."""
    return bool(
        max(fields["update_median_ms"], fields["search_median_ms"]) <= 3.0 and fields["core_share_pct"] <= 20.0
    )


def _frame(graph: VisibilityGraph, spec: GridSpec, cells: U8, rng: np.random.Generator) -> float:
    """Update the graph with what a robot at a random place sees; returns processor seconds."""
    reach = round(SEEN / RESOLUTION)
    y, x = rng.integers(reach, spec.height - reach, 2)
    box = (int(y) - reach, int(y) + reach, int(x) - reach, int(x) + reach)
    part = cells[box[0] : box[1], box[2] : box[3]].copy()
    for _ in range(MOVERS):
        my, mx = rng.integers(4, 2 * reach - 12, 2)
        part[my : my + 7, mx : mx + 7] = FORBIDDEN
    began = time.process_time()
    graph.update_box(spec, part, box)
    return time.process_time() - began


def _search(graph: VisibilityGraph, spec: GridSpec, cells: U8, rng: np.random.Generator) -> tuple[float, bool]:
    free = np.argwhere(cells == FREE)
    a, b = spec.centers_of(free[rng.integers(len(free), size=2)]).tolist()
    began = time.process_time()
    found = graph.search((a[0], a[1]), (b[0], b[1]))
    return time.process_time() - began, found is not None
