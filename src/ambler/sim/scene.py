"""The world as rays see it: primitives in the leaf order of a bounding volume hierarchy (surface area heuristic)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.kernels import bvh, raycast
from ambler.sim.meshes import HeightField, TriangleMesh, normals_of
from ambler.sim.solids import Solid, WorldSpec

F64 = NDArray[np.float64]
HAIR = 1e-9  # metres that bounds are larger than what they hold
NOWHERE = 1e15  # the only node of an empty world lies where no ray reaches


@dataclass(frozen=True)
class RayScene:
    """What rays are cast at; `order[k]` is the index of primitive k among the world's solids, then the triangles of its terrain, then those of
    its meshes, one after the other."""

    solids: raycast.Solids
    order: NDArray[np.int32]

    def cast(self, origins: F64, directions: F64, reach: float = 1e3) -> tuple[F64, NDArray[np.int64], F64]:
        """Cast rays (N, 3), (N, 3 unit); returns distances (inf: nothing), primitives hit, cosines of incidence."""
        n = len(origins)
        distance, hit, cosine = np.empty(n), np.empty(n, np.int64), np.empty(n)
        raycast.cast_rays(
            self.solids, np.ascontiguousarray(origins), np.ascontiguousarray(directions), reach, distance, hit, cosine
        )
        return distance, hit, cosine


def build_scene(world: WorldSpec, movers: Sequence[Solid] = ()) -> RayScene:
    """Build the hierarchy over a world's solids, terrain and meshes, the floor and the ceiling; `movers` only give their albedos."""
    terrain = (world.terrain,) if world.terrain is not None else ()
    surfaces: tuple[HeightField | TriangleMesh, ...] = (*terrain, *world.meshes)
    parts = [s.corners for s in surfaces]
    corners = np.concatenate([np.empty((0, 3, 3)), *parts])
    prims = np.array([primitive(s) for s in world.solids]).reshape(-1, 15)
    boxes, triangles = _boxes_around(prims), (corners.min(axis=1) - HAIR, corners.max(axis=1) + HAIR)
    lower, upper = (np.concatenate(part) for part in zip(boxes, triangles, strict=True))
    order, bounds, firsts, counts = _hierarchy(lower, upper)
    prims = np.concatenate([prims, _triangle_rows(corners)])
    kinds = [raycast.GLASS if s.is_glass else int(s.shape) for s in world.solids] + len(corners) * [raycast.TRIANGLE]
    albedos = np.concatenate(
        [[s.albedo for s in world.solids], *(np.full(len(s), t.albedo) for s, t in zip(parts, surfaces, strict=True))]
    )
    solids = raycast.Solids(
        bounds,
        firsts,
        counts,
        np.ascontiguousarray(prims[order]),
        np.array(kinds, np.uint8)[order],
        np.concatenate([albedos[order], [world.floor_albedo, 0.8], [s.albedo for s in movers]]),
        float(world.floor),
        float(world.ceiling),
    )
    return RayScene(solids, order)


def primitive(solid: Solid) -> F64:
    """Return a solid as a row of the kernels, float64 (15,)."""
    pose = solid.world_from_solid
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    center = [pose.x, pose.y, 0.5 * (solid.z_min + solid.z_max)]
    half = [0.5 * solid.size_x, 0.5 * solid.size_y, 0.5 * (solid.z_max - solid.z_min)]
    return np.array([*center, *half, c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0])


def _triangle_rows(corners: F64) -> F64:
    """Return triangles (M, 3, 3) as rows of the kernels, float64 (M, 15)."""
    return np.concatenate([corners.reshape(-1, 9), normals_of(corners), np.zeros((len(corners), 3))], axis=1)


def _boxes_around(prims: F64) -> tuple[F64, F64]:
    """Axis-aligned bounds of primitives, a hair larger than they are."""
    reach = np.einsum("kij,kj->ki", np.abs(prims[:, 6:].reshape(-1, 3, 3)), prims[:, 3:6]) + HAIR
    return prims[:, :3] - reach, prims[:, :3] + reach


def _hierarchy(lower: F64, upper: F64) -> tuple[NDArray[np.int32], F64, NDArray[np.int32], NDArray[np.int32]]:
    """Return the leaf order of the primitives and the nodes' bounds, firsts and counts."""
    n = len(lower)
    order = np.empty(n, np.int32)
    if n == 0:
        return order, np.full((1, 6), NOWHERE), np.zeros(1, np.int32), np.zeros(1, np.int32)
    bounds, firsts, counts = np.empty((2 * n - 1, 6)), np.empty(2 * n - 1, np.int32), np.empty(2 * n - 1, np.int32)
    nodes = bvh.build(np.ascontiguousarray(lower), np.ascontiguousarray(upper), order, bounds, firsts, counts)
    return order, bounds[:nodes], firsts[:nodes], counts[:nodes]
