"""The visibility graph at work: updates from what changes around a robot, and searches across a site, in processor time.

A site of random blocks has the wanted number of nodes. A robot drives through it and sees, at `RATE_HZ`, the cells within `SEEN` metres, among which
people walk; the graph is updated with that box. Searches go between random free places of the whole site.
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
PEOPLE, PEOPLE_SPEED, ROBOT_SPEED = 6, 1.2, 1.0  # who walks about the robot, and speeds in m/s
RATE_HZ = 5.0  # updates per second of FAR's own configuration
REFRESH = 8  # nodes joined anew per update where something was freed


def make_site(nodes: int, rng: np.random.Generator) -> tuple[GridSpec, U8]:
    """Return a site in which blocks of 1 to 4 m make about so many nodes, and its cells."""
    side = round(np.sqrt(nodes / 3.4) * 4.0 / RESOLUTION)
    cells = np.full((side, side), FREE, np.uint8)
    for _ in range(round(nodes / 3.4)):
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
    walk = _Walk(spec, cells, rng)
    updates = [_update(graph, spec, walk) for _ in range(frames + 5)][5:]
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
    return bool(max(fields["update_median_ms"], fields["search_median_ms"]) <= 3.0 and fields["core_share_pct"] <= 20.0)


class _Walk:
    """A robot that drives straight on until the site's border turns it, and people who walk about it."""

    def __init__(self, spec: GridSpec, cells: U8, rng: np.random.Generator) -> None:
        self._spec, self._cells = spec, cells
        self._reach = round(SEEN / RESOLUTION)
        self._robot = np.array([spec.height, spec.width]) * 0.5
        heading = rng.uniform(-np.pi, np.pi, PEOPLE + 1)
        self._steps = np.stack((np.sin(heading), np.cos(heading)), axis=1) * PEOPLE_SPEED / RATE_HZ / RESOLUTION
        self._steps[0] *= ROBOT_SPEED / PEOPLE_SPEED
        self._people = rng.uniform(-0.6, 0.6, (PEOPLE, 2)) * self._reach

    def next(self) -> tuple[U8, tuple[int, int, int, int]]:
        """Return what is seen a frame later: the cells of a box, and the box."""
        size, reach = np.array([self._spec.height, self._spec.width]), self._reach
        self._robot, self._steps[0] = _bounced(self._robot, self._steps[0], reach + 2, size - reach - 2)
        y, x = (int(v) for v in self._robot)
        box = (y - reach, y + reach, x - reach, x + reach)
        part = self._cells[box[0] : box[1], box[2] : box[3]].copy()
        for k in range(PEOPLE):
            self._people[k], self._steps[k + 1] = _bounced(self._people[k], self._steps[k + 1], 8 - reach, reach - 8)
            py, px = (int(v) + reach for v in self._people[k])
            part[py - 3 : py + 4, px - 3 : px + 4] = FORBIDDEN
        return part, box


def _bounced(
    place: NDArray[np.float64], step: NDArray[np.float64], low: Any, high: Any
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a place one step on, and the step, turned where it would leave."""
    out = np.where((place + step < low) | (place + step > high), -step, step)
    return place + out, out


def _update(graph: VisibilityGraph, spec: GridSpec, walk: _Walk) -> float:
    """Update the graph with what the robot sees next; returns processor seconds."""
    part, box = walk.next()
    began = time.process_time()
    graph.update_box(spec, part, box)
    return time.process_time() - began


def _search(graph: VisibilityGraph, spec: GridSpec, cells: U8, rng: np.random.Generator) -> tuple[float, bool]:
    free = np.argwhere(cells == FREE)
    a, b = spec.centers_of(free[rng.integers(len(free), size=2)]).tolist()
    began = time.process_time()
    found = graph.search((a[0], a[1]), (b[0], b[1]))
    return time.process_time() - began, found is not None
