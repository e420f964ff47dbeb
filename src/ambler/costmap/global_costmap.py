"""The global costmap in the map frame: a static layer from an occupancy grid, an obstacle layer, and inflation.

It takes the map's geometry and grows with it. While the geometry stays, only the box in which the map changed is inflated anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_FREE, COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.core.robot import RobotModel
from ambler.costmap.inflation import Box, Inflation, InflationConfig
from ambler.costmap.obstacle_layer import ObstacleConfig, ObstacleLayer, SensorRays
from ambler.costmap.range_layer import RangeCone, RangeConfig, RangeLayer
from ambler.kernels import costmap as kernels
from ambler.kernels.range_layer import draw_segments

U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class StaticConfig:
    """Occupancy >= `lethal_threshold` is lethal, unknown is 255 (0 unless `tracks_unknown`), the rest is free when `is_trinary`
    and proportional otherwise."""

    lethal_threshold: int = 65
    tracks_unknown: bool = True
    is_trinary: bool = True


@dataclass(frozen=True, slots=True)
class GlobalCostmapConfig:
    """Configs of the layers."""

    static: StaticConfig = field(default_factory=StaticConfig)
    obstacles: ObstacleConfig = field(default_factory=ObstacleConfig)
    inflation: InflationConfig = field(default_factory=InflationConfig)
    ranges: RangeConfig = field(default_factory=RangeConfig)


class GlobalCostmap:
    """`set_map`, optionally `update` with sensor rays in the map frame, then read `costs` uint8 [iy, ix] and `spec`."""

    def __init__(self, config: GlobalCostmapConfig, robot: RobotModel) -> None:
        self.config = config
        self._robot = robot
        self._table = occupancy_table(config.static)
        self._inflation: Inflation | None = None
        self._spec: GridSpec | None = None
        self._layer: ObstacleLayer | None = None
        self._ranges: RangeLayer | None = None
        self._glass = np.zeros((0, 4))
        self._static: U8 = np.zeros((0, 0), np.uint8)
        self._master: U8 = np.zeros((0, 0), np.uint8)
        self._costs: U8 = np.zeros((0, 0), np.uint8)

    @property
    def has_map(self) -> bool:
        return self._spec is not None

    @property
    def spec(self) -> GridSpec:
        """The map's geometry; raises BadInputError before the first map."""
        if self._spec is None:
            raise BadInputError("the global costmap has no map yet")
        return self._spec

    @property
    def costs(self) -> U8:
        """The newest costs; a new array after every change."""
        return self._costs

    def set_map(self, spec: GridSpec, occupancy: NDArray[np.int8]) -> U8:
        """Take a new map, int8 [iy, ix]; returns the costs."""
        if occupancy.shape != spec.shape:
            raise BadInputError(f"a map of {occupancy.shape} cells does not fit its geometry {spec.shape}")
        static = np.empty(spec.shape, np.uint8)
        kernels.to_static(np.ascontiguousarray(occupancy), self._table, static)
        self._static = static
        if spec == self._spec:
            return self._rebuild()
        if self._spec is None or spec.resolution != self._spec.resolution or self._inflation is None:
            self._inflation = Inflation(self.config.inflation, self._robot, spec.resolution)
            self._layer = self._ranges = None
        if self._layer is not None:
            self._layer.move_to(spec)
        if self._ranges is not None:
            self._ranges.move_to(spec)
        self._spec = spec
        self._master = self._merged()
        self._costs = np.empty(spec.shape, np.uint8)
        self._inflation.inflate(self._master, self._costs)
        return self._costs

    def update(self, rays: Sequence[SensorRays], map_from_base_footprint: NDArray[np.float64] | None = None) -> U8:
        """Clear and mark the obstacle layer with rays in the map frame, free the footprint (N, 2) if given; returns the costs."""
        if self._layer is None:
            self._layer = ObstacleLayer(self.config.obstacles, self.spec)
        self._layer.update(rays)
        if map_from_base_footprint is not None and self.config.obstacles.clears_footprint:
            self._layer.clear_polygon(map_from_base_footprint)
        return self._rebuild()

    def add_cones(self, cones: Sequence[RangeCone], now: float) -> bool:
        """Take ultrasonic cones in the map frame, measured at about `now` (seconds); `refresh` or a new map shows what they mark. Says
        whether they changed anything."""
        if self._ranges is None:
            self._ranges = RangeLayer(self.config.ranges, self.spec)
        return self._ranges.update(cones, now)

    def set_glass(self, segments: NDArray[np.floating]) -> None:
        """Take all segments of glass (N, 4) in the map frame in place of the last ones; `refresh` or a new map shows them."""
        self._glass = np.array(segments, np.float64)

    def refresh(self) -> U8:
        """Return the costs with everything that was added since."""
        return self._rebuild()

    def clear(self) -> U8:
        """Forget the obstacle and the range layer; the map and its glass stay."""
        self._layer = self._ranges = None
        return self._rebuild() if self.has_map else self._costs

    def _merged(self) -> U8:
        master = self._static
        if self._layer is not None:
            master = np.empty_like(self._static)
            kernels.combine(self._static, self._layer.cells, master)
        if self._ranges is not None:
            master = np.where(self._ranges.cells == COST_LETHAL, np.uint8(COST_LETHAL), master)
        if len(self._glass):
            spec, master = self.spec, master.copy()
            draw_segments(master, spec.origin_x, spec.origin_y, spec.resolution, self._glass, COST_LETHAL)
        return master

    def _rebuild(self) -> U8:
        master = self._merged()
        y0, y1, x0, x1 = (int(v) for v in kernels.changed_box(self._master, master))
        self._master = master
        if y1 > y0:
            self._inflate_box((y0, y1, x0, x1))
        return self._costs

    def _inflate_box(self, box: Box) -> None:
        assert self._inflation is not None
        costs = self._costs.copy()
        self._inflation.inflate(self._master, costs, box)
        self._costs = costs


def occupancy_table(config: StaticConfig) -> U8:
    """Return the cost of occupancy v at index v + 128, uint8 (256,)."""
    value = np.arange(256) - 128
    graded = np.zeros(256) if config.is_trinary else value / config.lethal_threshold * COST_LETHAL
    table = np.where(value >= config.lethal_threshold, COST_LETHAL, np.clip(graded, COST_FREE, COST_LETHAL - 1))
    table[value < 0] = COST_UNKNOWN if config.tracks_unknown else COST_FREE
    return np.asarray(table, np.uint8)
