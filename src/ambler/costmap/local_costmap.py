"""The local costmap: a window that rolls with the robot in the odom frame, by whole cells, and holds what its layers draw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_FREE, COST_UNKNOWN, GridSpec
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.costmap.blocked_layer import AddedLayer, BoundaryLayer
from ambler.costmap.glass_layer import GlassLayer
from ambler.costmap.inflation import LOCAL_INFLATION, Inflation, InflationConfig
from ambler.costmap.layer import L, Layer, Moment, clear_layers, layer_of, whole
from ambler.costmap.obstacle_layer import ObstacleConfig, ObstacleLayer
from ambler.costmap.range_layer import RangeConfig, RangeLayer
from ambler.kernels import costmap as kernels

U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class LocalCostmapConfig:
    """A square of `size` metres. The inflation is tiny, because the controller checks the true footprint and doors must stay
    passable. Cells of which no layer knows anything are free, unless `tracks_unknown`."""

    size: float = 6.0
    resolution: float = 0.05
    tracks_unknown: bool = False
    obstacles: ObstacleConfig = field(default_factory=lambda: ObstacleConfig(obstacle_range=4.5, raytrace_range=5.0))
    inflation: InflationConfig = LOCAL_INFLATION
    ranges: RangeConfig = field(default_factory=lambda: RangeConfig(decay=15.0))


def local_layers(config: LocalCostmapConfig) -> tuple[Layer, ...]:
    """Return the usual layers: obstacles, cones, glass, what people added, the boundary."""
    return ObstacleLayer(config.obstacles), RangeLayer(config.ranges), GlassLayer(), AddedLayer(), BoundaryLayer()


class LocalCostmap:
    """Feed the layers and `update`, then read `costs` uint8 [iy, ix] and `spec`, both in the odom frame. `layers` are drawn in their
    order (None: `local_layers`)."""

    def __init__(self, config: LocalCostmapConfig, robot: RobotModel, layers: Sequence[Layer] | None = None) -> None:
        self.config = config
        self.layers = tuple(local_layers(config) if layers is None else layers)
        self._footprint = robot.footprint
        self._inflation = Inflation(config.inflation, robot, config.resolution)
        self._cells_across = math.ceil(config.size / config.resolution - 1e-9)
        self._spec = self._window(SE2())
        self._costs: U8 = np.zeros(self._spec.shape, np.uint8)

    @property
    def spec(self) -> GridSpec:
        """Where the window lies in the odom frame; its origin is a whole multiple of the resolution."""
        return self._spec

    @property
    def costs(self) -> U8:
        """The newest costs; a new array after every update."""
        return self._costs

    def layer(self, kind: type[L]) -> L:
        """Return the first layer of a class, to feed it; raises BadInputError."""
        return layer_of(self.layers, kind)

    def update(self, odom_from_base: SE2, odom_from_map: SE2 | None = None) -> U8:
        """Move the window to the robot, take in everything that was fed to the layers, draw them, inflate; returns `costs`."""
        spec = self._spec = self._window(odom_from_base)
        footprint = odom_from_base.transform(self._footprint) if self.config.obstacles.clears_footprint else None
        moment = Moment(odom_from_base, odom_from_map, footprint)
        master = np.full(spec.shape, COST_UNKNOWN, np.uint8)
        for layer in self.layers:
            layer.update(spec, moment)
            layer.draw_into(master, spec, whole(spec))
        if not self.config.tracks_unknown:
            kernels.free_unknown(master)
        self._costs = np.empty_like(master)
        self._inflation.inflate(master, self._costs)
        return self._costs

    def clear(self) -> None:
        """Forget what sensors saw; the next update sees it anew."""
        for layer in self.layers:
            layer.clear()
        self._costs = np.full(self.spec.shape, COST_UNKNOWN if self.config.tracks_unknown else COST_FREE, np.uint8)

    def clear_within(self, x: float, y: float, radius: float) -> None:
        """Forget what sensors saw within a radius (m) of a place in the odom frame; the next update sees it anew."""
        clear_layers(self.layers, x, y, radius)

    def _window(self, odom_from_base: SE2) -> GridSpec:
        r, n = self.config.resolution, self._cells_across
        iy, ix = round(odom_from_base.y / r - n / 2), round(odom_from_base.x / r - n / 2)
        return GridSpec(r, n, n, ix * r, iy * r)
