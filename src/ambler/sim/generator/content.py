"""A world of upright solids, meshes and ground as the content of a world file."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ambler.sim.generator.plan import Entry
from ambler.sim.meshes import HeightField, TriangleMesh
from ambler.sim.solids import Shape, Solid, WorldSpec


def content_of(world: WorldSpec) -> Entry:
    """Return what a file of the world holds, to the millimetre. Walls with doors, docks and glass are not told: spatial places have none."""
    start = world.start
    content: Entry = {"start": {"x": _mm(start.x), "y": _mm(start.y), "yaw_deg": round(math.degrees(start.yaw), 3)}}
    if math.isfinite(world.ceiling):
        content["ceiling"] = _mm(world.ceiling)
    content["friction"] = world.friction
    boxes = [_box(s) for s in world.solids if s.shape is Shape.BOX]
    cylinders = [_cylinder(s) for s in world.solids if s.shape is Shape.CYLINDER]
    people = [{"name": p.name, "way": [list(w) for w in p.way], "speed": p.speed} for p in world.people]
    lists = {"boxes": boxes, "cylinders": cylinders, "people": people, "meshes": [_mesh(m) for m in world.meshes]}
    content |= {name: entries for name, entries in lists.items() if entries}
    if world.terrain is not None:
        content["terrain"] = _terrain(world.terrain)
    if world.route:
        content["route"] = {"speed": world.route_speed, "points": [[_mm(x), _mm(y)] for x, y in world.route]}
    return content


def _box(s: Solid) -> Entry:
    pose = s.world_from_solid
    size = [_mm(s.size_x), _mm(s.size_y), _mm(s.z_max - s.z_min)]
    turn: dict[str, Any] = {"yaw_deg": round(math.degrees(pose.yaw), 3)} if pose.yaw else {}
    return {
        "name": s.name,
        "center": [_mm(pose.x), _mm(pose.y)],
        "size": size,
        **turn,
        "base": _mm(s.z_min),
        "albedo": s.albedo,
    }


def _cylinder(s: Solid) -> Entry:
    pose = s.world_from_solid
    size = {"radius": _mm(0.5 * s.size_x), "height": _mm(s.z_max - s.z_min)}
    return {"name": s.name, "center": [_mm(pose.x), _mm(pose.y)], **size, "base": _mm(s.z_min), "albedo": s.albedo}


def _mesh(mesh: TriangleMesh) -> Entry:
    corners = np.round(mesh.vertices, 3).tolist()
    return {"name": mesh.name, "vertices": corners, "triangles": mesh.triangles.tolist(), "albedo": mesh.albedo}


def _terrain(field: HeightField) -> Entry:
    """Heights on lines that lie one sample apart, so that nothing is put between them."""
    ny, nx = field.heights.shape
    x, y = (np.round(np.arange(n) * field.resolution, 3).tolist() for n in (nx, ny))
    corner = [_mm(field.origin.x), _mm(field.origin.y)]
    heights = np.round(field.heights, 3).tolist()
    turn: dict[str, Any] = {"yaw_deg": round(math.degrees(field.origin.yaw), 3)} if field.origin.yaw else {}
    kept = {"name": field.name, "resolution": field.resolution, "corner": corner, **turn, "albedo": field.albedo}
    return {**kept, "x": x, "y": y, "heights": heights}


def _mm(value: float) -> float:
    return round(float(value), 3)
