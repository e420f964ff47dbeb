"""Ground truth in a robot's map frame. The simulator tells it in the frame `world`, with the start pose beside it.

A map that the robot made itself begins at its start pose; a drawn map begins at the default start of its world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_UNKNOWN, GridSpec
from ambler.core.messages import OccupancyGrid, PoseStamped
from ambler.core.se2 import SE2
from ambler.runtime.topics import TRUE_START
from ambler.wire.mcap_reader import read_recording

F64 = NDArray[np.float64]
STRAIGHT = 1e-9  # radians from a multiple of a right angle
CELLS_AT_ONCE = 1 << 18


@dataclass(frozen=True, slots=True)
class TruthFrame:
    """Where a map frame lies in the world."""

    world_from_map: SE2

    def pose(self, world_from_base: SE2) -> SE2:
        """Return a true pose in the map frame."""
        return self.world_from_map.inverse() @ world_from_base

    def poses(self, world_from_bases: F64) -> F64:
        """Return true poses (N, 3) of (x, y, yaw) in the map frame."""
        map_from_world = self.world_from_map.inverse()
        yaw = world_from_bases[:, 2] + map_from_world.yaw
        points = map_from_world.transform(world_from_bases[:, :2])
        return np.column_stack([points, (yaw + math.pi) % (2.0 * math.pi) - math.pi])

    def grid(self, grid: OccupancyGrid) -> tuple[GridSpec, NDArray[np.int8]]:
        """Return the true map in the map frame: the same cells while the frames are turned by right angles, else by nearest cells."""
        map_from_world = self.world_from_map.inverse()
        quarters = round(map_from_world.yaw / (0.5 * math.pi))
        if abs(map_from_world.yaw - 0.5 * math.pi * quarters) < STRAIGHT:
            return _turned(grid, map_from_world, quarters % 4)
        return _sampled(grid, self.world_from_map)


def start_frame(recording: Path) -> TruthFrame:
    """Return the frame of the start pose that a recording tells; raises BadInputError when it tells none."""
    for recorded in read_recording(recording, [TRUE_START.ros_name]):
        return TruthFrame(recorded.decode_as(PoseStamped).pose.to_se2())
    raise BadInputError(f"{recording}: does not tell where in the world the robot started ({TRUE_START.ros_name})")


def _corners(spec: GridSpec) -> F64:
    x0, y0 = spec.origin_x, spec.origin_y
    x1, y1 = x0 + spec.width * spec.resolution, y0 + spec.height * spec.resolution
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def _turned(grid: OccupancyGrid, map_from_world: SE2, quarters: int) -> tuple[GridSpec, NDArray[np.int8]]:
    low = map_from_world.transform(_corners(grid.spec)).min(axis=0)
    cells = np.ascontiguousarray(
        np.rot90(grid.data, -quarters)
    )  # rows count upwards: what turns left here is rot90 backwards
    return GridSpec(grid.spec.resolution, cells.shape[1], cells.shape[0], float(low[0]), float(low[1])), cells


def _sampled(grid: OccupancyGrid, world_from_map: SE2) -> tuple[GridSpec, NDArray[np.int8]]:
    resolution = grid.spec.resolution
    corners = world_from_map.inverse().transform(_corners(grid.spec))
    low = np.floor(corners.min(axis=0) / resolution) * resolution
    width, height = np.ceil((corners.max(axis=0) - low) / resolution).astype(int).tolist()
    spec = GridSpec(resolution, width, height, float(low[0]), float(low[1]))
    out = np.full(spec.shape, OCC_UNKNOWN, np.int8)
    rows = max(1, CELLS_AT_ONCE // max(1, width))
    for begin in range(0, height, rows):
        part = out[begin : begin + rows]
        cells = np.argwhere(np.ones(part.shape, np.bool_)) + np.array([begin, 0])
        source = grid.spec.cells_of(world_from_map.transform(spec.centers_of(cells)))
        inside = (source >= 0).all(axis=1) & (source < np.array(grid.spec.shape)).all(axis=1)
        part.ravel()[inside] = grid.data[source[inside, 0], source[inside, 1]]
    return spec, out
