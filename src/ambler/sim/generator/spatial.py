"""Places with three dimensions for robots: sites outdoors, garages of two levels, tunnels; each with a route through it.

Sites and tunnels are those of `sim.site`, where a hand carries a sensor; here kerbs, stairs and people come along them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.sim.meshes import HeightField, TriangleMesh
from ambler.sim.sensors import named_generator
from ambler.sim.site import MARGIN, draw_site, draw_tunnel
from ambler.sim.solids import Person, Shape, Solid, WorldSpec

F64 = NDArray[np.float64]
SITE_LENGTH, TUNNEL_LENGTH, PLOT_LENGTH = 300.0, 150.0, 110.0  # metres of the way through them
SITE_MARGIN, PLOT_MARGIN = MARGIN, 12.0  # metres of ground beyond the way
STEEPNESS = 1.8  # of a hand's sites, so that a way of 300 m leads over slopes of some ten degrees
KERB = (0.12, 0.15, 1.5)  # height over the ground, width, length of a stone (m)
KERB_BESIDE = 2.0  # metres from the way to the kerb's middle
STOREY = 3.0
RAMP = math.radians(9.0)  # as steep as car parks are at most
AISLE = 4.5  # metres
BAY = (2.5, 5.0)
PARKED = 0.55
WALL_PIECE = 2.0  # metres of a wall that are built at one height


def plot(seed: int) -> WorldSpec:
    """Draw a site outdoors that is small enough to be explored in minutes, with a wall around it."""
    drawn = _site(seed, PLOT_LENGTH, PLOT_MARGIN)
    assert drawn.terrain is not None
    return replace(drawn, solids=(*drawn.solids, *_enclosure(drawn.terrain)))


def site(seed: int) -> WorldSpec:
    """Draw a site outdoors about a loop of 300 m."""
    return _site(seed, SITE_LENGTH, SITE_MARGIN)


def _site(seed: int, length: float, margin: float) -> WorldSpec:
    """Draw rolling ground, houses, trees, poles, cars and walls about a loop, kerbs along parts of it, steps
    before houses, and people who walk across the slopes."""
    drawn = draw_site(seed, length, STEEPNESS, margin)
    rng = named_generator(seed, "robots' site")
    way, world = drawn.way[:, :2], drawn.world
    assert world.terrain is not None
    solids = [*world.solids, *_kerbs(rng, way, world.terrain), *_stairs(rng, world)]
    closed = np.vstack([way, way[:1]])
    people = tuple(_stroller(rng, k, way) for k in range(3))
    roofs = tuple(_closed_below(roof) for roof in world.meshes)
    return replace(_with_route(world, closed), solids=tuple(solids), people=people, meshes=roofs)


def tunnel(seed: int) -> WorldSpec:
    """Draw a smooth straight tunnel of 150 m between two yards."""
    drawn = draw_tunnel(seed, TUNNEL_LENGTH)
    return _with_route(drawn.world, drawn.way[:, :2])


def garage(seed: int) -> WorldSpec:
    """Draw a car park of two levels with columns and parked cars, joined by a ramp along one side."""
    rng = named_generator(seed, "garage")
    run = STOREY / math.tan(RAMP)
    length, width = run + 2.0 * float(rng.uniform(6.5, 9.0)), 2.0 * BAY[1] + AISLE + float(rng.uniform(0.0, 3.0))
    low, high = 0.5 * (length - run), 0.5 * (length + run)  # where the ramp begins and ends, along x
    strip = (width, width + AISLE)
    solids = _shell(length, strip[1])
    solids += [
        _box("parapet", 0.5 * (low + high), width - 0.1, run, 0.2, 0.0, STOREY + 1.1),
        _box("stop", high + 0.1, 0.5 * sum(strip), 0.2, AISLE, 0.0, STOREY - 0.03),
        _box("slab", 0.5 * (high + length), 0.5 * sum(strip), length - high, AISLE, STOREY - 0.3, STOREY - 0.03),
        _box("rail", 0.5 * low, width + 0.1, low, 0.2, STOREY, STOREY + 1.1),
        _box("slab", 0.5 * length, 0.5 * width, length, width, STOREY - 0.3, STOREY - 0.03),
        _box("roof", 0.5 * length, 0.5 * strip[1], length, strip[1], 2 * STOREY - 0.3, 2 * STOREY),
    ]
    meshes = [
        *_tiles("level", (0.0, 0.0), (length, width), (STOREY, STOREY)),
        *_tiles("ramp", (low, strip[0]), (high, strip[1]), (0.0, STOREY)),
        *_tiles("landing", (high, strip[0]), (length, strip[1]), (STOREY, STOREY)),
    ]
    solids += _columns(length, width) + _parked(rng, length, width)
    lane, side = 0.5 * width, 0.5 * sum(strip)
    first, last = 0.5 * low, 0.5 * (high + length)
    lap = [(first, lane), (last, lane), (first, lane)]
    ramp = [(first, side), (low, side), (high, side), (last, side)]
    route = np.array([*lap, *ramp, (last, lane), (first, lane), (last, lane), *ramp[::-1], (first, lane)])
    world = WorldSpec(f"garage-{seed}", tuple(solids), SE2(), meshes=tuple(meshes))
    return _with_route(world, route)


SPATIAL_KINDS: dict[str, Callable[[int], WorldSpec]] = {"site": site, "plot": plot, "garage": garage, "tunnel": tunnel}


def _closed_below(roof: TriangleMesh) -> TriangleMesh:
    """A gabled roof with a ceiling between its eaves: what is seen from outside only meets the same rays in every simulator."""
    ceiling = np.array([[0, 2, 1], [0, 3, 2]], np.int32)
    return replace(roof, triangles=np.concatenate([roof.triangles, ceiling]))


def _with_route(world: WorldSpec, route: F64) -> WorldSpec:
    """Begin at the route's first waypoint, looking at the second."""
    (x, y), (ahead_x, ahead_y) = route[:2].tolist()
    start = SE2(round(x, 3), round(y, 3), math.atan2(ahead_y - y, ahead_x - x))
    return replace(world, start=start, route=tuple((round(a, 3), round(b, 3)) for a, b in route.tolist()))


