"""What of a world with three dimensions a robot can reach on the ground, and what of its surfaces can be seen from there: the truth that maps of sites are
judged by. Rays straight down find the ground of every level, rays from where the robot can be find what is visible."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2
from ambler.sim.scene import RayScene, build_scene
from ambler.sim.solids import Shape, Solid, WorldSpec
from ambler.sim.surface_contact import ground_under_base

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
Bool = NDArray[np.bool_]
LEVELS_MOST = 6
SKIN = 0.02  # metres below a surface from which the next one is looked for
MARGIN = 0.5


@dataclass(frozen=True, slots=True)
class GroundRules:
    """What a robot crosses: `step` metres from a cell to the next, slopes up to `rise` (m per m), below what hangs `clearance` metres over the ground, with
    `radius` metres around itself free. Cells are `resolution` metres."""

    radius: float
    clearance: float
    step: float = 0.03
    rise: float = math.tan(math.radians(18.0))
    resolution: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class ReachableGround:
    """Heights float32 [level, iy, ix] of all ground in the frame of the world, NaN where there is none; `is_open`: the robot may stand with its middle
    there; `is_reached`: it gets there from the start."""

    spec: GridSpec
    heights: F32
    is_open: Bool
    is_reached: Bool
    scene: RayScene

    def places(self) -> F64:
        """Return where the robot can be, (N, 3)."""
        level, iy, ix = np.nonzero(self.is_reached)
        xy = self.spec.centers_of(np.column_stack((iy, ix)))
        return np.column_stack((xy, self.heights[level, iy, ix])).astype(np.float64)


def reachable_ground(world: WorldSpec, start: SE2, rules: GroundRules) -> ReachableGround:
    """Return the ground that a robot reaches from `start` (in the world's frame); raises BadInputError where it cannot stand there."""
    scene = build_scene(world)
    x0, y0, x1, y1 = world.bounds()
    r = rules.resolution
    origin = np.floor((np.array([x0, y0]) - MARGIN) / r) * r
    shape = np.ceil((np.array([x1, y1]) + MARGIN - origin) / r).astype(int)
    spec = GridSpec(r, int(shape[0]), int(shape[1]), float(origin[0]), float(origin[1]))
    heights = _surfaces(scene, spec, rules.clearance)
    for solid in world.solids:
        _hollow_out(solid, spec, heights)
    is_open = _open(heights, rules)
    labels = _joined(heights, is_open, rules)
    iy, ix = spec.cell_of(start.x, start.y)
    footing = float(np.mean(ground_under_base(world, start, np.array([[0.05, 0.05], [-0.05, -0.05]]))))
    off = np.abs(heights[:, iy, ix] - footing)
    if not np.isfinite(off).any() or not is_open[int(np.nanargmin(off)), iy, ix]:
        raise BadInputError(f"world {world.name}: the robot cannot stand at its start {start.x:g}, {start.y:g} m")
    is_reached = is_open & (labels == labels[int(np.nanargmin(off)), iy, ix])
    return ReachableGround(spec, heights, is_open, is_reached, scene)


def _surfaces(scene: RayScene, spec: GridSpec, clearance: float) -> F32:
    """Return every surface under the sky or another one, with room for the robot above it, highest first."""
    rows, columns = np.divmod(np.arange(spec.width * spec.height), spec.width)
    xy = spec.centers_of(np.column_stack((rows, columns)))
    z = np.full(len(xy), float(scene.solids.bounds[:, 5].max(initial=0.0)) + 1.0)
    z = np.minimum(z, 1e4)
    levels = []
    alive = np.arange(len(xy))
    for _ in range(LEVELS_MOST):
        if not len(alive):
            break
        origins = np.column_stack((xy[alive], z[alive]))
        distance, _, _ = scene.cast(origins, np.tile([0.0, 0.0, -1.0], (len(alive), 1)))
        is_hit = np.isfinite(distance)
        alive, origins, distance = alive[is_hit], origins[is_hit], distance[is_hit]
        hit = origins[:, 2] - distance
        above = np.column_stack((xy[alive], hit + SKIN))
        room, _, _ = scene.cast(above, np.tile([0.0, 0.0, 1.0], (len(alive), 1)), clearance)
        level = np.full(len(xy), np.nan, np.float32)
        is_roomy = ~(room < clearance - SKIN)
        level[alive[is_roomy]] = hit[is_roomy]
        levels.append(level.reshape(spec.shape))
        z[alive] = hit - SKIN
    return np.stack(levels) if levels else np.zeros((0, *spec.shape), np.float32)


def _hollow_out(solid: Solid, spec: GridSpec, heights: F32) -> None:
    """Forget the ground inside a solid: rays pass through its faces from within."""
    half = 0.5 * spec.resolution
    corners = solid.corners()
    low, high = spec.cells_of(np.stack([corners.min(axis=0) - half, corners.max(axis=0) + half]))
    rows = np.arange(max(0, low[0]), min(spec.height, high[0] + 1))
    columns = np.arange(max(0, low[1]), min(spec.width, high[1] + 1))
    iy, ix = (part.ravel() for part in np.meshgrid(rows, columns, indexing="ij"))
    points = solid.world_from_solid.inverse().transform(spec.centers_of(np.column_stack((iy, ix))))
    if solid.shape is Shape.BOX:
        inside = (np.abs(points[:, 0]) <= 0.5 * solid.size_x + half) & (
            np.abs(points[:, 1]) <= 0.5 * solid.size_y + half
        )
    else:
        inside = np.hypot(points[:, 0], points[:, 1]) <= 0.5 * solid.size_x + half
    iy, ix = iy[inside], ix[inside]
    column = heights[:, iy, ix]
    column[(column > solid.z_min - SKIN) & (column < solid.z_max - SKIN)] = np.nan
    heights[:, iy, ix] = column


def _open(heights: F32, rules: GroundRules) -> Bool:
    """Return where everything within the radius is ground that continues the place's own."""
    n = math.ceil(rules.radius / rules.resolution)
    out = np.isfinite(heights)
    for dy in range(-n, n + 1):
        for dx in range(-n, n + 1):
            far = math.hypot(dx, dy) * rules.resolution
            if far > rules.radius + 1e-9 or (dx == 0 and dy == 0):
                continue
            allowed = rules.step + rules.rise * far
            beside = _shifted(heights, dy, dx)
            for level in range(len(heights)):
                with np.errstate(invalid="ignore"):
                    out[level] &= (np.abs(beside - heights[level]) <= allowed).any(axis=0)
    return out


def _joined(heights: F32, is_open: Bool, rules: GroundRules) -> NDArray[np.int32]:
    """Return a number for every piece of ground that hangs together."""
    number = np.arange(heights.size).reshape(heights.shape)
    allowed = rules.step + rules.rise * rules.resolution
    rows, columns = [], []
    for dy, dx in ((0, 1), (1, 0)):
        beside, open_beside, there = (_shifted(a, dy, dx) for a in (heights, is_open, number))
        for level in range(len(heights)):
            with np.errstate(invalid="ignore"):
                meet = (np.abs(beside - heights[level]) <= allowed) & open_beside & is_open[level]
            other, iy, ix = np.nonzero(meet)
            rows.append(number[level, iy, ix])
            columns.append(there[other, iy, ix])
    a, b = np.concatenate(rows), np.concatenate(columns)
    graph = sparse.coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(heights.size, heights.size))
    _, labels = connected_components(graph, directed=False)
    return np.asarray(labels, np.int32).reshape(heights.shape)


