"""Builds the bounding volume hierarchy of kernels/raycast.py: at every node the cut with the least surface area heuristic.

Goldsmith and Salmon 1987: the cost of a cut is the sum of (surface area x primitives) of both halves, over all cuts of the
primitives in the order of their middles along each axis.
"""

import numpy as np

from ambler.kernels.jit import jit

LEAF_SIZE = 1
DEEP = 40  # from this depth on nodes are halved, so that no tree outgrows the ray kernels' stack of 64


@jit
def _areas(lower, upper, row, out):
    """Write half the surface areas of the boxes around the first 1, 2, ... of the primitives in `row`."""
    x0 = y0 = z0 = np.inf
    x1 = y1 = z1 = -np.inf
    for i in range(row.shape[0]):
        k = row[i]
        x0, y0, z0 = min(x0, lower[k, 0]), min(y0, lower[k, 1]), min(z0, lower[k, 2])
        x1, y1, z1 = max(x1, upper[k, 0]), max(y1, upper[k, 1]), max(z1, upper[k, 2])
        x, y, z = x1 - x0, y1 - y0, z1 - z0
        out[i] = x * y + y * z + z * x


@jit
def _best_split(members, lower, upper, middle, is_deep):
    """Return the members in the order of the best axis, and how many of them go to the first child."""
    n = members.shape[0]
    best, best_size, best_row = np.inf, n // 2, members
    left, right = np.empty(n), np.empty(n)
    for axis in range(3):
        row = members[np.argsort(middle[members, axis], kind="mergesort")]
        _areas(lower, upper, row, left)
        _areas(lower, upper, row[::-1], right)
        for size in range(1, n):
            if is_deep and size != n // 2:
                continue
            cost = left[size - 1] * size + right[n - size - 1] * (n - size)
            if cost < best:
                best, best_size, best_row = cost, size, row
    return best_row, best_size


@jit
def build(lower, upper, order, bounds, firsts, counts):
    """Build the tree over the boxes `lower`, `upper` float64 (P, 3), P >= 1.

    Writes the leaf order of the primitives `order` int32 (P,), and of up to 2 P - 1 nodes `bounds` float64 (., 6), `firsts`
    and `counts` int32 as kernels/raycast.py reads them. Returns the number of nodes.
    """
    n = lower.shape[0]
    middle = 0.5 * (lower + upper)
    for k in range(n):
        order[k] = k
    waiting = np.empty((2 * DEEP + 64, 4), np.int64)
    waiting[0] = (0, 0, n, 0)
    top, nodes = 1, 1
    while top > 0:
        top -= 1
        node, a, b, depth = waiting[top, 0], waiting[top, 1], waiting[top, 2], waiting[top, 3]
        members = order[a:b].copy()
        for j in range(3):
            bounds[node, j], bounds[node, j + 3] = np.inf, -np.inf
            for k in members:
                bounds[node, j] = min(bounds[node, j], lower[k, j])
                bounds[node, j + 3] = max(bounds[node, j + 3], upper[k, j])
        if b - a <= LEAF_SIZE:
            firsts[node], counts[node] = a, b - a
            continue
        row, size = _best_split(members, lower, upper, middle, depth >= DEEP)
        order[a:b] = row
        firsts[node], counts[node] = nodes, 0
        for side in range(2):
            waiting[top, 0], waiting[top, 3] = nodes + side, depth + 1
            waiting[top, 1] = a if side == 0 else a + size
            waiting[top, 2] = a + size if side == 0 else b
            top += 1
        nodes += 2
    return nodes


def warm_up() -> None:
    """Compile or load the kernel with its real argument types."""
    lower = np.zeros((2, 3))
    build(lower, lower + 1.0, np.empty(2, np.int32), np.empty((3, 6)), np.empty(3, np.int32), np.empty(3, np.int32))
