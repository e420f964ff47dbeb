"""Peers of the planner, for tests and the benchmark: its graph handed to SciPy's Dijkstra, and the gradient path of a full potential."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from ambler.kernels import gradient_path as gradient
from ambler.kernels.graph_search import DIAGONAL, STRAIGHT

F64 = NDArray[np.float64]


def grid_graph(weights: NDArray[np.uint16], straight: float = STRAIGHT, diagonal: float = DIAGONAL) -> csr_array:
    """Return the 8-connected graph of weights uint16 [iy, ix] (0: forbidden): L * (w_a + w_b) per edge, no cut corners."""
    height, width = weights.shape
    w = weights.astype(np.float64)
    index = np.arange(height * width).reshape(height, width)
    rows, columns, values = [], [], []
    for dy, dx, length in ((0, 1, straight), (1, 0, straight), (1, 1, diagonal), (1, -1, diagonal)):
        a = (slice(0, height - dy), slice(max(0, -dx), width - max(0, dx)))
        b = (slice(dy, height), slice(max(0, dx), width - max(0, -dx)))
        is_edge = (w[a] > 0) & (w[b] > 0)
        if dy and dx:
            is_edge &= (w[a[0], b[1]] > 0) & (w[b[0], a[1]] > 0)
        rows.append(index[a][is_edge])
        columns.append(index[b][is_edge])
        values.append((length * (w[a] + w[b]))[is_edge])
    n = height * width
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return csr_array(coo_array(entries, shape=(n, n)))


def scipy_costs(
    weights: NDArray[np.uint16], start: tuple[int, int], straight: float = STRAIGHT, diagonal: float = DIAGONAL
) -> F64:
    """Return the least cost from `start` (iy, ix) to every cell, float64 [iy, ix], inf where no path leads."""
    graph = grid_graph(weights, straight, diagonal)
    return sweep(graph, int(start[0]) * weights.shape[1] + int(start[1])).reshape(weights.shape)


def sweep(graph: csr_array, start: int) -> F64:
    """Return the least cost from one node of a symmetric graph to every node, float64 (n,)."""
    costs: F64 = np.asarray(dijkstra(graph, directed=False, indices=np.array([start])), np.float64)
    return costs.reshape(-1)


def gradient_path(weights: NDArray[np.uint16], start: tuple[int, int], goal: tuple[int, int]) -> F64 | None:
    """Return the points (N, 2) of (y, x) in cells down the gradient of the full potential; None when it finds no way.

    `weights` has a border of blocked cells (`graph_search.weigh`), and the cells (iy, ix) are counted with it.
    """
    levels = np.empty(weights.shape)
    gradient.potential(weights, goal[0], goal[1], levels)
    if not np.isfinite(levels[start]):
        return None
    points = np.empty((4 * weights.size, 2))
    n = gradient.descend(levels, start[0], start[1], goal[0], goal[1], points)
    return points[:n].copy() if n else None
