"""Terrain analysis: out of registered clouds the ground that a robot can cross, and what it cannot (after CMU's terrain_analysis, in a way of its own).

A rolling window of columns keeps what was seen. The ground is grown from under the robot over the low quartiles of cells that continue one
another, so that table tops, ceilings and upper floors are not taken for it; gaps are bridged within what a mount may be off by. Steps
are judged against the slopes beside them, drops by ground that goes on lower behind an edge and by rays that pass where ground should be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se3 import SE3
from ambler.kernels import terrain_columns as columns
from ambler.kernels import terrain_edges, terrain_ground, terrain_stairs, terrain_steps
from ambler.perception.terrain_config import TerrainConfig

F32 = NDArray[np.float32]
MARCH = 0.1  # metres of a step from cell to cell outwards


class Ground(IntEnum):
    """What a cell is; the numbers are the kernels'."""

    UNKNOWN = terrain_ground.UNKNOWN
    GROUND = terrain_ground.GROUND
    OBSTACLE = terrain_ground.OBSTACLE
    DROP = terrain_ground.DROP
    STEEP = terrain_ground.STEEP
    STAIRS = terrain_ground.STAIRS


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """What is known around the robot, in the odom frame: `classes` uint8 [iy, ix] of `Ground`, `heights` float32 [iy, ix] of the ground
    (NaN: not known; of unseen cells what is carried over to them), and `points` float32 (N, 4): x, y, z and height above the ground, which of
    what cannot be crossed is at least the configured step; `kinds` uint8 (N,): the `Ground` of a point that stands for a cell, 0 for a voxel."""

    spec: GridSpec
    classes: NDArray[np.uint8]
    heights: F32
    points: F32
    kinds: NDArray[np.uint8]