def _shifted(values: NDArray[Any], dy: int, dx: int) -> NDArray[Any]:
    """Return what stands `dy` rows and `dx` columns farther, NaN, False or 0 beyond the edge."""
    out = np.zeros_like(values) if values.dtype.kind != "f" else np.full_like(values, np.nan)
    ny, nx = values.shape[1:]
    to = np.s_[:, max(0, -dy) : ny - max(0, dy), max(0, -dx) : nx - max(0, dx)]
    of = np.s_[:, max(0, dy) : ny - max(0, -dy), max(0, dx) : nx - max(0, -dx)]
    out[to] = values[of]
    return out


@dataclass(frozen=True, slots=True, eq=False)
class VisibleSurface:
    """One point (N, 3) of each small cube whose surface is visible, the `eyes` (M, 3) on the ground from which it was looked for, and which points each of them sees."""

    points: F64
    eyes: F64
    seen: tuple[NDArray[np.int64], ...]


def visible_surface(
    ground: ReachableGround,
    height: float,
    reach: float,
    cell: float = 0.4,
    spacing: float = 2.5,
    step: float = math.radians(1.5),
) -> VisibleSurface:
    """Return the surface in cubes of `cell` metres that is seen from the ground that is reached, by an eye `height` metres above it with rays of `reach` metres
    every `step` (rad), on places `spacing` metres apart. What is straight above or below (beyond 55°) does not count."""
    eyes = _spread(ground.places(), spacing)
    elevation = np.arange(-math.radians(55.0), math.radians(55.0), step)
    azimuth = np.arange(-math.pi, math.pi, step)
    e, a = (part.ravel() for part in np.meshgrid(elevation, azimuth))
    rays = np.column_stack((np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)))
    numbers: dict[tuple[int, int, int], int] = {}
    points: list[F64] = []
    seen = []
    for place in eyes:
        eye = place + np.array([0.0, 0.0, height])
        distance, _, _ = ground.scene.cast(np.tile(eye, (len(rays), 1)), rays, reach)
        hits = eye + rays[distance < reach] * distance[distance < reach, None]
        keys, first = np.unique(np.floor(hits / cell).astype(np.int64), axis=0, return_index=True)
        names = [(x, y, z) for x, y, z in keys.tolist()]
        points += [hits[k] for name, k in zip(names, first.tolist(), strict=True) if name not in numbers]
        for name in names:
            numbers.setdefault(name, len(numbers))
        seen.append(np.array([numbers[name] for name in names], np.int64))
    return VisibleSurface(np.array(points).reshape(-1, 3), eyes, tuple(seen))


def _spread(places: F64, spacing: float) -> F64:
    """Return one place of each cube of `spacing` metres."""
    _, first = np.unique(np.floor(places / spacing).astype(np.int64), axis=0, return_index=True)
    return places[np.sort(first)]
