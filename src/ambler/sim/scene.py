"""The world as rays see it: primitives in the leaf order of a bounding volume hierarchy (surface area heuristic)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.kernels import raycast
from ambler.sim.solids import Solid, WorldSpec

F64 = NDArray[np.float64]
LEAF_SIZE = 1


@dataclass(frozen=True)
class RayScene:
    """The arrays of kernels/raycast.py; `order[k]` is the index in the world's solids of primitive k."""

    bounds: F64
    firsts: NDArray[np.int32]
    counts: NDArray[np.int32]
    prims: F64
    kinds: NDArray[np.uint8]
    albedos: F64
    floor: float
    ceiling: float
    order: NDArray[np.int32]

    @property
    def hierarchy(self) -> tuple[F64, NDArray[np.int32], NDArray[np.int32], F64, NDArray[np.uint8]]:
        """The first five arguments of every ray kernel."""
        return (self.bounds, self.firsts, self.counts, self.prims, self.kinds)

    def cast(self, origins: F64, directions: F64, reach: float = 1e3) -> tuple[F64, NDArray[np.int64], F64]:
        """Cast rays (N, 3), (N, 3 unit); returns distances (inf: nothing), primitives hit, cosines of incidence."""
        n = len(origins)
        distance, hit, cosine = np.empty(n), np.empty(n, np.int64), np.empty(n)
        raycast.cast_rays(
            *(*self.hierarchy, self.floor, self.ceiling),
            *(np.ascontiguousarray(origins), np.ascontiguousarray(directions), reach, distance, hit, cosine),
        )
        return distance, hit, cosine


def build_scene(world: WorldSpec, movers: Sequence[Solid] = ()) -> RayScene:
    """Build the hierarchy over a world's solids, the floor at z = 0 and the ceiling; `movers` only give their albedos."""
    prims = np.array([primitive(s) for s in world.solids]).reshape(-1, 15)
    lower, upper = _boxes_around(prims)
    order, nodes = _split(lower, upper)
    bounds = np.array([n[0] for n in nodes]).reshape(-1, 6)
    kinds = np.array([raycast.GLASS if s.is_glass else s.shape for s in world.solids], np.uint8)
    albedos = np.array([s.albedo for s in world.solids])
    return RayScene(
        bounds,
        np.array([n[1] for n in nodes], np.int32),
        np.array([n[2] for n in nodes], np.int32),
        np.ascontiguousarray(prims[order]),
        kinds[order],
        np.concatenate([albedos[order], [world.floor_albedo, 0.8], [s.albedo for s in movers]]),
        0.0,
        float(world.ceiling),
        order,
    )


def primitive(solid: Solid) -> F64:
    """Return a solid as a row of the kernels, float64 (15,)."""
    pose = solid.world_from_solid
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    center = [pose.x, pose.y, 0.5 * (solid.z_min + solid.z_max)]
    half = [0.5 * solid.size_x, 0.5 * solid.size_y, 0.5 * (solid.z_max - solid.z_min)]
    return np.array([*center, *half, c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0])


def _boxes_around(prims: F64) -> tuple[F64, F64]:
    """Axis-aligned bounds of primitives, a hair larger than they are."""
    reach = np.einsum("kij,kj->ki", np.abs(prims[:, 6:].reshape(-1, 3, 3)), prims[:, 3:6]) + 1e-9
    return prims[:, :3] - reach, prims[:, :3] + reach


def _split(lower: F64, upper: F64) -> tuple[NDArray[np.int32], list[tuple[F64, int, int]]]:
    """Return the leaf order of the primitives and the nodes (bounds, first, count); children are neighbours in the list."""
    order = np.arange(len(lower), dtype=np.int32)
    middle = 0.5 * (lower + upper)
    empty = (np.full(6, np.inf), 0, 0)
    nodes: list[tuple[F64, int, int]] = [empty]
    if not len(order):
        return order, [_nowhere()]
    waiting = [(0, 0, len(order))]
    while waiting:
        node, a, b = waiting.pop()
        members = order[a:b]
        bounds = np.concatenate([lower[members].min(axis=0), upper[members].max(axis=0)])
        if b - a <= LEAF_SIZE:
            nodes[node] = (bounds, a, b - a)
            continue
        members, size = _best_split(members, lower, upper, middle)
        order[a:b] = members
        half = a + size
        nodes[node] = (bounds, len(nodes), 0)
        waiting += [(len(nodes), a, half), (len(nodes) + 1, half, b)]
        nodes += [empty, empty]
    return order, nodes


def _best_split(members: NDArray[np.int32], lower: F64, upper: F64, middle: F64) -> tuple[NDArray[np.int32], int]:
    """Sort the members along the axis, and cut where, sum of (surface area x primitives) of both halves is least."""
    best, best_members, best_size = np.inf, members, len(members) // 2
    sizes = np.arange(1, len(members))
    for axis in range(3):
        row = members[np.argsort(middle[members, axis], kind="stable")]
        left = _areas(lower[row], upper[row])
        right = _areas(lower[row[::-1]], upper[row[::-1]])[::-1]
        cost = left[:-1] * sizes + right[1:] * sizes[::-1]
        cut = int(np.argmin(cost))
        if cost[cut] < best:
            best, best_members, best_size = float(cost[cut]), row, cut + 1
    return best_members, best_size


def _areas(lower: F64, upper: F64) -> F64:
    """Surface areas of the boxes around the first 1, 2, ... N of the given ones."""
    size = np.maximum.accumulate(upper) - np.minimum.accumulate(lower)
    return np.asarray(size[:, 0] * size[:, 1] + size[:, 1] * size[:, 2] + size[:, 2] * size[:, 0])


def _nowhere() -> tuple[F64, int, int]:
    """The only node of an empty world: bounds that no ray reaches."""
    return (np.full(6, 1e15), 0, 0)
