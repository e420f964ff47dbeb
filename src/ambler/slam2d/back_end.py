"""Global SLAM: nodes and submaps as a pose graph, loop closures found and optimized in separable jobs.

A `BackgroundJob` works on snapshots only, so that it may run in a thread; `commit` applies its result, and everything that was
added meanwhile moves along with the newest optimized node.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.registration.planar_scan import filter_voxels_adaptively
from ambler.slam2d.agreement import moves_map_by, sort_closures
from ambler.slam2d.config import GraphConfig, LoopConfig
from ambler.slam2d.drift import DriftGraph
from ambler.slam2d.front_end import LocalResult
from ambler.slam2d.graph import Edge, EdgeKind, Graph, OptimizedGraph, diagonal_information, information_of, optimize
from ambler.slam2d.loop_candidates import Candidate, CandidateChooser, Node, PairCounts
from ambler.slam2d.loop_closure import Closure, LoopSearcher, Usual, key_of
from ambler.slam2d.submaps import Submap

_FINAL_BATCH = 20
_RADIANS_WAY = 0.5  # metres of way that a radian counts as


@dataclass(frozen=True, slots=True, eq=False)
class JobResult:
    """What a background job found: new closures; those that wait for confirmation, and those that disagreed and are set aside; how often
    pairs were searched; new poses of all vertices that existed, and the newest node then."""

    believed: tuple[Closure, ...]
    pending: tuple[Closure, ...]
    aside: tuple[Closure, ...]
    tries: dict[int, dict[int, int]]
    optimized: OptimizedGraph | None
    newest_node: int


@dataclass(frozen=True, slots=True)
class LoopConstraint:
    """What a loop closure says: `from_from_to` between the bases at two stamps."""

    from_ns: int
    to_ns: int
    from_from_to: SE2


class BackEnd:
    """Owns the graph. `add` takes inserted scans, `take_work` gives jobs, `commit` applies them."""

    def __init__(self, loop: LoopConfig, graph: GraphConfig, point_sigma: float) -> None:
        self._loop = loop
        self._config = graph
        self.graph = Graph()
        self.nodes: list[Node] = []
        self.submaps: list[Submap] = []
        self.submap_vertices: list[int] = []
        self.closures: dict[tuple[int, int], Closure] = {}
        self.is_converged = True
        self.is_loose = False
        self.moves = 0
        self._point_sigma = point_sigma
        self._searcher = LoopSearcher(loop, graph, point_sigma)
        self._counts = PairCounts()
        self._queue: list[int] = []
        self._way = 0.0
        self._doubt = (0.0, 0.0)
        self._queried_way = -math.inf
        self._pending: tuple[Closure, ...] = ()
        self._aside: tuple[Closure, ...] = ()
        self._surprises: list[float] = []
        self._usual = Usual()
        self._optimized_nodes = 0
        self._is_busy = False

    @property
    def loop_closures(self) -> int:
        """How many loop closures hold."""
        return len(self.closures)

    @property
    def drift_scale(self) -> float:
        """How many times as much as configured scan matching drifts here, as the closures tell that were found."""
        drift = self._loop.drift
        low, high = drift.scale_limits
        weight = drift.scale_weight
        mean = (weight + sum(self._surprises)) / (weight + len(self._surprises))
        return min(max(math.sqrt(mean), low), high)

    def map_from_local(self) -> SE2:
        """Return the transform that moves the local frame's newest poses into the map."""
        if not self.nodes:
            return SE2()
        submap = self.nodes[-1].submap
        return self.graph.pose(self.submap_vertices[submap]) @ self.submaps[submap].local_from_submap.inverse()

    def submap_pose(self, submap: Submap) -> SE2:
        """Return map_from_submap."""
        return self.graph.pose(self.submap_vertices[submap.index])

    def add(self, result: LocalResult, odom_motion: SE2 | None) -> Node:
        """Add an inserted scan; `odom_motion` is the odometry's previous-node_from_this-node, None without odometry."""
        map_from_local = self.map_from_local()
        self._doubt = self._doubt[0] + result.doubt[0] ** 2, self._doubt[1] + result.doubt[1] ** 2
        for submap in result.submaps:
            if submap.index == len(self.submaps):
                self._add_submap(submap, map_from_local)
        pose = result.local_from_base
        previous = self.nodes[-1] if self.nodes else None
        vertex = self.graph.add_vertex(map_from_local @ pose)
        sizes = (self._loop.max_voxel, self._loop.min_points)
        loop_points = filter_voxels_adaptively(result.scan.points, *sizes, picks_middle=self._loop.picks_middle)
        if previous is not None:
            motion = previous.local_from_base.inverse() @ pose
            self._way += math.hypot(motion.x, motion.y) + _RADIANS_WAY * abs(motion.yaw)
        node = Node(
            *(vertex, result.scan.stamp_ns, pose, loop_points, result.match_points, result.scan.origin),
            *(result.submaps[0].index, self._way),
        )
        if result.match is not None:
            score, inliers, lined = self._usual.score, self._usual.inlier_ratio, self._usual.line_share
            score += 0.02 * (result.match.score - score)
            if result.line_share is not None:
                lined += 0.02 * (result.line_share - lined)
            self._usual = Usual(score, inliers + 0.02 * (result.match.inlier_ratio - inliers), lined)
        covariance = (
            np.zeros((3, 3)) if result.match is None else result.match.covariance(self._point_sigma, (0.0, 0.0))
        )
        for submap in result.submaps:
            submap.nodes.append(len(self.nodes))
            source = self.submap_vertices[submap.index]
            intra = information_of(covariance, pose.yaw, self._intra_sigma(submap, pose))
            self.graph.add_edge(Edge(source, vertex, submap.to_submap(pose), intra, EdgeKind.INTRA))
        if previous is not None:
            local = information_of(covariance, pose.yaw, _more(self._config.local_sigma, result.doubt))
            self._add_chain(previous, node, local, odom_motion)
        self.nodes.append(node)
        if self._way >= self._queried_way + self._loop.query_distance:
            self._queried_way = self._way
            self._queue.append(len(self.nodes) - 1)
        return node

    def _intra_sigma(self, submap: Submap, local_from_base: SE2) -> tuple[float, float]:
        """Return how well (m, rad) a submap holds a node: no better than what happened since it began lets it."""
        linear, angular = (math.sqrt(max(0.0, now - then)) for now, then in zip(self._doubt, submap.doubt, strict=True))
        leverage = submap.local_from_submap.distance_to(local_from_base)
        times = self._config.loosening if self.is_loose else 1.0
        own, own_angular = self._config.intra_sigma
        return _more((times * own, times * own_angular), (linear + leverage * angular, angular))

    def _add_submap(self, submap: Submap, map_from_local: SE2) -> None:
        submap.way, submap.doubt = self._way, self._doubt
        self.submaps.append(submap)
        self.submap_vertices.append(self.graph.add_vertex(map_from_local @ submap.local_from_submap))

    def _add_chain(self, previous: Node, node: Node, local: NDArray[np.float64], odom_motion: SE2 | None) -> None:
        config = self._config
        motion = previous.local_from_base.inverse() @ node.local_from_base
        self.graph.add_edge(Edge(previous.vertex, node.vertex, motion, local, EdgeKind.LOCAL))
        if odom_motion is not None:
            sigma = (
                config.odometry_sigma[0] + config.odometry_gain * math.hypot(odom_motion.x, odom_motion.y),
                config.odometry_sigma[1] + config.odometry_gain * abs(odom_motion.yaw),
            )
            information = diagonal_information(sigma)
            self.graph.add_edge(Edge(previous.vertex, node.vertex, odom_motion, information, EdgeKind.ODOMETRY))

    def loop_constraints(self) -> tuple[LoopConstraint, ...]:
        """Return the loop closures that the graph holds now, as relations between scans: from the node of the submap that is nearest to the
        node that was found in it."""
        node_of = {n.vertex: n for n in self.nodes}
        submap_of = dict(zip(self.submap_vertices, self.submaps, strict=True))
        out = []
        for edge_from, edge_to, submap_from_node in self.graph.loops():
            node, submap = node_of[edge_to], submap_of[edge_from]
            within = [self.nodes[k] for k in submap.nodes]
            poses = [submap.to_submap(n.local_from_base) for n in within]
            k = min(range(len(within)), key=lambda i: poses[i].distance_to(submap_from_node))
            out.append(LoopConstraint(within[k].stamp_ns, node.stamp_ns, poses[k].inverse() @ submap_from_node))
        return tuple(out)

    def take_work(self, *, is_final: bool = False) -> Callable[[], JobResult] | None:
        """Return a job when there is enough to do and none is under way; the job must be run and its result committed."""
        unsolved = len(self.nodes) - self._optimized_nodes
        is_due = self.loop_closures > 0 and unsolved >= self._config.nodes_between
        per_job = max(1, self._loop.searches_per_job // self._loop.candidates_per_node)
        is_full = len(self._queue) >= per_job
        is_last = is_final and (len(self._queue) > 0 or unsolved > 0)
        if self._is_busy or not self.nodes or not (is_due or is_full or is_last):
            return None
        self._is_busy = True
        size = per_job * (_FINAL_BATCH if is_final else 2)
        queries, self._queue = self._queue[:size], self._queue[size:]
        return _Job(self, queries, must_solve=is_due or is_last).run

    def queue_final(self) -> None:
        """Queue many nodes once more, now that everything is known; for the end of a recording."""
        self._counts.tries = {}
        last = -math.inf
        for index, node in enumerate(self.nodes):
            if node.way >= last + self._loop.final_distance:
                last = node.way
                self._queue.append(index)

    def commit(self, result: JobResult) -> None:
        """Apply a job's result: new edges, new poses; younger vertices move along with the newest optimized node."""
        self._is_busy = False
        self._pending, self._aside = result.pending, result.aside
        self._counts.tries = result.tries
        rejected = set(result.optimized.rejected) if result.optimized else set()
        self._reject([key for key in rejected if key in self.closures])
        for closure in result.believed:
            if key_of(closure) not in rejected:
                self._believe(closure)
        if result.optimized is None:
            return
        self.is_converged = result.optimized.is_converged
        if result.optimized.is_loosened and not self.is_loose:
            self.is_loose = True
            self.graph.loosen_intra(self._config.loosening)
        n = len(result.optimized.poses)
        anchor = self.nodes[result.newest_node].vertex
        correction = SE2.from_array(result.optimized.poses[anchor]) @ self.graph.pose(anchor).inverse()
        poses = self.graph.poses
        poses[:n] = result.optimized.poses
        for v in range(n, len(poses)):
            poses[v] = (correction @ SE2.from_array(poses[v])).as_array()
        self._optimized_nodes = result.newest_node + 1

    def _believe(self, closure: Closure) -> None:
        self.graph.add_edge(closure.edge)
        self.closures[key_of(closure)] = closure
        pair = self.nodes[closure.node].submap, closure.submap
        if not self._counts.edges_of(pair) and closure.prior_sigma > self._loop.drift.informative:
            self._surprises.append(closure.surprise)
            self.moves += 1
        self._counts.count_edge(pair, 1)

    def _reject(self, rejected: list[tuple[int, int]]) -> None:
        if not rejected:
            return
        self.graph.remove_loops(rejected)
        for key in rejected:
            closure = self.closures.pop(key)
            self._counts.count_edge((self.nodes[closure.node].submap, closure.submap), -1)


class _Job:
    """One background job on a snapshot: choose candidates, search them, sort what was found, solve. It changes nothing of the back end."""

    def __init__(self, back_end: BackEnd, queries: list[int], *, must_solve: bool) -> None:
        b = back_end
        self._loop, self._config, self._searcher, self._usual = b._loop, b._config, b._searcher, b._usual
        self._queries, self._must_solve = queries, must_solve
        self._nodes = b.nodes[:]
        self._submap_vertices = b.submap_vertices[:]
        self._finished = {s.index: s for s in b.submaps if s.is_finished}
        self._ways = [s.way for s in b.submaps]
        self._doubts = [s.doubt for s in b.submaps]
        self._counts = b._counts.copy()
        self._pending, self._aside = b._pending, b._aside
        self._closures = dict(b.closures)
        self._scale = b.drift_scale
        self._graph = b.graph.snapshot()
        self._intra = b.graph.intra
        self._is_loose = b.is_loose

    def run(self) -> JobResult:
        counts = self._counts.copy()
        found = self._search(counts) if self._queries else []
        believed, waiting = self._sort(found)
        edges = [c.edge for c in believed]
        intra = self._intra if self._is_drift(believed) else None
        optimized = optimize(self._graph, edges, self._config, intra) if edges or self._must_solve else None
        rejected = set(optimized.rejected) if optimized else set()
        keys = {key_of(c) for c in believed} - rejected
        aside = {key_of(c): c for c in (*self._aside, *believed) if key_of(c) not in keys}
        aside |= {key: c for key, c in self._closures.items() if key in rejected}
        return JobResult(
            *(tuple(believed), tuple(waiting), tuple(aside.values())),
            *(counts.tries, optimized, len(self._nodes) - 1),
        )

    def _is_drift(self, believed: list[Closure]) -> bool:
        """Whether closures move the map by no more than its chain may have drifted on the way between; places that look alike move it farther."""
        if self._is_loose or not believed:
            return False
        moved = [moves_map_by(c, self._graph.poses) for c in believed]
        ways = [abs(self._nodes[c.node].way - self._ways[c.submap]) for c in believed]
        shares = np.array(moved) / np.maximum(np.array(ways), 1.0)
        return float(np.median(shares)) <= self._loop.drift.linear_per_metre

    def _search(self, counts: PairCounts) -> list[Closure]:
        lengths = (0.0, *np.diff(self._ways))
        doubts = np.diff(np.array(self._doubts).reshape(-1, 2), axis=0, prepend=np.zeros((1, 2)))
        drift = DriftGraph(lengths, doubts, counts.linked, self._scale, self._loop.drift).covariances(
            self._graph.poses[self._submap_vertices]
        )
        poses = self._graph.poses
        chooser = CandidateChooser(self._loop, self._nodes, self._finished, self._submap_vertices, poses, drift)
        candidates = [c for q in self._queries for c in chooser.candidates(q, self._loop.candidates_per_node, counts)]
        found = self._found(candidates)
        return found + self._found(self._followed(found, chooser))

    def _found(self, candidates: list[Candidate]) -> list[Closure]:
        """Search each; return the closures that are new."""
        out: dict[tuple[int, int], Closure] = {}
        for c in candidates:
            vertex = self._submap_vertices[c.submap]
            closure = self._searcher.search(c, self._nodes[c.node], self._finished[c.submap], vertex, self._usual)
            if closure is not None and key_of(closure) not in self._closures:
                out[key_of(closure)] = closure
        return list(out.values())

    def _followed(self, found: list[Closure], chooser: CandidateChooser) -> list[Candidate]:
        """Return what tells whether the closures are true that move the map far: what else must fit then."""
        poses, ways = self._graph.poses, np.array([n.way for n in self._nodes])
        out: dict[tuple[int, int], Candidate] = {}
        for closure in found:
            if moves_map_by(closure, poses) > self._loop.surprise:
                wanted = SE2.from_array(poses[closure.edge.edge_from]) @ closure.edge.from_from_to
                for c in chooser.neighbours(closure.node, wanted, ways):
                    out.setdefault((c.node, c.submap), c)
        return list(out.values())

    def _sort(self, found: list[Closure]) -> tuple[list[Closure], list[Closure]]:
        """Split into closures to believe, among them such as were set aside and fit by now, and those that wait."""
        poses = self._graph.poses
        again = [c for c in self._aside if moves_map_by(c, poses) < self._loop.surprise]
        new = {key_of(c): c for c in (*again, *self._pending, *found) if key_of(c) not in self._closures}
        ways = np.array([n.way for n in self._nodes])
        return sort_closures(list(new.values()), poses, ways, self._loop)


def _more(sigma: tuple[float, float], doubt: tuple[float, float]) -> tuple[float, float]:
    return math.hypot(sigma[0], doubt[0]), math.hypot(sigma[1], doubt[1])
