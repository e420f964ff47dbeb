"""The ground-truth map: a planar cut of the world at the sensor's height, as a perfect mapper would draw it.

The height counts from the ground at the start pose: a scanner that stays level there. Terrain is solid below its surface; of a mesh
the cells that its surface crosses are solid, and of a closed one its inside too.

Free is what can be reached from the start through free cells; occupied are the cells that hold a surface next to it;
everything else is unknown. Grids are in the frame of the world that is given: `WorldSpec.from_start` for a drawn map.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN, GridSpec
from ambler.core.se2 import SE2
from ambler.sim.mesh_cut import draw_mesh, draw_terrain
from ambler.sim.solids import Shape, Solid, WorldSpec

REACHED = 2  # how a flood marks cells
SAMPLES = 5
SAMPLES_AT_ONCE = 1_000_000  # a wall that stands aslant in a hall of 100 m lies in a box of 100 million
MARGIN = 0.5


def truth_grid(world: WorldSpec, sensor_height: float, resolution: float) -> tuple[GridSpec, NDArray[np.int8]]:
    """Return the true map as a grid spec and occupancy int8 [iy, ix]; raises BadInputError if the start is not free."""
    spec, solid = cut(world, _start_height(world) + sensor_height, resolution)
    iy, ix = spec.cell_of(world.start.x, world.start.y)
    if not spec.contains_cell(iy, ix):
        raise BadInputError(f"world {world.name}: the start pose lies outside of all that stands in it")
    if solid[iy, ix]:
        raise BadInputError(f"world {world.name}: the start pose lies in a solid")
    regions, _ = ndimage.label(~solid)
    free = regions == regions[iy, ix]
    out = np.full(spec.shape, OCC_UNKNOWN, np.int8)
    out[free] = OCC_FREE
    out[solid & ndimage.binary_dilation(free)] = OCC_OCCUPIED
    return spec, out


def reachable_cells(
    world: WorldSpec, radius: float, resolution: float, height: float
) -> tuple[GridSpec, NDArray[np.bool_]]:
    """Return where the centre of a disc of `radius` metres can get from the start, bool [iy, ix]."""
    spec, solid = cut(world, _start_height(world) + height, resolution)
    clear = ndimage.distance_transform_edt(~solid) * resolution > radius
    iy, ix = spec.cell_of(world.start.x, world.start.y)
    regions, _ = ndimage.label(clear)
    reached = (regions == regions[iy, ix]) & clear
    return spec, np.asarray(reached)


def reachable_floor(
    world: WorldSpec, radius: float, resolution: float, heights: tuple[float, float]
) -> tuple[GridSpec, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where an upright cylinder of `radius` metres, that reaches from one height above the floor to another, can be and where its axis
    can get from the start, both bool [iy, ix]. Only upright solids count."""
    low, high = heights
    in_the_way = tuple(replace(s, z_min=0.0, z_max=1.0) for s in world.solids if s.z_min < high and s.z_max > low)
    spec, solid = cut(replace(world, solids=in_the_way), 0.5, resolution)
    clear = np.asarray(distance_to_solid(solid, resolution) > radius)
    iy, ix = spec.cell_of(world.start.x, world.start.y)
    if not spec.contains_cell(iy, ix) or not clear[iy, ix]:
        return spec, clear, np.zeros_like(clear)
    reached = clear.astype(np.uint8)
    cv2.floodFill(reached, None, (ix, iy), REACHED, flags=4)
    return spec, clear, np.asarray(reached == REACHED)


def distance_to_solid(solid: NDArray[np.bool_], resolution: float) -> NDArray[np.float32]:
    """Return each cell's distance to the nearest solid cell, metres, float32 [iy, ix]."""
    distance = cv2.distanceTransform((~solid).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    np.multiply(distance, resolution, out=distance)
    return np.asarray(distance, np.float32)


def cut(world: WorldSpec, height: float, resolution: float) -> tuple[GridSpec, NDArray[np.bool_]]:
    """Cut everything at z = `height`: a cell is solid if any of its 5 x 5 sample points lies in a solid; bool [iy, ix]."""
    spec = _grid_around(world, resolution)
    out = np.zeros(spec.shape, np.bool_)
    for solid in world.solids:
        if solid.z_min <= height <= solid.z_max:
            _draw(solid, spec, out)
    for mesh in world.meshes:
        draw_mesh(mesh, height, spec, SAMPLES, out)
    if world.terrain is not None:
        draw_terrain(world.terrain, height, spec, SAMPLES, out)
    return spec, out


def _start_height(world: WorldSpec) -> float:
    """The height of the ground at the start pose of the world."""
    return 0.0 if world.is_flat else float(world.ground_at(np.array([[world.start.x, world.start.y]]))[0])


def _grid_around(world: WorldSpec, resolution: float) -> GridSpec:
    """The start pose lies on a corner of a cell, as it does in the map of a robot that starts there."""
    x0, y0, x1, y1 = world.bounds()
    start = world.start
    ix0, iy0 = math.floor((x0 - start.x - MARGIN) / resolution), math.floor((y0 - start.y - MARGIN) / resolution)
    ix1, iy1 = math.ceil((x1 - start.x + MARGIN) / resolution), math.ceil((y1 - start.y + MARGIN) / resolution)
    return GridSpec(resolution, ix1 - ix0, iy1 - iy0, start.x + ix0 * resolution, start.y + iy0 * resolution)


def _draw(solid: Solid, spec: GridSpec, out: NDArray[np.bool_]) -> None:
    corners = solid.corners()
    low, high = spec.cells_of(np.stack([corners.min(axis=0), corners.max(axis=0)]))
    columns = np.arange(low[1], high[1] + 1)
    step = max(1, SAMPLES_AT_ONCE // (SAMPLES**2 * len(columns)))
    for first in range(int(low[0]), int(high[0]) + 1, step):
        rows = np.arange(first, min(first + step, int(high[0]) + 1))
        out[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] |= _covered(solid, spec, rows, columns)


def _covered(solid: Solid, spec: GridSpec, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which cells of some rows and columns have a sample in a solid, bool [iy, ix]."""
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES
    x = spec.origin_x + (columns[:, None] + offsets).ravel() * spec.resolution
    y = spec.origin_y + (rows[:, None] + offsets).ravel() * spec.resolution
    px, py = _local(solid.world_from_solid, x[None, :], y[:, None])
    if solid.shape is Shape.BOX:
        # a wall thinner than the samples' distance would pass between them
        least = 0.51 * spec.resolution / SAMPLES
        half_x, half_y = max(0.5 * solid.size_x, least), max(0.5 * solid.size_y, least)
        inside = (np.abs(px) <= half_x) & (np.abs(py) <= half_y)
    else:
        inside = px * px + py * py <= (0.5 * solid.size_x) ** 2
    return np.asarray(inside.reshape(len(rows), SAMPLES, len(columns), SAMPLES).any(axis=(1, 3)))


def _local(
    pose: SE2, x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return c * (x - pose.x) + s * (y - pose.y), -s * (x - pose.x) + c * (y - pose.y)