def _enclosure(terrain: HeightField) -> list[Solid]:
    """A wall a metre inside the edge of the ground, which it follows."""
    corners = terrain.outline
    low, high = corners.min(axis=0) + 1.0, corners.max(axis=0) - 1.0
    walls = []
    for axis in (0, 1):
        at = np.arange(low[axis] + 0.5 * WALL_PIECE, high[axis] + 0.5 * WALL_PIECE, WALL_PIECE)
        for side in (low[1 - axis], high[1 - axis]):
            for middle in at.tolist():
                place = (middle, side) if axis == 0 else (side, middle)
                ground = float(terrain.heights_at(np.clip(np.array([place]), low, high))[0])
                size = (WALL_PIECE + 0.1, 0.2) if axis == 0 else (0.2, WALL_PIECE + 0.1)
                walls.append(_box("wall", *place, *size, ground - 2.0, ground + 2.2))
    return walls


def _kerbs(rng: np.random.Generator, way: F64, terrain: HeightField) -> list[Solid]:
    """Rows of stones beside the way, on its left or right, for a third of it."""
    stones = []
    count = len(way)
    for begin in range(0, count, 6):
        side = float(rng.choice([-1.0, 1.0]))
        if rng.random() < 0.45:
            continue
        for k in range(begin, min(begin + 4, count)):
            a, b = way[k], way[(k + 1) % count]
            ahead = (b - a) / float(np.linalg.norm(b - a))
            left = np.array([-ahead[1], ahead[0]])
            for at in np.arange(0.5 * KERB[2], float(np.linalg.norm(b - a)), KERB[2]):
                x, y = a + at * ahead + side * KERB_BESIDE * left
                ground = float(terrain.heights_at(np.array([[x, y]]))[0])
                yaw = math.atan2(ahead[1], ahead[0])
                stones.append(_box("kerb", x, y, KERB[2], KERB[1], ground - 0.4, ground + KERB[0], yaw))
    return stones


def _stairs(rng: np.random.Generator, world: WorldSpec) -> list[Solid]:
    """Three steps of 17 cm before the long side of some houses."""
    assert world.terrain is not None
    steps: list[Solid] = []
    for house in world.solids:
        if not house.name.startswith("house") or rng.random() < 0.6:
            continue
        for k in range(3):
            pose = house.world_from_solid @ SE2(0.0, 0.5 * house.size_y + 0.3 * (k + 0.5), 0.0)
            ground = float(np.nan_to_num(world.terrain.heights_at(np.array([[pose.x, pose.y]]))[0]))
            steps.append(_box("steps", pose.x, pose.y, 1.6, 0.3, ground - 1.0, ground + 0.17 * (3 - k), pose.yaw))
    return steps


