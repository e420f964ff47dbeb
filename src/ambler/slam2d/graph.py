"""The pose graph of 2-D SLAM: submaps and nodes are vertices; growing arrays, so that a snapshot is one copy."""

from __future__ import annotations

import enum
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.posegraph.solver import PoseGraph, RobustKernel, SolverConfig, solve, structure_of
from ambler.posegraph.structure import Structure
from ambler.slam2d.config import GraphConfig

F64 = NDArray[np.float64]


class EdgeKind(enum.IntEnum):
    """Where an edge comes from."""

    INTRA = 0
    INTER = 1
    LOCAL = 2
    ODOMETRY = 3


@dataclass(frozen=True, slots=True, eq=False)
class Edge:
    """from_from_to between two vertices; `information` float64 (3, 3) holds in the frame of the `to` vertex's measurement."""

    edge_from: int
    edge_to: int
    from_from_to: SE2
    information: F64
    kind: EdgeKind


def diagonal_information(sigma: tuple[float, float]) -> F64:
    """Return the information float64 (3, 3) of (metres, radians) standard deviations."""
    return np.diag([sigma[0] ** -2, sigma[0] ** -2, sigma[1] ** -2])


def information_of(covariance: F64, yaw: float, floor: tuple[float, float]) -> F64:
    """Invert a covariance of (x, y, yaw) given along the axes of the `from` frame, turned into the measured frame, plus a floor."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = turn @ covariance @ turn.T + np.diag([floor[0] ** 2, floor[0] ** 2, floor[1] ** 2])
    out = np.linalg.inv(turned)
    return np.asarray(0.5 * (out + out.T))


class Graph:
    """Vertices with their global poses, and edges."""

    def __init__(self) -> None:
        self.vertices = 0
        self.edges = 0
        self._poses = np.zeros((256, 3))
        self._from = np.zeros(1024, np.int64)
        self._to = np.zeros(1024, np.int64)
        self._z = np.zeros((1024, 3))
        self._information = np.zeros((1024, 3, 3))
        self._kind = np.zeros(1024, np.int64)

    @property
    def poses(self) -> F64:
        """Global poses float64 (V, 3), a view."""
        return self._poses[: self.vertices]

    def pose(self, vertex: int) -> SE2:
        """Return the global pose of a vertex."""
        return SE2.from_array(self._poses[vertex])

    def add_vertex(self, pose: SE2) -> int:
        """Add a vertex at its global pose; returns its number."""
        if self.vertices == len(self._poses):
            self._poses = np.concatenate((self._poses, np.zeros_like(self._poses)))
        self._poses[self.vertices] = pose.as_array()
        self.vertices += 1
        return self.vertices - 1

    def add_edge(self, edge: Edge) -> None:
        """Add an edge between existing vertices."""
        if self.edges == len(self._from):
            for name in ("_from", "_to", "_z", "_information", "_kind"):
                array = getattr(self, name)
                setattr(self, name, np.concatenate((array, np.zeros_like(array))))
        k = self.edges
        self._from[k], self._to[k] = edge.edge_from, edge.edge_to
        self._z[k] = edge.from_from_to.as_array()
        self._information[k] = edge.information
        self._kind[k] = edge.kind
        self.edges += 1

    def loops(self) -> list[tuple[int, int, SE2]]:
        """Return (from, to, from_from_to) of the INTER edges."""
        e = self.edges
        return [
            (int(self._from[k]), int(self._to[k]), SE2.from_array(self._z[k]))
            for k in np.flatnonzero(self._kind[:e] == EdgeKind.INTER)
        ]

    def remove_loops(self, pairs: Collection[tuple[int, int]]) -> int:
        """Drop the INTER edges between the given (from, to) vertices; returns how many there were."""
        e = self.edges
        codes = np.array([a * self.vertices + b for a, b in pairs])
        is_gone = np.isin(self._from[:e] * self.vertices + self._to[:e], codes) & (self._kind[:e] == EdgeKind.INTER)
        keep = np.flatnonzero(~is_gone)
        for name in ("_from", "_to", "_z", "_information", "_kind"):
            array = getattr(self, name)
            array[: len(keep)] = array[keep]
        self.edges = len(keep)
        return e - len(keep)

    @property
    def intra(self) -> NDArray[np.bool_]:
        """Which edges (E,) hold a node in its submap."""
        return np.asarray(self._kind[: self.edges] == EdgeKind.INTRA)

    def loosen_intra(self, times: float) -> None:
        """Multiply the standard deviations of the INTRA edges."""
        self._information[: self.edges][self.intra] /= times**2

    def snapshot(self) -> PoseGraph:
        """Return a copy for the solver."""
        e = self.edges
        return PoseGraph(
            self.poses.copy(),
            self._from[:e].copy(),
            self._to[:e].copy(),
            self._z[:e].copy(),
            self._information[:e].copy(),
            self._kind[:e] == EdgeKind.INTER,
        )


@dataclass(frozen=True, slots=True, eq=False)
class OptimizedGraph:
    """New global poses of the first vertices, which INTER edges (from, to) disagree too much and must go, whether the solver came to
    an end, and whether the INTRA edges were taken for looser than they were told to be."""

    poses: F64
    rejected: tuple[tuple[int, int], ...]
    is_converged: bool
    is_loosened: bool = False


def optimize(
    snapshot: PoseGraph, extra: list[Edge], config: GraphConfig, intra: NDArray[np.bool_] | None = None
) -> OptimizedGraph:
    """Solve a snapshot with new edges; INTER edges far beyond the robust kernel's width are rejected and the rest solved again.

    Scans of one submap share its error, so that many INTRA edges hold a chain of submaps much stiffer than scan matching is, where wheels slip or scans
    are few: whole groups of true closures are rejected then. `intra` (E,) says which edges of the snapshot may be looser by `loosening`, and are
    where `loosening_for` closures more are kept then, and nearly all: a looser chain bends to some of any set, also of false ones.
    """
    graph = _with_edges(snapshot, extra)
    structure = structure_of(graph)
    stiff = _solve_and_reject(graph, config, structure)
    if intra is None or len(stiff.rejected) < config.loosening_for:
        return stiff
    information = graph.information.copy()
    information[: len(intra)][intra] /= config.loosening**2
    loose = _solve_and_reject(replace(graph, information=information), config, structure)
    most = min(len(stiff.rejected) - config.loosening_for, config.loosening_rejects * len(stiff.rejected))
    if len(loose.rejected) > most:
        return stiff
    return replace(loose, is_loosened=True)


def _solve_and_reject(graph: PoseGraph, config: GraphConfig, structure: Structure) -> OptimizedGraph:
    solver = SolverConfig(
        robust_kernel=RobustKernel.HUBER,
        robust_width=config.robust_width,
        max_iterations=config.max_iterations,
        cost_tolerance=1e-4,
        step_tolerance=1e-4,
    )
    result = solve(graph, 0, solver, structure)
    bad = graph.is_robust & (result.edge_chi2 > config.reject_width**2)
    rejected = tuple(zip(graph.edge_from[bad].tolist(), graph.edge_to[bad].tolist(), strict=True))
    if rejected:
        keep = ~bad
        graph = PoseGraph(
            result.poses,
            graph.edge_from[keep],
            graph.edge_to[keep],
            graph.measurements[keep],
            graph.information[keep],
            graph.is_robust[keep],
        )
        result = solve(graph, 0, solver)
    return OptimizedGraph(result.poses, rejected, result.converged)


def _with_edges(graph: PoseGraph, extra: list[Edge]) -> PoseGraph:
    if not extra:
        return graph
    return PoseGraph(
        graph.poses,
        np.concatenate((graph.edge_from, [e.edge_from for e in extra])),
        np.concatenate((graph.edge_to, [e.edge_to for e in extra])),
        np.concatenate((graph.measurements, [e.from_from_to.as_array() for e in extra])),
        np.concatenate((graph.information, [e.information for e in extra])),
        np.concatenate((graph.is_robust, [e.kind == EdgeKind.INTER for e in extra])),
    )
