"""Terrain and meshes for MuJoCo, on the triangles that rays meet, and how a robot is put on them.

A height field becomes an hfield geom. Of a mesh geom MuJoCo would collide the convex hull, so a mesh becomes one convex piece per
triangle: the triangle itself outside, and behind it, `DEPTH` away, half of it. Contact on the outer side is exact to some ten
micrometres; behind a sheet, and beside edges sharper than 90 degrees, it begins up to `DEPTH` early.
"""

from __future__ import annotations

import math
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.sim.meshes import HeightField, TriangleMesh, normals_of
from ambler.sim.solids import WorldSpec

F64 = NDArray[np.float64]

DEPTH = 0.02  # metres
BELOW = 1.0  # metres of solid ground under a terrain's lowest point
STEEP = math.cos(math.radians(45.0))  # a wheel that meets ground steeper than this bumps into it


def surfaces_xml(world: WorldSpec) -> tuple[str, str]:
    """Return the assets and the geoms of a world's terrain and meshes; geoms are named `NAME#...` like those of solids."""
    pieces = [_mesh_xml(k, mesh, world.friction) for k, mesh in enumerate(world.meshes)]
    if world.terrain is not None:
        pieces.append(_terrain_xml(world.terrain, world.friction))
    return "\n".join(p[0] for p in pieces), "\n".join(p[1] for p in pieces)


def ground_names(world: WorldSpec) -> set[str]:
    """Return the names of terrain and meshes: what wheels and feet may stand on."""
    return {m.name for m in world.meshes} | ({world.terrain.name} if world.terrain is not None else set())


def rest_pose(world: WorldSpec, world_from_base: SE2, footprint: F64) -> SE3:
    """Return a pose of the base just above the ground at a planar pose, tilted as the ground under the footprint (N, 2) is."""
    if world.is_flat:
        return SE3.from_se2(world_from_base)
    return pose_on(ground_under_base(world, world_from_base, footprint), world_from_base, footprint)


def ground_under_base(world: WorldSpec, world_from_base: SE2, footprint: F64, height: float = -math.inf) -> F64:
    """Return the heights of the ground under a base that is at a `height`: its middle, the corners of the footprint (N, 2), and half way
    to them, float64 (2 N + 1,)."""
    return world.ground_at(world_from_base.transform(_feelers(footprint)), height)


def _feelers(footprint: F64) -> F64:
    return np.concatenate([np.zeros((1, 2)), footprint, 0.5 * footprint])


def pose_on(heights: F64, world_from_base: SE2, footprint: F64) -> SE3:
    """Return the pose of a base on ground of these heights (`ground_under_base`): on their plane, raised until nothing lies above it."""
    points = _feelers(footprint)
    (slope_x, slope_y, middle), *_ = np.linalg.lstsq(
        np.column_stack([points, np.ones(len(points))]), heights, rcond=None
    )
    above = float(np.max(heights - points @ [slope_x, slope_y] - middle))
    pitch = math.atan(-slope_x)
    roll = math.atan(slope_y * math.cos(pitch))
    return SE3.from_rpy((world_from_base.x, world_from_base.y, float(middle) + above), roll, pitch, world_from_base.yaw)


def _terrain_xml(terrain: HeightField, friction: float) -> tuple[str, str]:
    """MuJoCo wants shares of the height range, the row of the highest y first, and the middle of the field as its place."""
    (ny, nx), (x, y) = terrain.heights.shape, terrain.size
    low = terrain.lowest
    span = max(float(terrain.heights.max()) - low, 1e-6)
    shares = " ".join(f"{v:.9g}" for v in ((terrain.heights - low) / span)[::-1].ravel().tolist())
    middle = terrain.origin @ SE2(0.5 * x, 0.5 * y, 0.0)
    size = f"{0.5 * x!r} {0.5 * y!r} {span!r} {BELOW!r}"
    turn = f"{math.cos(0.5 * middle.yaw)!r} 0 0 {math.sin(0.5 * middle.yaw)!r}"
    asset = f'<hfield name="terrain" nrow="{ny}" ncol="{nx}" size="{size}" elevation="{shares}"/>'
    return asset, (
        f'<geom name={quoteattr(f"{terrain.name}#terrain")} type="hfield" hfield="terrain" priority="1"'
        f' friction="{friction!r} 0.005 0.0001" pos="{middle.x!r} {middle.y!r} {low!r}" quat="{turn}"/>'
    )


def _mesh_xml(number: int, mesh: TriangleMesh, friction: float) -> tuple[str, str]:
    corners = mesh.corners
    center = corners.mean(axis=1, keepdims=True)
    back = center + 0.5 * (corners - center) - DEPTH * normals_of(corners)[:, None]
    assets, geoms = [], []
    for k, points in enumerate(np.concatenate([corners, back], axis=1)):
        vertices = " ".join(f"{v:.9g}" for v in points.ravel().tolist())
        assets.append(f'<mesh name="mesh_{number}_{k}" inertia="shell" vertex="{vertices}"/>')
        name = quoteattr(f"{mesh.name}#mesh_{number}_{k}")
        geoms.append(
            f'<geom name={name} type="mesh" mesh="mesh_{number}_{k}" priority="1" friction="{friction!r} 0.005 0.0001"/>'
        )
    return "\n".join(assets), "\n".join(geoms)
