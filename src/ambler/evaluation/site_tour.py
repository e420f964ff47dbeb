"""The round through a site by somebody who knows all of it: what the way of an explorer is measured against, in three dimensions.

Of the places from which the truth was looked at, those are taken one by one that show most of what none shows yet (greedy cover), until `SHARE` of the
visible surface is seen; the shortest round from the start is sought by insertion and 2-opt over lengths along the ground.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ambler.sim.reachable_ground import ReachableGround, VisibleSurface

F64 = NDArray[np.float64]
SHARE = 0.98
LATTICE = 0.4  # metres between the places over which lengths are taken
RISE_MOST = 0.5  # of the distance between two places side by side that they may differ in height


def known_tour_length(ground: ReachableGround, surface: VisibleSurface, start: F64) -> float:
    """Return metres of the round from `start` (3,), a place in the world, and back; stops that the lattice does not reach are left out."""
    lattice = _lattice(ground.places())
    tree = cKDTree(lattice)
    stops = np.vstack((start, surface.eyes[cover(surface)]))
    nodes = np.asarray(tree.query(stops)[1])
    legs = _lengths(lattice, tree, nodes)
    legs = legs[:, np.isfinite(legs[0])][np.isfinite(legs[0])]
    return round_length(legs)


def cover(surface: VisibleSurface) -> list[int]:
    """Return the eyes that together see `SHARE` of the surface, chosen greedily."""
    is_left = np.ones(len(surface.points), np.bool_)
    wanted = math.ceil(SHARE * len(surface.points))
    gains = [len(seen) for seen in surface.seen]
    chosen: list[int] = []
    while np.count_nonzero(~is_left) < wanted:
        while True:  # gains only fall, so that the highest one that holds is the best
            best = int(np.argmax(gains))
            gain = int(np.count_nonzero(is_left[surface.seen[best]]))
            if gain == gains[best]:
                break
            gains[best] = gain
        if gain == 0:
            break
        chosen.append(best)
        is_left[surface.seen[best]] = False
    return chosen


def round_length(legs: F64) -> float:
    """Return the length of a short round through all of `legs` (N, N), from the first and back to it."""
    n = len(legs)
    if n < 2:
        return 0.0
    order = [0, int(np.argmax(legs[0]))]
    left = set(range(1, n)) - {order[1]}
    while left:
        far = max(left, key=lambda k: min(legs[k, j] for j in order))
        extra = [legs[a, far] + legs[far, b] - legs[a, b] for a, b in zip(order, order[1:] + order[:1], strict=True)]
        order.insert(int(np.argmin(extra)) + 1, far)
        left.remove(far)
    tour = np.array(order)
    while _untangle(tour, legs):
        pass
    return float(legs[tour, np.roll(tour, -1)].sum())


def _untangle(tour: NDArray[np.int64], legs: F64) -> bool:
    """Turn the stretches of a round whose turning makes it shorter; say whether there were any."""
    n, is_better = len(tour), False
    for i in range(n - 1):
        for j in range(i + 2, n):
            a, b, c, d = tour[i], tour[i + 1], tour[j], tour[(j + 1) % n]
            if legs[a, c] + legs[b, d] < legs[a, b] + legs[c, d] - 1e-9:
                tour[i + 1 : j + 1] = tour[i + 1 : j + 1][::-1].copy()
                is_better = True
    return is_better


def _lattice(places: F64) -> F64:
    """Return one place of each cube of `LATTICE` metres."""
    _, first = np.unique(np.floor(places / LATTICE).astype(np.int64), axis=0, return_index=True)
    return places[np.sort(first)]


def _lengths(lattice: F64, tree: cKDTree, nodes: NDArray[np.int64]) -> F64:
    """Return lengths along the lattice between some of its places, inf where none leads."""
    pairs = tree.query_pairs(1.8 * LATTICE, output_type="ndarray")
    step = lattice[pairs[:, 1]] - lattice[pairs[:, 0]]
    pairs = pairs[np.abs(step[:, 2]) <= RISE_MOST * np.hypot(step[:, 0], step[:, 1])]
    lengths = np.linalg.norm(lattice[pairs[:, 1]] - lattice[pairs[:, 0]], axis=1)
    graph = sparse.coo_matrix((lengths, (pairs[:, 0], pairs[:, 1])), shape=(len(lattice), len(lattice)))
    return np.asarray(dijkstra(graph.tocsr(), directed=False, indices=nodes))[:, nodes]
