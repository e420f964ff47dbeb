"""Where a robot can get to in a place with rolling ground: on slopes that it can climb, beside what stands there."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.sim.generator.floor import HEIGHTS, RADIUS, Floor, floor_of
from ambler.sim.solids import Shape, WorldSpec
from ambler.sim.truth import distance_to_solid

RESOLUTION = 0.25
STEEPEST = math.tan(math.radians(20.0))
OVER_GROUND = (HEIGHTS[0], 1.3)  # metres over the ground between which a thing is in the way


def spatial_floor(world: WorldSpec) -> Floor:
    """Return where a disc of 0.45 m can be and get to from the start. Of a place without rolling ground the lowest level counts."""
    if world.terrain is None:
        x0, y0, x1, y1 = world.bounds()
        return floor_of(world, (x1 - x0) * (y1 - y0))
    x0, y0, x1, y1 = world.bounds()
    spec = GridSpec(RESOLUTION, math.ceil((x1 - x0) / RESOLUTION), math.ceil((y1 - y0) / RESOLUTION), x0, y0)
    cells = np.stack(np.meshgrid(np.arange(spec.height), np.arange(spec.width), indexing="ij"), axis=-1).reshape(-1, 2)
    points = spec.centers_of(cells)
    ground = world.terrain.heights_at(points).reshape(spec.shape)
    rise_y, rise_x = np.gradient(ground, RESOLUTION)
    is_steep = ~(np.hypot(rise_x, rise_y) < STEEPEST)  # NaN beyond the ground's edge
    solid = is_steep | _in_the_way(world, spec, ground)
    clear = np.asarray(distance_to_solid(solid, RESOLUTION) > RADIUS)
    _, regions = cv2.connectedComponents(clear.astype(np.uint8), connectivity=4)
    start = spec.cell_of(world.start.x, world.start.y)
    reached = (regions == regions[start]) & clear if clear[start] else np.zeros_like(clear)
    return Floor(spec, clear, reached)


def _in_the_way(world: WorldSpec, spec: GridSpec, ground: NDArray[np.float64]) -> NDArray[np.bool_]:
    out = np.zeros(spec.shape, np.bool_)
    for solid in world.solids:
        corners = solid.corners()
        low, high = spec.cells_of(np.stack([corners.min(axis=0), corners.max(axis=0)]))
        rows = np.arange(max(low[0], 0), min(high[0] + 1, spec.height))
        columns = np.arange(max(low[1], 0), min(high[1] + 1, spec.width))
        if not len(rows) or not len(columns):
            continue
        cells = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
        local = solid.world_from_solid.inverse().transform(spec.centers_of(cells))
        half = 0.5 * np.array([solid.size_x, solid.size_y]) + 0.5 * RESOLUTION
        is_round = solid.shape is Shape.CYLINDER
        inside = np.hypot(*local.T) <= half[0] if is_round else (np.abs(local) <= half).all(axis=1)
        there = ground[cells[:, 0], cells[:, 1]]
        inside &= (solid.z_min < there + OVER_GROUND[1]) & (solid.z_max > there + OVER_GROUND[0])
        out[cells[inside, 0], cells[inside, 1]] = True
    return out
