"""Sites with three dimensions for a sensor in the hand, drawn by a seed: houses with gables, trees, poles, cars, walls and kerbs along a loop over
rolling ground; halls; a tunnel; two corridors that look alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.sim.meshes import HeightField, TriangleMesh
from ambler.sim.sensors import named_generator
from ambler.sim.solids import Shape, Solid, WorldSpec

F64 = NDArray[np.float64]
HAND = 1.25  # metres above the ground
MARGIN = 45.0  # metres of ground beyond the way
CLEAR = 2.0  # metres that things keep from the way


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """A world and a way (N, 3) of the hand through it."""

    world: WorldSpec
    way: F64
    is_closed: bool = True


def draw_site(seed: int, length: float, steepness: float = 1.0, margin: float = MARGIN) -> Site:
    """Draw a site outdoors with a closed loop of about `length` metres and `margin` metres of ground beyond it; its slopes are `steepness` times as steep as
    usual."""
    rng = named_generator(seed, "site")
    way = _loop(rng, length)
    low, high = way.min(axis=0) - margin, way.max(axis=0) + margin
    terrain = _ground(rng, low, high, steepness)
    solids: list[Solid] = []
    meshes: list[TriangleMesh] = []
    taken: list[tuple[float, float, float]] = []
    _houses(rng, way, terrain, solids, meshes, taken, min(32.0, margin))
    _things(rng, way, terrain, solids, taken, min(22.0, margin))
    heights = terrain.heights_at(way) + HAND
    start = SE2(float(way[0, 0]), float(way[0, 1]), 0.0)
    world = WorldSpec(f"site-{seed}", tuple(solids), start, meshes=tuple(meshes), terrain=terrain)
    return Site(world, np.column_stack([way, heights]))


def draw_hall(seed: int, length: float) -> Site:
    """Draw a hall with racks and columns and a closed loop of about `length` metres."""
    rng = named_generator(seed, "hall")
    way = _loop(rng, length, wobble=0.12)
    low, high = way.min(axis=0) - 7.0, way.max(axis=0) + 7.0
    ceiling = float(rng.uniform(4.5, 8.0))
    center, size = 0.5 * (low + high), high - low
    solids = [
        _box("wall", center[0], y, 0.0, size[0] + 0.6, 0.3, 0.0, ceiling) for y in (low[1] - 0.15, high[1] + 0.15)
    ]
    solids += [
        _box("wall", x, center[1], 0.0, 0.3, size[1] + 0.6, 0.0, ceiling) for x in (low[0] - 0.15, high[0] + 0.15)
    ]
    taken: list[tuple[float, float, float]] = []
    for k in range(int(size[0] * size[1] / 22.0)):
        x, y = rng.uniform(low + 1.0, high - 1.0)
        yaw = float(rng.choice([0.0, 0.5 * math.pi])) + float(rng.normal(0.0, 0.03))
        kind = int(rng.integers(3))
        sx, sy, h = (
            (float(rng.uniform(2.0, 6.0)), 1.1, float(rng.uniform(1.8, ceiling - 1.0))),
            (float(rng.uniform(0.6, 1.4)), float(rng.uniform(0.6, 1.2)), float(rng.uniform(0.6, 1.6))),
            (0.5, 0.5, ceiling),
        )[kind]
        radius = 0.5 * math.hypot(sx, sy)
        if _is_free(x, y, radius, way, taken, 1.0):
            solids.append(_box(f"thing-{k}", x, y, yaw, sx, sy, 0.0, h))
            taken.append((x, y, radius))
    start = SE2(float(way[0, 0]), float(way[0, 1]), 0.0)
    world = WorldSpec(f"hall-{seed}", tuple(solids), start, ceiling=ceiling)
    return Site(world, np.column_stack([way, np.full(len(way), HAND)]))


def draw_tunnel(seed: int, length: float) -> Site:
    """Draw a smooth straight tunnel whose middle says nothing of how far one is along it, with furnished portals at both ends."""
    rng = named_generator(seed, "tunnel")
    width, height = float(rng.uniform(4.0, 6.0)), float(rng.uniform(3.5, 5.0))
    yard = 25.0
    half = 0.5 * width
    solids = [_box("side", 0.5 * length, s * (half + 0.2), 0.0, length, 0.4, 0.0, height) for s in (-1.0, 1.0)]
    solids.append(_box("roof", 0.5 * length, 0.0, 0.0, length, width + 0.8, height, height + 0.4))
    way = np.array([[x, 0.0, HAND] for x in np.linspace(-yard + 8.0, length + yard - 8.0, 60)])
    taken: list[tuple[float, float, float]] = []
    for end in (-1, 1):
        middle = -0.5 * yard if end < 0 else length + 0.5 * yard
        solids.append(_box("end", middle + end * 0.5 * yard, 0.0, 0.0, 0.4, 2.0 * yard, 0.0, 6.0))
        for _ in range(40):
            x, y = middle + float(rng.uniform(-0.45, 0.45)) * yard, float(rng.uniform(-yard, yard))
            sx, sy = rng.uniform(0.4, 4.0, 2)
            radius = 0.5 * math.hypot(sx, sy)
            if _is_free(x, y, radius, way[:, :2], taken, CLEAR) and (x + radius < -0.5 or x - radius > length + 0.5):
                solids.append(
                    _box("thing", x, y, float(rng.uniform(0.0, 3.1)), sx, sy, 0.0, float(rng.uniform(1.0, 5.0)))
                )
                taken.append((x, y, radius))
    world = WorldSpec(f"tunnel-{seed}", tuple(solids), SE2(float(way[0, 0]), 0.0, 0.0))
    return Site(world, way, is_closed=False)


def draw_twins(seed: int, length: float) -> Site:
    """Draw two parallel corridors that are equal to the millimetre, with equal bays, joined at both ends, and a closed loop of about `length` metres through them."""
    rng = named_generator(seed, "twins")
    width, apart = float(rng.uniform(2.4, 3.6)), float(rng.uniform(5.5, 9.0))
    bay, ceiling = float(rng.uniform(3.0, 5.0)), float(rng.uniform(2.6, 3.6))
    half, long = 0.5 * width, max(20.0, 0.5 * length - apart)
    reach = 0.5 * long + half
    solids = [
        _box("wall", 0.0, side * (0.5 * apart + half + 0.15), 0.0, 2.0 * reach + 0.6, 0.3, 0.0, ceiling)
        for side in (-1.0, 1.0)
    ]
    solids += [
        _box("wall", side * (reach + 0.15), 0.0, 0.0, 0.3, apart + width + 0.6, 0.0, ceiling) for side in (-1.0, 1.0)
    ]
    solids.append(_box("core", 0.0, 0.0, 0.0, long - width, apart - width, 0.0, ceiling))
    pillar = float(rng.uniform(0.25, 0.4))
    for k in range(int(0.5 * long / bay)):
        for x in ((k + 0.5) * bay, -(k + 0.5) * bay):
            for middle in (-0.5 * apart, 0.5 * apart):
                solids += [
                    _box("pillar", x, middle + side * (half - 0.5 * pillar), 0.0, 0.4, pillar, 0.0, ceiling)
                    for side in (-1.0, 1.0)
                ]
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * [0.5 * long, 0.5 * apart]
    sides = [np.linspace(a, b, 24)[1:-1] for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    way = np.roll(np.vstack(sides), -11, axis=0)  # it begins halfway along a corridor
    world = WorldSpec(f"twins-{seed}", tuple(solids), SE2(float(way[0, 0]), float(way[0, 1]), 0.0), ceiling=ceiling)
    return Site(world, np.column_stack([way, np.full(len(way), HAND)]))


def _loop(rng: np.random.Generator, length: float, wobble: float = 0.22) -> F64:
    """A closed curve (N, 2) about the origin: a circle with a few harmonics."""
    angle = np.linspace(0.0, 2.0 * math.pi, max(24, int(length / 6.0)), endpoint=False)
    radius = np.ones_like(angle)
    for k in (2, 3, 4):
        radius += wobble / (k - 0.5) * rng.normal(0.0, 0.5) * np.cos(k * angle + rng.uniform(0.0, 6.3))
    radius = np.maximum(radius, 0.35)
    way = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    closed = np.vstack([way, way[:1]])
    return np.asarray(way * (length / float(np.linalg.norm(np.diff(closed, axis=0), axis=1).sum())))


def _ground(rng: np.random.Generator, low: F64, high: F64, steepness: float) -> HeightField:
    """Rolling ground: waves of 25 to 90 m, up to some metres."""
    resolution = 2.0
    nx, ny = (int(v) for v in np.ceil((high - low) / resolution) + 1)
    x, y = np.meshgrid(low[0] + resolution * np.arange(nx), low[1] + resolution * np.arange(ny))
    heights = np.zeros((ny, nx))
    for _ in range(6):
        wave, way = float(rng.uniform(25.0, 90.0)), float(rng.uniform(0.0, 2.0 * math.pi))
        phase = 2.0 * math.pi * (math.cos(way) * x + math.sin(way) * y) / wave + float(rng.uniform(0.0, 6.3))
        heights += steepness * (float(rng.uniform(0.0, 0.012)) * wave * np.sin(phase))
    heights += rng.normal(0.0, 0.015, heights.shape)
    return HeightField("ground", heights, resolution, SE2(float(low[0]), float(low[1]), 0.0))


def _houses(
    rng: np.random.Generator,
    way: F64,
    terrain: HeightField,
    solids: list[Solid],
    meshes: list[TriangleMesh],
    taken: list[tuple[float, float, float]],
    reach: float,
) -> None:
    perimeter = 6.0 * len(way)
    for k in range(int(perimeter / 7.0)):
        x, y = _beside(rng, way, 5.0, reach)
        sx, sy = float(rng.uniform(6.0, 20.0)), float(rng.uniform(5.0, 12.0))
        yaw, radius = float(rng.uniform(0.0, math.pi)), 0.5 * math.hypot(sx, sy)
        if not _is_free(x, y, radius, way, taken, CLEAR):
            continue
        ground = _ground_of(terrain, x, y)
        eaves = ground + float(rng.uniform(3.0, 11.0))
        solids.append(_box(f"house-{k}", x, y, yaw, sx, sy, ground - 3.0, eaves))
        if rng.random() < 0.6:
            meshes.append(_gable(f"roof-{k}", SE2(x, y, yaw), sx + 0.6, sy + 0.6, eaves, float(rng.uniform(1.0, 3.5))))
        for _ in range(int(rng.integers(4))):  # porches, stairs and bays
            along = float(rng.uniform(-0.4, 0.4)) * sx
            side = float(rng.choice([-1.0, 1.0]))
            bx, by = SE2(x, y, yaw).transform(np.array([[along, side * (0.5 * sy + 0.4)]]))[0]
            solids.append(
                _box(
                    "porch",
                    bx,
                    by,
                    yaw,
                    float(rng.uniform(0.8, 3.0)),
                    0.9,
                    ground - 1.0,
                    ground + float(rng.uniform(0.3, 3.0)),
                )
            )
        taken.append((x, y, radius))


def _things(
    rng: np.random.Generator,
    way: F64,
    terrain: HeightField,
    solids: list[Solid],
    taken: list[tuple[float, float, float]],
    reach: float,
) -> None:
    perimeter = 6.0 * len(way)
    for k in range(int(perimeter / 2.2)):
        x, y = _beside(rng, way, 2.0, reach)
        kind = ("tree", "tree", "pole", "car", "wall", "box")[int(rng.integers(6))]
        ground, yaw = _ground_of(terrain, x, y), float(rng.uniform(0.0, math.pi))
        radius = {"tree": 2.0, "pole": 0.3, "car": 2.4, "wall": 4.0, "box": 1.0}[kind]
        if not _is_free(x, y, radius, way, taken, 0.8):
            continue
        taken.append((x, y, radius))
        if kind == "tree":
            trunk, crown = float(rng.uniform(0.2, 0.6)), float(rng.uniform(1.5, 3.5))
            foot = ground + float(rng.uniform(2.0, 3.0))
            solids.append(_round(f"trunk-{k}", x, y, trunk, ground - 1.0, foot))
            solids.append(_round(f"crown-{k}", x, y, crown, foot, foot + float(rng.uniform(2.0, 5.0))))
        elif kind == "pole":
            solids.append(
                _round(
                    f"pole-{k}",
                    x,
                    y,
                    float(rng.uniform(0.08, 0.3)),
                    ground - 1.0,
                    ground + float(rng.uniform(3.0, 8.0)),
                )
            )
        elif kind == "car":
            solids.append(_box(f"car-{k}", x, y, yaw, 4.4, 1.8, ground - 0.5, ground + 0.9))
            solids.append(_box(f"cabin-{k}", x, y, yaw, 2.2, 1.6, ground + 0.9, ground + 1.5))
        elif kind == "wall":
            solids.append(_box(f"fence-{k}", x, y, yaw, 7.5, 0.25, ground - 2.0, ground + float(rng.uniform(1.0, 2.2))))
        else:
            size = rng.uniform(0.4, 1.3, 3)
            solids.append(
                _box(f"box-{k}", x, y, yaw, float(size[0]), float(size[1]), ground - 0.5, ground + float(size[2]))
            )


def _beside(rng: np.random.Generator, way: F64, near: float, far: float) -> tuple[float, float]:
    """A place to the left or right of the way."""
    k = int(rng.integers(len(way)))
    ahead = way[(k + 1) % len(way)] - way[k]
    left = np.array([-ahead[1], ahead[0]]) / float(np.linalg.norm(ahead))
    off = float(rng.uniform(near, far)) * float(rng.choice([-1.0, 1.0]))
    x, y = way[k] + float(rng.uniform(0.0, 1.0)) * ahead + off * left
    return float(x), float(y)


def _is_free(
    x: float, y: float, radius: float, way: F64, taken: list[tuple[float, float, float]], clear: float
) -> bool:
    closed = np.vstack([way, 0.5 * (way + np.roll(way, -1, axis=0))])
    if float(np.hypot(closed[:, 0] - x, closed[:, 1] - y).min()) < radius + clear + 1.5:
        return False
    return all(math.hypot(x - a, y - b) > radius + r + 0.3 for a, b, r in taken)


def _ground_of(terrain: HeightField, x: float, y: float) -> float:
    height = float(terrain.heights_at(np.array([[x, y]]))[0])
    return height if math.isfinite(height) else terrain.lowest


def _box(name: str, x: float, y: float, yaw: float, size_x: float, size_y: float, low: float, high: float) -> Solid:
    return Solid(name, Shape.BOX, SE2(float(x), float(y), yaw), float(size_x), float(size_y), low, high)


def _round(name: str, x: float, y: float, diameter: float, low: float, high: float) -> Solid:
    return Solid(name, Shape.CYLINDER, SE2(x, y, 0.0), diameter, diameter, low, high)


def _gable(name: str, pose: SE2, size_x: float, size_y: float, eaves: float, rise: float) -> TriangleMesh:
    """A gabled roof: two slopes and two triangles."""
    a, b = 0.5 * size_x, 0.5 * size_y
    flat = np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, 0.0], [a, 0.0]])
    vertices = np.column_stack([pose.transform(flat), [eaves] * 4 + [eaves + rise] * 2])
    triangles = np.array([[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5], [1, 2, 5], [3, 0, 4]], np.int32)
    return TriangleMesh(name, vertices, triangles)
