"""Both costmaps once more, slow and plain: every layer whole, every cost from the nearest lethal cell, nothing kept but the layers' own."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ambler.core.grid import GridSpec
from ambler.costmap.inflation import Inflation
from ambler.costmap.obstacle_layer import ObstacleConfig, SensorRays
from ambler.costmap.range_layer import RangeCone, RangeConfig
from ambler.kernels import costmap, range_layer

UNKNOWN, LETHAL, FREE = 255, 254, 0


def shifted(old: np.ndarray, old_spec: GridSpec, spec: GridSpec, fill: float) -> np.ndarray:
    """Cell by cell: what lay at the same place before."""
    new = np.full(spec.shape, fill, old.dtype)
    dy, dx = spec.offset_in(old_spec)
    for iy, ix in np.ndindex(*spec.shape):
        if old_spec.contains_cell(iy + dy, ix + dx):
            new[iy, ix] = old[iy + dy, ix + dx]
    return new


def inside(spec: GridSpec, polygon: np.ndarray) -> np.ndarray:
    """The cells whose centres lie in a convex, counter-clockwise polygon, bool [iy, ix]."""
    grid = np.stack(np.meshgrid(np.arange(spec.height), np.arange(spec.width), indexing="ij"), -1).reshape(-1, 2)
    centers = spec.centers_of(grid)
    is_in = np.ones(len(centers), bool)
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        is_in &= (b[0] - a[0]) * (centers[:, 1] - a[1]) - (b[1] - a[1]) * (centers[:, 0] - a[0]) >= 0.0
    return is_in.reshape(spec.shape)


def inflated(source: np.ndarray, inflation: Inflation) -> np.ndarray:
    """The costs from the distance of every cell to every lethal cell."""
    r = inflation.radius_cells
    out = source.copy()
    lethal = np.argwhere(source == LETHAL)
    if r == 0 or len(lethal) == 0:
        return out
    for iy, ix in np.ndindex(*source.shape):
        squared = int(((lethal - (iy, ix)) ** 2).sum(axis=1).min())
        cost = int(inflation.table[min(squared, len(inflation.table) - 1)])
        if source[iy, ix] == UNKNOWN:
            out[iy, ix] = cost if cost >= 253 else UNKNOWN
        else:
            out[iy, ix] = max(int(source[iy, ix]), cost)
    return out


@dataclass
class SlowLight:
    """Rays: those kernels have twins of their own in test_costmaps.py."""

    config: ObstacleConfig
    cells: np.ndarray | None = None

    def see(self, spec: GridSpec, rays: list[SensorRays]) -> None:
        if self.cells is None:
            self.cells = np.full(spec.shape, UNKNOWN, np.uint8)
        place = (spec.origin_x, spec.origin_y, spec.resolution)
        c, level, falls = self.config, (np.zeros((0, 0), np.float32), *place), (0.0, np.zeros(0))
        for r in rays:
            costmap.clear_rays(self.cells, *level, np.array([r.origin]), r.hits.copy(), c.raytrace_range, False, *falls)
            costmap.clear_rays(
                self.cells, *level, np.array([r.origin]), r.free_ends.copy(), c.raytrace_range, True, *falls
            )
        for r in rays:
            costmap.mark_points(self.cells, *level, np.array([r.origin]), r.hits.copy(), c.obstacle_range, falls[1])

    def over(self, below: np.ndarray) -> np.ndarray:
        if self.cells is None:
            return below
        known = np.where(below == UNKNOWN, self.cells, np.maximum(below, self.cells))
        return np.where(self.cells == UNKNOWN, below, known)


@dataclass
class SlowSound:
    """Cones: the kernel has a twin of its own in test_range_layer.py. Sums and decay here in NumPy."""

    config: RangeConfig
    odds: np.ndarray | None = None
    touched: np.ndarray | None = None
    marks: np.ndarray | None = None

    def hear(self, spec: GridSpec, cones: list[RangeCone], now: float) -> None:
        c = self.config
        if self.odds is None:
            self.odds, self.touched = np.zeros(spec.shape, np.float32), np.full(spec.shape, -1e30)
        thick = max(c.thickness, 0.7 * spec.resolution)
        model, limits = np.array([c.hit, c.miss, thick, c.far, c.fade]), np.array([c.least, c.most])
        for k in cones:
            echo = k.echo if k.echo <= c.obstacle_range else math.inf
            row = np.array([k.x, k.y, k.yaw, k.half_angle, min(k.free, c.clear_range, k.echo - thick), echo])
            place = (spec.origin_x, spec.origin_y, spec.resolution)
            range_layer.draw_cone(self.odds, self.touched, *place, row, model, limits, now)
        old = now - self.touched > c.decay
        self.odds[old], self.touched[old] = 0.0, -1e30
        self.marks = self.odds >= c.mark

    def move(self, old: GridSpec, new: GridSpec) -> None:
        if self.odds is not None and old != new:
            self.odds, self.touched = shifted(self.odds, old, new, 0.0), shifted(self.touched, old, new, -1e30)
            self.marks = shifted(self.marks, old, new, False)

    def over(self, below: np.ndarray) -> np.ndarray:
        return below if self.marks is None else np.where(self.marks, np.uint8(LETHAL), below)


def with_glass(below: np.ndarray, spec: GridSpec, segments: np.ndarray) -> np.ndarray:
    """Sampled at a quarter of a cell, as the kernel says it does."""
    out = below.copy()
    for x0, y0, x1, y1 in segments:
        steps = max(1, math.ceil(4.0 * math.hypot(x1 - x0, y1 - y0) / spec.resolution))
        for k in range(steps + 1):
            cell = spec.cell_of(x0 + (x1 - x0) * k / steps, y0 + (y1 - y0) * k / steps)
            if spec.contains_cell(*cell):
                out[cell] = LETHAL
    return out


@dataclass
class SlowCostmap:
    """Global with a `table` of costs by occupancy + 128, else local."""

    inflation: Inflation
    light: SlowLight
    sound: SlowSound
    spec: GridSpec
    tracks_unknown: bool = True
    table: np.ndarray | None = None
    occupancy: np.ndarray | None = None
    glass: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))

    def move_to(self, spec: GridSpec) -> None:
        if self.light.cells is not None:
            self.light.cells = shifted(self.light.cells, self.spec, spec, UNKNOWN)
        self.sound.move(self.spec, spec)
        self.spec = spec

    def stand(self, footprint: np.ndarray) -> None:
        where = inside(self.spec, footprint)
        if self.light.cells is not None:
            self.light.cells[where] = FREE
        if self.sound.odds is not None:
            self.sound.odds[where], self.sound.marks[where] = 0.0, False

    def costs(self) -> np.ndarray:
        below = np.full(self.spec.shape, UNKNOWN, np.uint8)
        if self.table is not None and self.occupancy is not None:
            below = self.table[self.occupancy.astype(int) + 128]
        drawn = with_glass(self.sound.over(self.light.over(below)), self.spec, self.glass)
        if not self.tracks_unknown:
            drawn[drawn == UNKNOWN] = FREE
        return inflated(drawn, self.inflation)
