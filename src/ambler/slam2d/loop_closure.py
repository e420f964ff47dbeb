"""Loop closure: which node to compare with which finished submap, and the search itself (branch and bound, then refinement)."""

from __future__ import annotations

import heapq
import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.registration.branch_bound import BranchBoundMatcher
from ambler.registration.correlative import Window
from ambler.registration.gauss_newton import refine
from ambler.slam2d.config import GraphConfig, LoopConfig
from ambler.slam2d.graph import Edge, EdgeKind, information_of
from ambler.slam2d.submaps import Submap

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A node to be searched in a submap: vertices, where the graph believes the node to be, and how far to look."""

    node_vertex: int
    submap_vertex: int
    submap: Submap
    submap_from_base: SE2
    window: Window
    loop_points: F32
    match_points: F32
    map_from_submap: SE2
    min_score: float
    min_inlier_ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """A loop edge and how it would move its node: map_from_node(edge) * map_from_node(graph)^-1, about the node's position."""

    edge: Edge
    shift: tuple[float, float, float]

    @property
    def size(self) -> float:
        """How far it moves the node, metres."""
        return math.hypot(self.shift[0], self.shift[1])

    def agrees_with(self, other: Closure, limits: tuple[float, float]) -> bool:
        """Say whether another node would be moved the same way; both must see it from different nodes."""
        away = math.hypot(self.shift[0] - other.shift[0], self.shift[1] - other.shift[1])
        turned = abs(wrap_angle(self.shift[2] - other.shift[2]))
        return self.edge.edge_to != other.edge.edge_to and away < limits[0] and turned < limits[1]


class LoopSearcher:
    """Runs candidates; keeps the stacks of the submaps used last. Only one search may run at a time."""

    def __init__(self, config: LoopConfig, graph: GraphConfig, point_sigma: float) -> None:
        self._config = config
        self._graph = graph
        self._point_sigma = point_sigma
        self._stacks: OrderedDict[int, BranchBoundMatcher] = OrderedDict()

    def search(self, candidate: Candidate) -> Closure | None:
        """Return the accepted constraint, or None."""
        coarse = self._stack(candidate.submap).match(
            candidate.loop_points, candidate.submap_from_base, candidate.window, candidate.min_score
        )
        if coarse is None:
            return None
        start = coarse.grid_from_base
        match = refine(candidate.submap.grid, candidate.match_points, start, start, self._config.refine)
        if match.score < candidate.min_score or match.inlier_ratio < candidate.min_inlier_ratio:
            return None
        covariance = match.covariance(self._point_sigma, (0.0, 0.0))
        pose = match.grid_from_base
        information = information_of(covariance, pose.yaw, self._graph.inter_sigma)
        edge = Edge(candidate.submap_vertex, candidate.node_vertex, pose, information, EdgeKind.INTER)
        new, old = candidate.map_from_submap @ pose, candidate.map_from_submap @ candidate.submap_from_base
        return Closure(edge, (new.x - old.x, new.y - old.y, wrap_angle(new.yaw - old.yaw)))

    def _stack(self, submap: Submap) -> BranchBoundMatcher:
        stack = self._stacks.get(submap.index)
        if stack is None:
            stack = self._stacks[submap.index] = BranchBoundMatcher(submap.grid)
            if len(self._stacks) > self._config.cached_stacks:
                self._stacks.popitem(last=False)
        self._stacks.move_to_end(submap.index)
        return stack


def confirmed(found: list[Closure], pending: list[Closure], config: LoopConfig) -> tuple[list[Closure], list[Closure]]:
    """Split closures into those to believe and those to keep waiting: small ones, and surprising ones that another one confirms."""
    everyone = pending + found
    believed = [
        c
        for c in everyone
        if c.size <= config.surprise or any(c.agrees_with(other, config.agreement) for other in everyone)
    ]
    waiting = [c for c in everyone if c not in believed]
    return believed, waiting


class SubmapLinks:
    """Path lengths between submaps through the graph: along the trajectory, and across loop closures at a small price."""

    _LOOP_PRICE = 1.0

    def __init__(self) -> None:
        self._neighbours: list[dict[int, float]] = []
        self._known: dict[int, list[float]] = {}

    def add_submap(self, length_from_previous: float) -> None:
        """Append a submap that starts `length_from_previous` metres of path after the last one."""
        self._neighbours.append({})
        self._known.clear()
        k = len(self._neighbours) - 1
        if k:
            self._connect(k - 1, k, length_from_previous)

    def add_loop(self, a: int, b: int) -> None:
        """Note a loop closure between two submaps."""
        if a != b and self._neighbours[a].get(b, math.inf) > self._LOOP_PRICE:
            self._connect(a, b, self._LOOP_PRICE)

    def _connect(self, a: int, b: int, length: float) -> None:
        self._known.clear()
        self._neighbours[a][b] = min(length, self._neighbours[a].get(b, math.inf))
        self._neighbours[b][a] = self._neighbours[a][b]

    def distances_from(self, source: int) -> list[float]:
        """Return the shortest path length from one submap to each (Dijkstra), remembered until a link changes."""
        if source in self._known:
            return self._known[source]
        distances = [math.inf] * len(self._neighbours)
        distances[source] = 0.0
        queue = [(0.0, source)]
        while queue:
            d, a = heapq.heappop(queue)
            if d > distances[a]:
                continue
            for b, length in self._neighbours[a].items():
                if d + length < distances[b]:
                    distances[b] = d + length
                    heapq.heappush(queue, (d + length, b))
        self._known[source] = distances
        return distances