class TerrainAnalysis:
    """`update` it with every cloud, then ask for `terrain`. Its memory is that of its window, whatever comes."""

    def __init__(self, config: TerrainConfig) -> None:
        self.config = config
        n, m = config.columns, config.columns // 2
        self._first = np.zeros(2, np.int64)
        self._voxels = np.zeros((columns.BINS, n, n, 4), np.float32)
        self._mask = np.zeros((n, n), np.uint32)
        self._newest = np.full((n, n), -1e9, np.float32)
        self._image = np.full((columns.DIRECTIONS, columns.ROWS, 2), np.inf, np.float32)
        self._lows, self._highs, self._returns, self._ground, self._excess, self._depths, self._memory = (
            np.full((m, m), np.nan, np.float32) for _ in range(7)
        )
        self._slopes, self._sure = np.zeros((2, m, m), np.float32), np.zeros((m + 8, m + 8), np.float32)
        self._state, self._classes, self._evidence, self._touched, self._changed = (
            np.zeros((m, m), np.uint8) for _ in range(5)
        )
        self._gap = np.zeros((m, m), np.int32)
        self._queue, self._later = np.zeros(2 * m * m, np.int32), np.zeros(m * m, np.int32)
        self._begin_ns: int | None = None
        self._turn = 0
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._mask[:], self._newest[:], self._evidence[:] = 0, -1e9, 0
        self._ground[:], self._lows[:], self._depths[:], self._state[:] = np.nan, np.nan, 0.0, 0
        self._memory[:], self._excess[:] = np.nan, 0.0

    def forget(self, x: float, y: float, radius: float) -> None:
        """Forget what was seen within a radius (m) of a place in the odom frame."""
        c = self.config
        for size, cell, first, arrays in (
            (c.columns, c.voxel, self._first, ((self._mask, 0), (self._newest, -1e9))),
            (
                c.columns // 2,
                c.cell,
                self._first // 2,
                ((self._evidence, 0), (self._depths, 0.0), (self._excess, 0.0), (self._state, 0), (self._classes, 0)),
            ),
            (
                c.columns // 2,
                c.cell,
                self._first // 2,
                ((self._ground, np.nan), (self._lows, np.nan), (self._memory, np.nan)),
            ),
        ):
            ix, iy = first[0] + np.arange(size), first[1] + np.arange(size)
            is_near = np.hypot((ix[None, :] + 0.5) * cell - x, (iy[:, None] + 0.5) * cell - y) <= radius
            rows, cols = np.nonzero(is_near)
            for array, nothing in arrays:
                array[iy[rows] % size, ix[cols] % size] = nothing

    def remember(self, points: F32) -> None:
        """Take firm ground, points (N, 3) in the odom frame, in place of what was told before: where a robot has driven there is ground, whether it is seen now or not. Of
        several points in a cell the last one counts."""
        c, m = self.config, self.config.columns // 2
        self._memory[:] = np.nan
        cells = np.floor(points[:, :2].astype(np.float64) / c.cell).astype(np.int64)
        first = self._first // 2
        is_inside = ((cells >= first) & (cells < first + m)).all(axis=1)
        ix, iy = (cells[is_inside] % m).T
        self._memory[iy, ix] = points[is_inside, 2]

    def update(
        self,
        points: F32,
        stamp_ns: int,
        odom_from_base: SE3,
        odom_from_sensor: SE3,
        elevation: tuple[float, float] = (-math.pi, math.pi),
    ) -> None:
        """Take a cloud (N, 3) in the odom frame, where base and sensor were at its end, and the elevations (rad) that the sensor sees.

        The base is on the ground, give or take what its mount is off by. Raises BadInputError for a cloud of another shape.
        """
        if points.ndim != 2 or points.shape[1] != 3:
            raise BadInputError(f"a cloud for the terrain has the shape (N, 3), not {points.shape}")
        c, base, origin = self.config, np.array(odom_from_base.translation), np.array(odom_from_sensor.translation)
        self._begin_ns = stamp_ns if self._begin_ns is None else self._begin_ns
        # Rounded as the columns hold it: what is seen now is not older than now.
        now = float(np.float32((stamp_ns - self._begin_ns) * 1e-9))
        self._roll(base)
        limits = np.array([c.above + c.clearance, c.above_slope, c.below, c.below_slope, c.own_radius])
        store = (self._first, c.voxel, self._ground, self._voxels, self._mask, self._newest, self._image, self._touched)
        columns.insert(np.ascontiguousarray(points, np.float32), origin, base, now, limits, *store)
        up = np.ascontiguousarray(odom_from_sensor.matrix()[:3, 2])
        sines = np.sin(np.clip(elevation, -0.5 * math.pi, 0.5 * math.pi))
        self._turn = (self._turn + 1) % columns.TURNS
        columns.renew(
            origin,
            up,
            sines,
            now,
            c.decay,
            c.margin,
            c.misses,
            self._turn,
            *store,
            self._lows,
            self._highs,
            self._returns,
            self._changed,
        )
        self._judge(base, origin)

    def _roll(self, base: NDArray[np.float64]) -> None:
        """Move the window by whole cells so that the base is in its middle."""
        c = self.config
        cells = np.floor(base[:2] / c.cell).astype(np.int64) - c.columns // 4
        first = 2 * cells
        of_cells = (self._evidence, self._ground, self._lows, self._memory)
        columns.forget_left(self._mask, self._newest, *of_cells, self._first, first)
        self._first = first

    def _judge(self, base: NDArray[np.float64], origin: NDArray[np.float64]) -> None:
        c, place = self.config, (self._first, self.config.voxel)
        growth = (c.climb, c.slack, c.tilt, round(c.gap / c.cell))
        work = (self._ground, self._state, self._gap, self._queue, self._later)
        known = (self._lows, self._highs, self._returns, self._memory, self._evidence, self._touched)
        terrain_ground.grow_ground(*known, base, *place, c.own_radius, *growth, *work)
        seen = (self._ground, self._state)
        judged = (self._sure, self._slopes, self._excess, self._classes)
        told = (self._lows, self._highs, self._returns, self._changed)
        terrain_steps.judge_ground(*seen, *told, *place, c.step, math.tan(c.steep), *judged)
        hidden = (MARCH * c.cell / 0.2, c.drop, c.hidden * c.cell / 0.2)
        terrain_edges.find_drops(
            self._lows,
            self._returns,
            *seen,
            origin,
            *place,
            self._turn & 1,
            *hidden,
            self._image,
            self._evidence,
            self._depths,
        )
        terrain_edges.mark_edges(self._evidence, c.evidence, self._excess, c.step, self._first, self._classes)
        terrain_stairs.find_stairs(*seen, *place, self._voxels, self._mask, self._classes)

    def terrain(self) -> Terrain:
        """Return what is known after the last update."""
        c, m = self.config, self.config.columns // 2
        out, kinds = np.empty((c.points_most, 4), np.float32), np.empty(c.points_most, np.uint8)
        limits = np.array([c.step, c.clearance, float(c.climbs_stairs), c.slack, c.tilt])
        count = terrain_ground.gather(
            *(self._ground, self._state, self._gap, self._slopes, self._excess, self._depths, self._classes),
            *(self._first, c.voxel, limits, self._voxels, self._mask, out, kinds),
        )
        cx, cy = (self._first // 2).tolist()
        rows, cols = (cy + np.arange(m)) % m, (cx + np.arange(m)) % m
        spec = GridSpec(c.cell, m, m, cx * c.cell, cy * c.cell)
        of_window = np.ix_(rows, cols)
        return Terrain(spec, self._classes[of_window], self._ground[of_window], out[:count], kinds[:count])
