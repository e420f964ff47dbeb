"""Which node is compared with which finished submap, and how far about the believed pose: where the drift between the two lets them meet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.registration.correlative import Window
from ambler.slam2d.config import LoopConfig
from ambler.slam2d.drift import Drift
from ambler.slam2d.submaps import Submap

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Pair = tuple[int, int]

_SIGMAS = 3.0
_VIEW_STRIDE = 4  # every how many nodes of a submap its views are judged


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """An inserted scan: its vertex, local pose, thinned points, the older of the submaps that took it, and the way driven until it."""

    vertex: int
    stamp_ns: int
    local_from_base: SE2
    loop_points: F32
    match_points: F32
    submap: int
    way: float


@dataclass(frozen=True, slots=True)
class Candidate:
    """A node to be searched in a submap, where it is believed to be there, and how far to look. `covariance` (3, 3) is the drift's."""

    node: int
    submap: int
    submap_from_base: SE2
    window: Window
    covariance: F64


@dataclass(slots=True)
class PairCounts:
    """How often a node of one submap was searched in another, and how many closures hold between the two."""

    tries: dict[Pair, int] = field(default_factory=dict)
    edges: dict[Pair, int] = field(default_factory=dict)

    def copy(self) -> PairCounts:
        """Return one that may be changed."""
        return PairCounts(dict(self.tries), dict(self.edges))


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
        self._views = [poses[[nodes[n].vertex for n in finished[k].nodes[::_VIEW_STRIDE]]] for k in sorted(finished)]
        self._centers = np.array([v[:, :2].mean(axis=0) for v in self._views]).reshape(-1, 2)
        self._radii = np.array(
            [np.hypot(*(v[:, :2] - c).T).max(initial=0.0) for v, c in zip(self._views, self._centers, strict=True)]
        )

    def candidates(self, query: int, wanted: int, counts: PairCounts) -> list[Candidate]:
        """Return the most promising finished submaps for a node, and count the tries."""
        config, node = self._config, self._nodes[query]
        if not len(self._indices):
            return []
        pose = self._poses[node.vertex]
        covariances = self._drift.of(node.submap)[self._indices]
        sigmas = _SIGMAS * self._patience(node.submap, counts)
        reach = np.minimum(config.window_base + sigmas * _largest_sigma(covariances), config.window_max)
        away = np.hypot(*(self._centers - pose[:2]).T) - self._radii
        is_near = (away < config.max_view_distance + reach) & (self._indices < node.submap - 1)
        found: list[tuple[float, int]] = []
        for row in np.flatnonzero(is_near):
            pair = node.submap, int(self._indices[row])
            edges, tries = counts.edges.get(pair, 0), counts.tries.get(pair, 0)
            if edges >= config.edges_per_pair or tries - 2 * edges >= config.tries_per_pair:
                continue
            if int(node.way) % max(1, int(reach[row] / config.wide_window)):
                continue  # wide windows cost more: they are searched less often
            view = self._view_distance(self._views[row], pose)
            if view < config.max_view_distance + reach[row]:
                found.append((view + 0.3 * max(0, tries - 2 * edges), int(row)))
        out = []
        for _, row in sorted(found)[:wanted]:
            pair = node.submap, int(self._indices[row])
            counts.tries[pair] = counts.tries.get(pair, 0) + 1
            out.append(self._candidate(query, pair[1], float(reach[row]), float(sigmas[row]), covariances[row]))
        return out

    def _patience(self, submap: int, counts: PairCounts) -> F64:
        """Return by how much (K,) the windows of one submap in each finished one grow, the more often it was sought there in vain."""
        tries = [max(0, counts.tries.get(p, 0) - 2 * counts.edges.get(p, 0)) for p in ((submap, int(k)) for k in self._indices)]
        return 1.0 + np.array(tries) / self._config.tries_to_double

    def _candidate(self, query: int, submap: int, reach: float, sigmas: float, covariance: F64) -> Candidate:
        config = self._config
        turn = min(config.angle_base + sigmas * math.sqrt(covariance[2, 2]), config.angle_max)
        map_from_submap = SE2.from_array(self._poses[self._submap_vertices[submap]])
        map_from_base = SE2.from_array(self._poses[self._nodes[query].vertex])
        return Candidate(query, submap, map_from_submap.inverse() @ map_from_base, Window(reach, turn), covariance)

    def _view_distance(self, seen: F64, pose: F64) -> float:
        """Return how far a pose is from the nearest one that filled a submap; half a turn counts like some metres."""
        away = np.hypot(seen[:, 0] - pose[0], seen[:, 1] - pose[1])
        return float(np.min(away + self._config.turn_price * 0.5 * (1.0 - np.cos(seen[:, 2] - pose[2]))))


def _largest_sigma(covariances: F64) -> F64:
    """Return the largest standard deviation of the position (K,) of covariances (K, 3, 3)."""
    a, b, d = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    largest = 0.5 * (a + d) + np.sqrt(0.25 * (a - d) ** 2 + b * b)
    return np.asarray(np.sqrt(largest.clip(0.0)))
