"""The sparsity of a pose graph: a fill-reducing order, and the pattern of the factor. Computed once per solve, used in every iteration.

The order is SuperLU's minimum degree on the graph of poses (one number per pose, not three), which costs about 1/27 of a
factorization; the factorization itself is Ambler's own, in blocks of 3 x 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_matrix
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from ambler.core.errors import BadInputError
from ambler.kernels import pose_graph as kernels

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]


def fill_reducing_order(n: int, a: I64, b: I64) -> I64:
    """Return the new place of each of n unknowns, for the graph with edges a[k] - b[k]."""
    everyone = np.arange(n)
    rows, columns = np.concatenate((everyone, a, b)), np.concatenate((everyone, b, a))
    degree = np.bincount(a, minlength=n) + np.bincount(b, minlength=n)
    values = np.concatenate((2.0 * degree + 1.0, np.full(2 * len(a), -1.0)))  # diagonally dominant: never singular
    matrix = csc_matrix(coo_array((values, (rows, columns)), shape=(n, n)))
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(factor.perm_c, np.int64)


@dataclass(frozen=True)
class Structure:
    """Where everything lies. n free poses, m edges between free pairs, f blocks of the factor below the diagonal.

    `position` (N,) gives the place of a pose or -1, `slot` (E,) the block of an edge or -1; rows of the normal matrix are
    `row_start` (n + 1,), `columns` (m,); rows of the factor `factor_start`, `factor_columns`; its columns begin at `column_start`.
    """

    position: I64
    slot: I64
    row_start: I64
    columns: I64
    factor_start: I64
    factor_columns: I64
    column_start: I64

    @classmethod
    def of(cls, poses: int, edge_from: I64, edge_to: I64, fixed: int) -> Structure:
        """Analyse a graph; raises BadInputError when a pose is not connected with the fixed one."""
        _check_connected(poses, edge_from, edge_to, fixed)
        n = poses - 1
        compact = np.arange(poses) - (np.arange(poses) > fixed)
        compact[fixed] = -1
        a, b = compact[edge_from], compact[edge_to]
        is_free = (a >= 0) & (b >= 0)
        order = fill_reducing_order(n, a[is_free], b[is_free]) if n > 2 else np.arange(n)
        position = np.full(poses, -1, np.int64)
        position[compact >= 0] = order[compact[compact >= 0]]
        a, b = position[edge_from], position[edge_to]
        row, column = np.maximum(a, b), np.minimum(a, b)
        keys, inverse = np.unique((row * n + column)[is_free], return_inverse=True)
        slot = np.full(len(edge_from), -1, np.int64)
        slot[is_free] = inverse
        row_start = np.searchsorted(keys, np.arange(n + 1) * n).astype(np.int64)
        columns = np.ascontiguousarray(keys % n) if n else keys
        parent, count = np.empty(n, np.int64), np.empty(n, np.int64)
        total = kernels.elimination_tree(row_start, columns, parent, count)
        factor_start, factor_columns = np.empty(n + 1, np.int64), np.empty(total, np.int64)
        kernels.factor_rows(row_start, columns, parent, factor_start, factor_columns)
        column_start = np.concatenate((np.zeros(1, np.int64), np.cumsum(count)))
        return cls(position, slot, row_start, columns, factor_start, factor_columns, column_start)


def _check_connected(poses: int, edge_from: I64, edge_to: I64, fixed: int) -> None:
    graph = coo_array((np.ones(len(edge_from)), (edge_from, edge_to)), shape=(poses, poses))
    count, label = connected_components(graph, directed=False)
    if count > 1:
        lost = int(np.flatnonzero(label != label[fixed])[0])
        raise BadInputError(f"pose graph: pose {lost} is not connected with the fixed pose {fixed}")


class NormalEquations:
    """The memory of one solve: normal matrix, gradient and factor."""

    def __init__(self, structure: Structure) -> None:
        n, f = len(structure.row_start) - 1, len(structure.factor_columns)
        self.structure = structure
        self.diagonal: F64 = np.zeros((n, 9))
        self.lower: F64 = np.zeros((len(structure.columns), 9))
        self.gradient: F64 = np.zeros((n, 3))
        self._column_end: I64 = np.empty(n, np.int64)
        self._rows: I64 = np.empty(f, np.int64)
        self._factor: F64 = np.empty((f, 9))
        self._inverse: F64 = np.zeros((n, 9))

    def factorize(self, damping: float = 0.0) -> bool:
        """Factor the normal matrix, its diagonal raised by a share; False when it is not positive definite."""
        s = self.structure
        return bool(
            kernels.factorize(
                *(self.diagonal, self.lower, s.row_start, s.columns, damping, s.factor_start, s.factor_columns),
                *(s.column_start, self._column_end, self._rows, self._factor, self._inverse),
            )
        )

    def step(self, damping: float) -> F64 | None:
        """Return the increment (N, 3) of all poses that minimises the quadratic model, or None if it is not positive definite."""
        s = self.structure
        if not self.factorize(damping):
            return None
        x = -self.gradient
        kernels.solve_factored(s.column_start, self._rows, self._factor, self._inverse, x)
        out = np.zeros((len(s.position), 3))
        is_free = s.position >= 0
        out[is_free] = x[s.position[is_free]]
        return out

    def marginals(self) -> F64:
        """Return the diagonal blocks (n, 3, 3) of the inverse, in permuted order; `factorize` comes first."""
        diagonal = np.empty_like(self._inverse)
        starts = self.structure.column_start
        kernels.invert_on_pattern(
            starts, self._rows, self._factor, self._inverse, np.empty_like(self._factor), diagonal
        )
        return diagonal.reshape(-1, 3, 3)

    def inverse_columns(self, place: int) -> F64:
        """Return the blocks (n, 3, 3) of the inverse in the column of one place, in permuted order; `factorize` comes first."""
        out = np.empty((len(self._inverse), 3, 3))
        for c in range(3):
            x = np.zeros((len(self._inverse), 3))
            x[place, c] = 1.0
            kernels.solve_factored(self.structure.column_start, self._rows, self._factor, self._inverse, x)
            out[:, :, c] = x
        return out
