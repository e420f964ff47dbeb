"""The local costmap: a window that rolls with the robot in the odom frame, by whole cells, and holds what the sensors see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_FREE, COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.costmap.inflation import LOCAL_INFLATION, Inflation, InflationConfig
from ambler.costmap.obstacle_layer import ObstacleConfig, ObstacleLayer, SensorRays
from ambler.costmap.range_layer import RangeCone, RangeConfig, RangeLayer
from ambler.kernels.range_layer import draw_segments

U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class LocalCostmapConfig:
    """A square of `size` metres. The inflation is tiny, because the controller checks the true footprint and doors must stay
    passable. Cells that no ray has touched are free, unless `tracks_unknown`."""

    size: float = 6.0
    resolution: float = 0.05
    tracks_unknown: bool = False
    obstacles: ObstacleConfig = field(default_factory=lambda: ObstacleConfig(obstacle_range=4.5, raytrace_range=5.0))
    inflation: InflationConfig = LOCAL_INFLATION
    ranges: RangeConfig = field(default_factory=lambda: RangeConfig(decay=15.0))


class LocalCostmap:
    """`update` with what the sensors saw, then read `costs` uint8 [iy, ix] and `spec`, both in the odom frame."""

    def __init__(self, config: LocalCostmapConfig, robot: RobotModel) -> None:
        self.config = config
        self._footprint = robot.footprint
        self._inflation = Inflation(config.inflation, robot, config.resolution)
        self._cells_across = math.ceil(config.size / config.resolution - 1e-9)
        self._layer = ObstacleLayer(config.obstacles, self._window(SE2()))
        self._ranges: RangeLayer | None = None
        self._glass = np.zeros((0, 4))
        self._costs: U8 = np.zeros(self._layer.spec.shape, np.uint8)

    @property
    def spec(self) -> GridSpec:
        """Where the window lies in the odom frame; its origin is a whole multiple of the resolution."""
        return self._layer.spec

    @property
    def costs(self) -> U8:
        """The newest costs; a new array after every update."""
        return self._costs

    def update(self, odom_from_base: SE2, rays: Sequence[SensorRays]) -> U8:
        """Move the window to the robot, clear along all rays, mark all hits, free the footprint, inflate; returns `costs`."""
        self._layer.move_to(self._window(odom_from_base))
        self._layer.update(rays)
        if self.config.obstacles.clears_footprint:
            self._layer.clear_polygon(odom_from_base.transform(self._footprint))
        source = self._layer.cells
        source = self._with_glass(self._with_ranges(source, odom_from_base))
        if not self.config.tracks_unknown:
            source = np.where(source == COST_UNKNOWN, np.uint8(COST_FREE), source)
        costs = np.empty_like(source)
        self._inflation.inflate(source, costs)
        self._costs = costs
        return costs

    def add_cones(self, cones: Sequence[RangeCone], now: float) -> None:
        """Take ultrasonic cones in the odom frame, measured at about `now` (seconds); the next `update` shows what they mark."""
        if self._ranges is None:
            self._ranges = RangeLayer(self.config.ranges, self.spec)
        self._ranges.update(cones, now)

    def set_glass(self, segments: NDArray[np.floating]) -> None:
        """Take all segments of glass (N, 4) in the odom frame in place of the last ones; the next `update` shows them."""
        self._glass = np.array(segments, np.float64)

    def _with_glass(self, source: U8) -> U8:
        if len(self._glass) == 0:
            return source
        spec, out = self.spec, source.copy()
        draw_segments(out, spec.origin_x, spec.origin_y, spec.resolution, self._glass, COST_LETHAL)
        return out

    def _with_ranges(self, source: U8, odom_from_base: SE2) -> U8:
        """Lay what the cones mark over the other layer; what they clear stays as the other layer sees it."""
        if self._ranges is None:
            return source
        self._ranges.move_to(self.spec)
        if self.config.obstacles.clears_footprint:
            self._ranges.clear_polygon(odom_from_base.transform(self._footprint))
        return np.where(self._ranges.cells == COST_LETHAL, np.uint8(COST_LETHAL), source)

    def clear(self) -> None:
        """Forget all obstacles; the next update sees them anew."""
        self._layer.reset()
        if self._ranges is not None:
            self._ranges.reset()
        self._costs = np.full(self.spec.shape, COST_UNKNOWN if self.config.tracks_unknown else COST_FREE, np.uint8)

    def _window(self, odom_from_base: SE2) -> GridSpec:
        r, n = self.config.resolution, self._cells_across
        iy, ix = round(odom_from_base.y / r - n / 2), round(odom_from_base.x / r - n / 2)
        return GridSpec(r, n, n, ix * r, iy * r)
