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
from ambler.registration.correlative import Window
from ambler.registration.planar_scan import filter_voxels_adaptively
from ambler.slam2d.config import GraphConfig, LoopConfig
from ambler.slam2d.front_end import LocalResult
from ambler.slam2d.graph import Edge, EdgeKind, Graph, OptimizedGraph, diagonal_information, information_of, optimize
from ambler.slam2d.loop_closure import Candidate, Closure, LoopSearcher, SubmapLinks, confirmed
from ambler.slam2d.submaps import Submap

F32 = NDArray[np.float32]
_MAX_PENDING = 40
_FINAL_BATCH = 20


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """An inserted scan: its vertex, local pose, thinned points, and the older of the submaps that took it."""

    vertex: int
    stamp_ns: int
    local_from_base: SE2
    loop_points: F32
    match_points: F32
    submap: int


@dataclass(frozen=True, slots=True, eq=False)
class JobResult:
    """What a background job found: new loop edges, closures that wait for confirmation, new poses of all vertices that existed, and
    the newest node then."""

    edges: tuple[Edge, ...]
    pending: tuple[Closure, ...]
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
        self.loop_closures = 0
        self._point_sigma = point_sigma
        self._searcher = LoopSearcher(loop, graph, point_sigma)
        self._links = SubmapLinks()
        self._queue: list[tuple[int, int]] = []
        self._pair_edges: dict[tuple[int, int], int] = {}
        self._pair_tries: dict[tuple[int, int], int] = {}
        self._path_length = 0.0
        self._pending: tuple[Closure, ...] = ()
        self._usual_score = 0.0
        self._usual_inliers = 0.0
        self._optimized_nodes = 0
        self._is_busy = False

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
        for submap in result.submaps:
            if submap.index == len(self.submaps):
                self._add_submap(submap, map_from_local)
        pose = result.local_from_base
        previous = self.nodes[-1] if self.nodes else None
        vertex = self.graph.add_vertex(map_from_local @ pose)
        loop_points = filter_voxels_adaptively(result.scan.points, self._loop.max_voxel, self._loop.min_points)
        node = Node(vertex, result.scan.stamp_ns, pose, loop_points, result.match_points, result.submaps[0].index)
        if result.match is not None:
            self._usual_score += 0.02 * (result.match.score - self._usual_score)
            self._usual_inliers += 0.02 * (result.match.inlier_ratio - self._usual_inliers)
        covariance = (
            np.zeros((3, 3)) if result.match is None else result.match.covariance(self._point_sigma, (0.0, 0.0))
        )
        intra = information_of(covariance, pose.yaw, self._config.intra_sigma)
        for submap in result.submaps:
            submap.nodes.append(len(self.nodes))
            source = self.submap_vertices[submap.index]
            self.graph.add_edge(Edge(source, vertex, submap.to_submap(pose), intra, EdgeKind.INTRA))
        if previous is not None:
            local = information_of(covariance, pose.yaw, self._config.local_sigma)
            self._add_chain(previous, node, local, odom_motion)
        self.nodes.append(node)
        if len(self.nodes) % self._loop.node_stride == 0:
            self._queue_candidates(len(self.nodes) - 1, self._loop.candidates_per_node)
        return node

    def _add_submap(self, submap: Submap, map_from_local: SE2) -> None:
        submap.path_length = self._path_length
        before = self.submaps[-1].path_length if self.submaps else 0.0
        self.submaps.append(submap)
        self.submap_vertices.append(self.graph.add_vertex(map_from_local @ submap.local_from_submap))
        self._links.add_submap(self._path_length - before)

    def _add_chain(self, previous: Node, node: Node, local: NDArray[np.float64], odom_motion: SE2 | None) -> None:
        config = self._config
        motion = previous.local_from_base.inverse() @ node.local_from_base
        self._path_length += math.hypot(motion.x, motion.y) + 0.5 * abs(motion.yaw)
        self.graph.add_edge(Edge(previous.vertex, node.vertex, motion, local, EdgeKind.LOCAL))
        if odom_motion is not None:
            sigma = (
                config.odometry_sigma[0] + config.odometry_gain * math.hypot(odom_motion.x, odom_motion.y),
                config.odometry_sigma[1] + config.odometry_gain * abs(odom_motion.yaw),
            )
            information = diagonal_information(sigma)
            self.graph.add_edge(Edge(previous.vertex, node.vertex, odom_motion, information, EdgeKind.ODOMETRY))

    def _queue_candidates(self, index: int, wanted: int) -> None:
        """Choose the finished submaps that a node shall be searched in: seen from nearby in a like direction, and rarely compared so far."""
        loop, node = self._loop, self.nodes[index]
        pose = self.graph.pose(node.vertex)
        distances = self._links.distances_from(node.submap)
        found: list[tuple[float, int]] = []
        for submap in self.submaps:
            k = submap.index
            pair = (node.submap, k)
            if not submap.is_finished or k >= node.submap - 1 or self._pair_edges.get(pair, 0) >= loop.edges_per_pair:
                continue
            reach = self._window(distances[k]).linear
            if self._distance_to(submap, pose) > min(reach, loop.max_distance):
                continue
            view = self._view_distance(submap, pose)
            if view < loop.max_view_distance + reach:
                tries = self._pair_tries.get(pair, 0) - 2 * self._pair_edges.get(pair, 0)
                found.append((view + 0.3 * max(0, tries), k))
        for _, k in sorted(found)[:wanted]:
            self._queue.append((index, k))
            pair = (node.submap, k)
            self._pair_tries[pair] = self._pair_tries.get(pair, 0) + 1

    def _view_distance(self, submap: Submap, pose: SE2) -> float:
        """Return how far a pose is from the nearest one that filled a submap; half a turn counts like some metres."""
        vertices = [self.nodes[n].vertex for n in submap.nodes[::4]]
        seen = self.graph.poses[vertices]
        away = np.hypot(seen[:, 0] - pose.x, seen[:, 1] - pose.y)
        return float(np.min(away + self._loop.turn_price * 0.5 * (1.0 - np.cos(seen[:, 2] - pose.yaw))))

    def _window(self, path: float) -> Window:
        loop = self._loop
        return Window(
            min(loop.window_base + loop.window_per_metre * path, loop.window_max),
            min(loop.angle_base + loop.angle_per_metre * path, loop.angle_max),
        )

    @staticmethod
    def _center(submap: Submap) -> NDArray[np.float64]:
        h, w = submap.grid.cells.shape
        resolution = float(submap.grid.frame[0])
        return submap.grid.frame[1:] + 0.5 * resolution * np.array([w, h])

    def _distance_to(self, submap: Submap, map_from_base: SE2) -> float:
        """Return how far a pose lies outside the submap's box."""
        p = self.submap_pose(submap).inverse() @ map_from_base
        half = 0.5 * float(submap.grid.frame[0]) * np.array(submap.grid.cells.shape[::-1])
        center = self._center(submap)
        return math.hypot(max(0.0, abs(p.x - center[0]) - half[0]), max(0.0, abs(p.y - center[1]) - half[1]))

    def _candidate(self, index: int, k: int) -> Candidate:
        node, submap = self.nodes[index], self.submaps[k]
        distances = self._links.distances_from(node.submap)
        return Candidate(
            node.vertex,
            self.submap_vertices[k],
            submap,
            self.submap_pose(submap).inverse() @ self.graph.pose(node.vertex),
            self._window(distances[k]),
            node.loop_points,
            node.match_points,
            self.submap_pose(submap),
            min(self._loop.min_score, self._loop.min_score_ratio * self._usual_score),
            self._loop.min_inlier_ratio_of_usual * self._usual_inliers,
        )

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
        is_full = len(self._queue) >= self._loop.searches_per_job
        is_last = is_final and (len(self._queue) > 0 or unsolved > 0)
        if self._is_busy or not self.nodes or not (is_due or is_full or is_last):
            return None
        self._is_busy = True
        size = self._loop.searches_per_job * (_FINAL_BATCH if is_final else 2)
        batch, self._queue = self._queue[:size], self._queue[size:]
        candidates = [self._candidate(index, k) for index, k in batch]
        snapshot = self.graph.snapshot()
        newest = len(self.nodes) - 1
        searcher, config, loop, pending = self._searcher, self._config, self._loop, list(self._pending)
        must_solve = is_due or is_last

        def run() -> JobResult:
            found = [closure for c in candidates if (closure := searcher.search(c)) is not None]
            believed, waiting = confirmed(found, pending, loop)
            edges = [c.edge for c in believed]
            optimized = optimize(snapshot, edges, config) if edges or must_solve else None
            return JobResult(tuple(edges), tuple(waiting), optimized, newest)

        return run

    def queue_final(self) -> None:
        """Queue many nodes once more, now that everything is known; for the end of a recording."""
        for index in range(0, len(self.nodes), self._loop.final_stride):
            self._queue_candidates(index, self._loop.candidates_per_node)

    def commit(self, result: JobResult) -> None:
        """Apply a job's result: new edges, new poses; younger vertices move along with the newest optimized node."""
        self._is_busy = False
        self._pending = result.pending[-_MAX_PENDING:]
        vertex_to_node = {n.vertex: i for i, n in enumerate(self.nodes)} if result.edges else {}
        vertex_to_submap = {v: k for k, v in enumerate(self.submap_vertices)}
        for edge in result.edges:
            self.graph.add_edge(edge)
            self.loop_closures += 1
            node, k = self.nodes[vertex_to_node[edge.edge_to]], vertex_to_submap[edge.edge_from]
            pair = (node.submap, k)
            self._pair_edges[pair] = self._pair_edges.get(pair, 0) + 1
            self._links.add_loop(node.submap, k)
        if result.optimized is None:
            return
        self._reject(result.optimized.rejected)
        n = len(result.optimized.poses)
        anchor = self.nodes[result.newest_node].vertex
        correction = SE2.from_array(result.optimized.poses[anchor]) @ self.graph.pose(anchor).inverse()
        poses = self.graph.poses
        poses[:n] = result.optimized.poses
        for v in range(n, len(poses)):
            poses[v] = (correction @ SE2.from_array(poses[v])).as_array()
        self._optimized_nodes = result.newest_node + 1

    def _reject(self, rejected: tuple[tuple[int, int], ...]) -> None:
        if rejected:
            self.loop_closures -= self.graph.remove_loops(rejected)
