"""Which node is compared with which finished submap, and how far about the believed pose: where the drift between the two lets them meet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.registration.correlative import Window
from ambler.registration.seen_by_both import seen_by_both
from ambler.slam2d.config import LoopConfig
from ambler.slam2d.drift import Drift
from ambler.slam2d.submaps import Submap

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Pair = tuple[int, int]

_SIGMAS = 3.0
_SIGHT = 0.8  # share of the points of a node that are nearer than it is said to see
_VIEW_STRIDE = 4  # every how many nodes of a submap its views are judged


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """An inserted scan: its vertex, local pose, thinned points and where the sensor was, the older of the submaps that took it, and the way driven until it."""

    vertex: int
    stamp_ns: int
    local_from_base: SE2
    loop_points: F32
    match_points: F32
    origin: tuple[float, float]
    submap: int
    way: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """A node to be searched in a submap, where it is believed to be there, and how far to look. `covariance` (3, 3) is the drift's. `is_partial`: it was never near, and
    sees only a part of what that submap shows."""

    node: int
    submap: int
    submap_from_base: SE2
    window: Window
    covariance: F64
    is_partial: bool = False


@dataclass(slots=True)
class PairCounts:
    """How often nodes of one submap were searched in another, and how many closures hold between the two: by the node's submap, then by
    the one searched."""

    tries: dict[int, dict[int, int]] = field(default_factory=dict)
    edges: dict[int, dict[int, int]] = field(default_factory=dict)

    def copy(self) -> PairCounts:
        """Return one that may be changed."""
        return PairCounts(*({a: dict(row) for a, row in table.items()} for table in (self.tries, self.edges)))

    def count_try(self, pair: Pair) -> None:
        """Note that a node of pair[0] is searched in pair[1]."""
        row = self.tries.setdefault(pair[0], {})
        row[pair[1]] = row.get(pair[1], 0) + 1

    def count_edge(self, pair: Pair, more: int) -> None:
        """Note `more` closures between the two."""
        row = self.edges.setdefault(pair[0], {})
        row[pair[1]] = row.get(pair[1], 0) + more

    def edges_of(self, pair: Pair) -> int:
        """Return how many closures hold."""
        return self.edges.get(pair[0], {}).get(pair[1], 0)

    def failures(self, submap: int, most: int) -> I64:
        """Return how often nodes of one submap were searched in vain in each of the first `most`, (most,); each closure makes up for two."""
        out = np.zeros(most, np.int64)
        for table, weight in ((self.tries, 1), (self.edges, -2)):
            for k, n in table.get(submap, {}).items():
                out[k] += weight * n
        return out.clip(0)

    @property
    def linked(self) -> tuple[Pair, ...]:
        """The pairs of submaps that closures hold together."""
        return tuple((k, i) for i, row in self.edges.items() for k, n in row.items() if n > 0 and i != k)


@dataclass(frozen=True, slots=True, eq=False)
class _Doubt:
    """Where a node may be in the frame of each finished submap (K): covariances (K, 3, 3) of the drift, how often it was sought in vain, by how many standard deviations
    a window is wide therefore, and how far that is (m)."""

    covariances: F64
    failures: I64
    sigmas: F64
    reach: F64


class CandidateChooser:
    """Chooses on one snapshot: nodes, the finished submaps, their vertices and the poses (V, 3) of all vertices."""

    def __init__(
        self,
        config: LoopConfig,
        nodes: Sequence[Node],
        finished: Mapping[int, Submap],
        submap_vertices: Sequence[int],
        poses: F64,
        drift: Drift,
    ) -> None:
        self._config, self._nodes, self._drift = config, nodes, drift
        self._poses = poses
        self._finished = finished
        self._submap_vertices = submap_vertices
        self._indices = np.array(sorted(finished), np.int64)
        views = [poses[[nodes[n].vertex for n in finished[k].nodes[::_VIEW_STRIDE]]] for k in sorted(finished)]
        self._views = np.concatenate(views) if views else np.zeros((0, 3))
        self._begins = np.cumsum([0, *(len(v) for v in views[:-1])])
        self._centers = np.array([v[:, :2].mean(axis=0) for v in views]).reshape(-1, 2)
        self._radii = np.array(
            [np.hypot(*(v[:, :2] - c).T).max(initial=0.0) for v, c in zip(views, self._centers, strict=True)]
        )

    def neighbours(self, node: int, map_from_base: SE2, ways: F64) -> list[Candidate]:
        """Return what else must fit where a closure is true that puts a node at `map_from_base`: nodes before and after it on the way, each near where the way
        between the two leads then, in the submap that has the nearest view. `ways` (N,) are driven until each node, metres."""
        moved = map_from_base @ SE2.from_array(self._poses[self._nodes[node].vertex]).inverse()
        found = np.searchsorted(ways, [ways[node] + d for d in self._config.follow]).clip(0, len(ways) - 1)
        out = (self._neighbour(int(k), moved) for k in dict.fromkeys(found.tolist()) if k != node)
        return [candidate for candidate in out if candidate is not None]

    def _neighbour(self, query: int, moved: SE2) -> Candidate | None:
        config, node = self._config, self._nodes[query]
        rows = np.flatnonzero(self._indices < node.submap - 1)
        if not len(rows):
            return None
        map_from_base = moved @ SE2.from_array(self._poses[node.vertex])
        views = self._view_distances(map_from_base.as_array())[rows]
        if views.min() > config.max_view_distance:
            return None
        submap = int(self._indices[rows[np.argmin(views)]])
        map_from_submap = SE2.from_array(self._poses[self._submap_vertices[submap]])
        window = Window(config.coarse_above, config.angle_base)
        covariance = self._drift.of(node.submap)[submap]
        return Candidate(query, submap, map_from_submap.inverse() @ map_from_base, window, covariance)

    def candidates(self, query: int, wanted: int, counts: PairCounts) -> list[Candidate]:
        """Return the most promising finished submaps for a node, those first that it was near to, and count the tries."""
        out: list[Candidate] = []
        if not len(self._indices):
            return out
        node = self._nodes[query]
        doubt = self._doubt(node, counts)
        for row, is_partial in self._promising(node, doubt, counts):
            if len(out) == wanted:
                break
            candidate = self._candidate(query, row, doubt, is_partial=is_partial)
            if not is_partial or self._overlap(candidate) >= self._config.partial_share:
                counts.count_try((node.submap, candidate.submap))
                out.append(candidate)
        return out

    def _doubt(self, node: Node, counts: PairCounts) -> _Doubt:
        config = self._config
        covariances = self._drift.of(node.submap)[self._indices]
        failures = counts.failures(node.submap, len(self._submap_vertices))[self._indices]
        sigmas = _SIGMAS * (1.0 + failures / config.tries_to_double)
        reach = np.minimum(config.window_base + sigmas * _largest_sigma(covariances), config.window_max)
        return _Doubt(covariances, failures, sigmas, reach)

    def _promising(self, node: Node, doubt: _Doubt, counts: PairCounts) -> list[tuple[int, bool]]:
        """Return the rows of the submaps that a node may see, the best first, and of each whether it sees it only from afar."""
        config, pose = self._config, self._poses[node.vertex]
        reach, failures = doubt.reach, doubt.failures
        away = np.hypot(*(self._centers - pose[:2]).T) - self._radii
        is_older = self._indices < node.submap - 1
        is_due = int(node.way) % np.maximum(1, (reach / config.wide_window).astype(np.int64)) == 0
        is_near = is_older & is_due & (away < config.max_view_distance + reach) & (failures < config.tries_per_pair)
        low, high = config.partial_window
        is_seen = is_older & (low < reach) & (reach < high) & (failures < config.partial_tries)
        sight = _sight(node) if is_seen.any() else 0.0
        rows = np.flatnonzero(is_near | (is_seen & (away < sight)))
        if not len(rows):
            return []
        held = np.array([counts.edges_of((node.submap, k)) for k in self._indices[rows].tolist()], np.int64)
        view = self._view_distances(pose)[rows]
        was_near = view < config.max_view_distance + reach[rows]
        may_be_seen = is_seen[rows] & (held == 0) & (view < sight)
        is_wanted = np.where(was_near, is_near[rows] & (held < config.edges_per_pair), may_be_seen)
        order = np.lexsort((view + 0.3 * failures[rows], ~was_near))
        order = order[is_wanted[order]]
        return list(zip(rows[order].tolist(), (~was_near[order]).tolist(), strict=True))

    def _overlap(self, candidate: Candidate) -> float:
        """Return the share of a node's points that the submap knows too, where it is believed to be."""
        node, grid = self._nodes[candidate.node], self._finished[candidate.submap].grid
        return float(seen_by_both(grid, node.loop_points, node.origin, candidate.submap_from_base).mean())

    def _candidate(self, query: int, row: int, doubt: _Doubt, *, is_partial: bool) -> Candidate:
        config, submap, covariance = self._config, int(self._indices[row]), doubt.covariances[row]
        turn = config.angle_base + float(doubt.sigmas[row]) * math.sqrt(max(0.0, covariance[2, 2]))
        map_from_submap = SE2.from_array(self._poses[self._submap_vertices[submap]])
        map_from_base = SE2.from_array(self._poses[self._nodes[query].vertex])
        window = Window(float(doubt.reach[row]), min(turn, config.angle_max))
        return Candidate(query, submap, map_from_submap.inverse() @ map_from_base, window, covariance, is_partial)

    def _view_distances(self, pose: F64) -> F64:
        """Return how far a pose is from the nearest one that filled each finished submap (K,); half a turn counts like some metres."""
        away = np.hypot(self._views[:, 0] - pose[0], self._views[:, 1] - pose[1])
        turned = self._config.turn_price * 0.5 * (1.0 - np.cos(self._views[:, 2] - pose[2]))
        return np.minimum.reduceat(away + turned, self._begins)


def _sight(node: Node) -> float:
    """Return how far (m) a node saw, but for its farthest points."""
    away = np.sort(np.hypot(*node.loop_points.T))
    return float(away[int(_SIGHT * (len(away) - 1))])


def _largest_sigma(covariances: F64) -> F64:
    """Return the largest standard deviation of the position (K,) of covariances (K, 3, 3)."""
    a, b, d = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    largest = 0.5 * (a + d) + np.sqrt(0.25 * (a - d) ** 2 + b * b)
    return np.asarray(np.sqrt(largest.clip(0.0)))
