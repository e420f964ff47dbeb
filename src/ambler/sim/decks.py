"""A car park with two decks and a ramp, drawn by a seed: columns on a grid, cars, service rooms; both decks are built alike."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.sim.meshes import TriangleMesh
from ambler.sim.sensors import named_generator
from ambler.sim.site import HAND, Site
from ambler.sim.solids import Shape, Solid, WorldSpec

F64 = NDArray[np.float64]
STOREY, SLAB = 3.5, 0.3
LANE, GATE = 5.0, 4.0  # metres: width of the ramp outside, of the openings that lead to it
INSET = 7.0  # metres from the walls to the way on a deck


def draw_decks(seed: int, length: float) -> Site:
    """Draw a car park through whose lower deck, ramp and upper deck a way of about `length` metres leads."""
    rng = named_generator(seed, "decks")
    depth = float(rng.uniform(29.0, 36.0))
    ramp = float(rng.uniform(24.0, 28.0))
    width = max(ramp + 24.0, 0.25 * (length - ramp) - depth + 4.0 * INSET)
    gate, top = 0.5 * INSET + 2.5, 0.5 * INSET + 2.5 + GATE + ramp
    solids = [*_shell(width, depth, gate, top)]
    solids += [
        _box("column", x, y, 0.5, 0.5, z, z + STOREY - SLAB)
        for z in (0.0, STOREY)
        for x in np.arange(INSET + 3.5, width - INSET - 3.0, 7.5)
        for y in (0.5 * depth - 4.5, 0.5 * depth + 4.5)
    ]
    solids += _parked(rng, width, depth, gate, top)
    slope = TriangleMesh("ramp", *_plane(gate + 0.5 * GATE, top - 0.5 * GATE))
    way = _way(width, depth, gate, top)
    world = WorldSpec(f"decks-{seed}", tuple(solids), SE2(float(way[0, 0]), float(way[0, 1]), 0.0), meshes=(slope,))
    return Site(world, way, is_closed=False)


def _shell(width: float, depth: float, gate: float, top: float) -> list[Solid]:
    """Slabs, outer walls with an opening on each deck, and what the ramp lands on."""
    out = [_box("slab", 0.5 * width, 0.5 * depth, width, depth, z - SLAB, z) for z in (STOREY, 2.0 * STOREY)]
    landing = top + 0.5 * GATE
    out.append(_box("slab", top, -0.5 * LANE, GATE + 0.02, LANE, STOREY - SLAB, STOREY))
    for z, hole in ((0.0, gate), (STOREY, top)):
        high = z + STOREY - SLAB
        out += [_box("wall", x, 0.5 * depth, 0.3, depth + 0.6, z, high) for x in (-0.15, width + 0.15)]
        out.append(_box("wall", 0.5 * width, depth + 0.15, width, 0.3, z, high))
        left, right = hole - 0.5 * GATE, hole + 0.5 * GATE
        out.append(_box("wall", 0.5 * left, -0.15, left, 0.3, z, high))
        out.append(_box("wall", 0.5 * (right + width), -0.15, width - right, 0.3, z, high))
    out.append(_box("wall", 0.5 * (landing + gate), -LANE - 0.15, landing - gate + 6.0, 0.3, 0.0, STOREY + 1.1))
    out.append(_box("wall", landing + 0.15, -0.5 * LANE, 0.3, LANE, 0.0, STOREY + 1.1))
    return out


def _parked(rng: np.random.Generator, width: float, depth: float, gate: float, top: float) -> list[Solid]:
    """Cars along the walls and in the middle, some places empty, and some boxes and rooms; different ones on each deck."""
    out: list[Solid] = []
    number = 0
    for z, hole in ((0.0, gate), (STOREY, top)):
        rows = ((2.8, 0.5 * math.pi), (0.5 * depth, 0.5 * math.pi), (depth - 2.8, 0.5 * math.pi))
        for y, yaw in rows:
            for x in np.arange(3.0, width - 2.0, 2.8):
                if (y < 3.0 and abs(x - hole) < 0.5 * GATE + 1.5) or (y == rows[1][0] and not 12.0 < x < width - 12.0):
                    continue
                kind = rng.random()
                number += 1
                here = SE2(
                    float(x) + float(rng.normal(0.0, 0.15)),
                    y + float(rng.normal(0.0, 0.2)),
                    yaw + float(rng.normal(0.0, 0.03)),
                )
                if kind < 0.45:
                    long, tall = float(rng.uniform(3.8, 4.8)), float(rng.uniform(1.3, 1.8))
                    out.append(Solid(f"car-{number}", Shape.BOX, here, long, 1.8, z + 0.2, z + 0.9))
                    cabin = here @ SE2(float(rng.choice([-0.4, 0.4])), 0.0, 0.0)
                    out.append(Solid(f"cabin-{number}", Shape.BOX, cabin, 0.5 * long, 1.6, z + 0.9, z + tall))
                elif kind < 0.52:
                    room, high = float(rng.uniform(1.5, 2.4)), float(rng.uniform(1.0, STOREY - SLAB))
                    out.append(Solid(f"store-{number}", Shape.BOX, here, 3.0, room, z, z + high))
    return out


def _plane(low: float, high: float) -> tuple[F64, NDArray[np.int32]]:
    vertices = np.array([[low, -LANE, 0.0], [high, -LANE, STOREY], [high, 0.0, STOREY], [low, 0.0, 0.0]])
    return vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def _way(width: float, depth: float, gate: float, top: float) -> F64:
    """A round of the lower deck, out, up the ramp, in, and a round of the upper deck."""
    low, far, end = INSET, depth - INSET, width - INSET
    lane, up = -0.5 * LANE, STOREY
    below = [(gate + 3.0, low, 0.0), (end, low, 0.0), (end, far, 0.0), (gate, far, 0.0), (gate, lane, 0.0)]
    climb = [(gate + 0.5 * GATE, lane, 0.0), (top - 0.5 * GATE, lane, up), (top, lane, up)]
    above = [(top, low, up), (end, low, up), (end, far, up), (INSET, far, up), (INSET, low, up), (top - 3.0, low, up)]
    corners = np.array([*below, *climb, *above])
    pieces = []
    for a, b in itertools.pairwise(corners):
        count = max(1, round(float(np.linalg.norm(b - a)) / 2.5))
        pieces.append(a + (b - a) * (np.arange(count) / count)[:, None])
    way = np.vstack([*pieces, corners[-1:]])
    # Corners are cut a little: nobody turns on the spot.
    way[1:-1] = 0.25 * way[:-2] + 0.5 * way[1:-1] + 0.25 * way[2:]
    return np.asarray(way + np.array([0.0, 0.0, HAND]))


def _box(name: str, x: float, y: float, size_x: float, size_y: float, low: float, high: float) -> Solid:
    return Solid(name, Shape.BOX, SE2(float(x), float(y), 0.0), float(size_x), float(size_y), low, high)