def _stroller(rng: np.random.Generator, number: int, way: F64) -> Person:
    """Somebody who walks to and fro 1.6 m beside a piece of the way."""
    k = int(rng.integers(len(way)))
    side = float(rng.choice([-1.0, 1.0]))
    points = []
    for j in range(k, k + 3):
        a, b = way[j % len(way)], way[(j + 1) % len(way)]
        ahead = (b - a) / float(np.linalg.norm(b - a))
        x, y = a + side * 1.6 * np.array([-ahead[1], ahead[0]])
        points.append((round(float(x), 2), round(float(y), 2)))
    there_and_back = (*points, *points[-2:0:-1])
    return Person(f"stroller-{number}", there_and_back, round(float(rng.uniform(0.9, 1.4)), 2))


def _shell(length: float, width: float) -> list[Solid]:
    """Four outer walls over both levels."""
    top = 2.0 * STOREY
    sides = [_box("wall", 0.5 * length, y, length + 0.5, 0.25, 0.0, top) for y in (-0.125, width + 0.125)]
    return sides + [_box("wall", x, 0.5 * width, 0.25, width + 0.5, 0.0, top) for x in (-0.125, length + 0.125)]


def _columns(length: float, width: float) -> list[Solid]:
    """Columns between the bays and the aisle, every third bay, on both levels."""
    out = []
    for x in np.arange(3.0 * BAY[0], length - 2.0 * BAY[0], 3.0 * BAY[0]):
        for y in (BAY[1], width - BAY[1]):
            out.append(_box("column", float(x), y, 0.4, 0.4, 0.0, STOREY - 0.3))
            out.append(_box("column", float(x), y, 0.4, 0.4, STOREY, 2.0 * STOREY - 0.3))
    return out


def _parked(rng: np.random.Generator, length: float, width: float) -> list[Solid]:
    """Cars in the bays at both sides of the aisle, but for the ends of the level, where one turns towards the ramp."""
    out = []
    for level in (0.0, STOREY):
        for x in np.arange(0.5 * BAY[0], length - 0.5 * BAY[0], BAY[0]):
            for y in (0.5 * BAY[1], width - 0.5 * BAY[1]):
                is_turn = y > BAY[1] and not AISLE + 6.0 < x < length - AISLE - 6.0
                if is_turn or rng.random() > PARKED:
                    continue
                sx, sy = 1.8 + 0.1 * float(rng.standard_normal()), 4.2 + 0.2 * float(rng.standard_normal())
                at = (float(x) + 0.1 * float(rng.standard_normal()), y + 0.15 * float(rng.standard_normal()))
                out.append(_box("car", *at, sx, sy, level + 0.15, level + 0.9))
                out.append(_box("cabin", *at, 0.9 * sx, 0.5 * sy, level + 0.9, level + 1.45))
    return out


def _tiles(
    name: str, low: tuple[float, float], high: tuple[float, float], z: tuple[float, float]
) -> list[TriangleMesh]:
    """A plate over a rectangle that rises along x from one height to another, in pieces of at most 6 m: contact is exact on small ones."""
    counts = [max(1, math.ceil((b - a) / 6.0)) for a, b in zip(low, high, strict=True)]
    x, y = (np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True))
    nx = counts[0] + 1
    heights = z[0] + (z[1] - z[0]) * (x - low[0]) / (high[0] - low[0])
    vertices = np.array([[px, py, pz] for py in y for px, pz in zip(x, heights, strict=True)])
    corners = [
        (j * nx + i, j * nx + i + 1, (j + 1) * nx + i + 1, (j + 1) * nx + i)
        for j in range(counts[1])
        for i in range(counts[0])
    ]
    triangles = np.array([t for a, b, c, d in corners for t in ((a, b, c), (a, c, d))], np.int32)
    return [TriangleMesh(name, vertices, triangles)]


def _box(
    name: str, x: float, y: float, size_x: float, size_y: float, low: float, high: float, yaw: float = 0.0
) -> Solid:
    return Solid(name, Shape.BOX, SE2(float(x), float(y), yaw), float(size_x), float(size_y), low, high)
