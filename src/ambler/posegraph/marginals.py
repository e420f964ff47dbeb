"""What a pose graph knows about where one pose lies seen from another: covariances out of its sparse factor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.posegraph.solver import PoseGraph, SolverConfig, checked, linearize, structure_of
from ambler.posegraph.structure import NormalEquations

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class Marginals:
    """Covariances of a graph's poses at the poses that it has, which should be its optimum.

    One factorization serves all: the diagonal blocks of the inverse come from the recursion of Takahashi et al., those between one pose
    and all others from three solutions. Errors are added to (x, y, yaw) of the poses in the graph's frame, as the solver does.
    """

    def __init__(self, graph: PoseGraph, fixed: int = 0, config: SolverConfig | None = None) -> None:
        """Raises BadInputError for a graph that is malformed, or whose edges do not determine its poses."""
        graph = checked(graph, fixed)
        self._poses = graph.poses
        structure = structure_of(graph, fixed)
        self._equations = NormalEquations(structure)
        linearize(graph, graph.poses, config or SolverConfig(), self._equations)
        if not self._equations.factorize():
            raise BadInputError("pose graph: the poses are not determined by the edges")
        self._position = structure.position
        self._covariances = self._spread(self._equations.marginals())

    @property
    def covariances(self) -> F64:
        """Covariance (N, 3, 3) of every pose in the graph's frame, seen from the fixed one."""
        return self._covariances

    def relative(self, pose: int, others: I64) -> F64:
        """Return the covariance (K, 3, 3) of one pose's (x, y, yaw) in the frame of each of the others (K,)."""
        cross = (
            self._spread(self._equations.inverse_columns(self._position[pose])) if self._position[pose] >= 0 else None
        )
        own = self._covariances[pose]
        yaw = self._poses[others, 2]
        d = self._poses[pose, :2] - self._poses[others, :2]
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.zeros((len(others), 3, 3))
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, s, -s, c, 1.0
        lever = np.tile(
            np.eye(3), (len(others), 1, 1)
        )  # how the difference moves when the other pose does, sign turned
        lever[:, 0, 2], lever[:, 1, 2] = -d[:, 1], d[:, 0]
        there = lever @ self._covariances[others] @ lever.transpose(0, 2, 1)
        between = lever @ cross[others] if cross is not None else np.zeros_like(there)
        covariance = own + there - between - between.transpose(0, 2, 1)
        return np.asarray(turn @ covariance @ turn.transpose(0, 2, 1))

    def _spread(self, blocks: F64) -> F64:
        out = np.zeros((len(self._position), 3, 3))
        is_free = self._position >= 0
        out[is_free] = blocks[self._position[is_free]]
        return out
