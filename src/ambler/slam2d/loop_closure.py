"""Loop closure: the search of a node in a finished submap (branch and bound, then refinement)."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels.correlation import P_LOW
from ambler.registration.branch_bound import BranchBoundMatcher, search_coarse_to_fine
from ambler.registration.correlative import Window, correlate
from ambler.registration.gauss_newton import degeneracy_of, refine
from ambler.registration.seen_by_both import seen_by_both
from ambler.slam2d.config import GraphConfig, LoopConfig
from ambler.slam2d.graph import Edge, EdgeKind, information_of
from ambler.slam2d.loop_candidates import Candidate, Node
from ambler.slam2d.submaps import Submap

F32 = NDArray[np.float32]

_DEPTH, _COARSE_DEPTH = 4, 7
WALL_GAIN = 0.4  # what a point on a wall has more than one in an unknown cell, at least
LINED = 0.3  # of the points usually lie on lines, where a closure must show some, too:
UNLINED = 0.15  # of that share at least
P_FREE = 0.45  # what most free cells have less than: beside them unknown ones tell nothing
_FLOOR = (0.05**2, 0.05**2, 0.01**2)  # m^2, rad^2: of a match, beside what drifts


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """A loop edge, from the vertex of a submap to that of a node; `surprise` is its squared error over the drift that was expected (chi
    squared of 3 degrees of freedom, over 3), `prior_sigma` how well the position was known before, metres. `is_partial`: see `Candidate`."""

    edge: Edge
    node: int
    submap: int
    surprise: float = 0.0
    prior_sigma: float = 0.0
    is_partial: bool = False


def key_of(closure: Closure) -> tuple[int, int]:
    """Return the vertices that a closure joins: of the submap and of the node."""
    return closure.edge.edge_from, closure.edge.edge_to


@dataclass(frozen=True, slots=True)
class Usual:
    """What local matches usually reach: mean score, share of inliers, and share of points on lines."""

    score: float = 0.0
    inlier_ratio: float = 0.0
    line_share: float = 0.0


class LoopSearcher:
    """Runs candidates; keeps the stacks of the submaps used last. Only one search may run at a time."""

    def __init__(self, config: LoopConfig, graph: GraphConfig, point_sigma: float) -> None:
        self._config = config
        self._graph = graph
        self._point_sigma = point_sigma
        self._stacks: OrderedDict[tuple[int, int, bool], BranchBoundMatcher] = OrderedDict()

    def search(
        self, candidate: Candidate, node: Node, submap: Submap, submap_vertex: int, usual: Usual
    ) -> Closure | None:
        """Return the constraint that the scan gives, or None where it does not fit as well as usual or would fit anywhere along a corridor."""
        config = self._config
        min_score = min(config.min_score, config.min_score_ratio * usual.score)
        min_inliers = config.min_inlier_ratio_of_usual * usual.inlier_ratio
        if candidate.is_partial:
            start, points = self._coarse_partial(candidate, node, submap, min_inliers)
        else:
            start, points = self._coarse(candidate, node, submap, min_score), node.match_points
        if start is None:
            return None
        match = refine(submap.grid, points, start, start, config.refine)
        if match.score < min_score or match.inlier_ratio < min_inliers:
            return None
        fit = submap.lines.fit(points, node.origin, match.grid_from_base)
        pose = fit.grid_from_base
        if fit.is_held:
            is_loose = degeneracy_of(fit.information) < config.telling
        else:
            # A narrow view fits cells in many places: there, walls are met from the wrong side, or lie where none was drawn.
            is_unlined = usual.line_share > LINED and fit.share < UNLINED * usual.line_share
            is_loose = match.degeneracy < match.weak_ratio or is_unlined
        if is_loose:
            return None
        covariance = match.covariance(self._point_sigma, (0.0, 0.0))
        information = information_of(covariance, pose.yaw, self._graph.inter_sigma)
        edge = Edge(submap_vertex, node.vertex, pose, information, EdgeKind.INTER)
        return Closure(
            edge, candidate.node, candidate.submap, _surprise(candidate, pose), _sigma(candidate), candidate.is_partial
        )

    def _coarse(self, candidate: Candidate, node: Node, submap: Submap, min_score: float) -> SE2 | None:
        """Return the best cell of the window. A wide window is searched on coarse cells first, which promise too much, never too little."""
        window, points = candidate.window, node.loop_points
        if window.linear <= self._config.coarse_above:
            fine = self._stack(submap, 1).match(points, candidate.submap_from_base, window, min_score)
            return fine.grid_from_base if fine else None
        matcher = self._stack(submap, self._config.coarseness)
        return search_coarse_to_fine(matcher, submap.grid, points, candidate.submap_from_base, window, min_score)

    def _coarse_partial(
        self, candidate: Candidate, node: Node, submap: Submap, min_inliers: float
    ) -> tuple[SE2 | None, F32]:
        """Return where most of the scan lies on walls of the submap, whatever of it lies where that knows nothing, and the points there of which both know;
        None when these are too few."""
        config = self._config
        matcher = self._stack(submap, config.coarseness, only_walls=True)
        least = P_LOW + WALL_GAIN * config.partial_share * min_inliers
        coarse = matcher.match(node.loop_points, candidate.submap_from_base, candidate.window, least)
        if coarse is None:
            return None, node.match_points
        near = Window(1.5 * float(matcher.frame[0]), coarse.angular_step)
        fine = correlate(submap.grid, node.loop_points, coarse.grid_from_base, near, unknown=P_FREE)
        start, points = fine.grid_from_base, node.match_points
        for _ in range(2):  # what both know of changes a little with the pose
            is_seen = seen_by_both(submap.grid, node.match_points, node.origin, start)
            points = node.match_points[is_seen]
            if len(points) < max(config.partial_points, config.partial_share * len(is_seen)):
                return None, points
            start = refine(submap.grid, points, start, start, config.refine).grid_from_base
        return start, points

    def _stack(self, submap: Submap, coarseness: int, *, only_walls: bool = False) -> BranchBoundMatcher:
        key = submap.index, coarseness, only_walls
        stack = self._stacks.get(key)
        if stack is None:
            depth = _DEPTH if coarseness == 1 else _COARSE_DEPTH
            stack = self._stacks[key] = BranchBoundMatcher(submap.grid, depth, coarseness, only_walls=only_walls)
            if len(self._stacks) > self._config.cached_stacks:
                self._stacks.popitem(last=False)
        self._stacks.move_to_end(key)
        return stack


def _surprise(candidate: Candidate, found: SE2) -> float:
    believed = candidate.submap_from_base
    off = np.array([found.x - believed.x, found.y - believed.y, wrap_angle(found.yaw - believed.yaw)])
    return float(off @ np.linalg.solve(candidate.covariance + np.diag(_FLOOR), off)) / 3.0


def _sigma(candidate: Candidate) -> float:
    return float(np.sqrt(np.trace(candidate.covariance[:2, :2]) / 2.0))
