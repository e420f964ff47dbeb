"""The global costmap in the map frame: an occupancy grid, what layers draw over it, inflation, and what the robot has driven kept open.

It takes the map's geometry and grows with it. While the geometry stays, only what the layers say has changed is drawn anew, and only
the box in which costs changed is inflated anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_INSCRIBED, COST_UNKNOWN, GridSpec
from ambler.core.robot import RobotModel
from ambler.core.se2 import SE2
from ambler.costmap.blocked_layer import AddedLayer, BlockedLayer, BoundaryLayer
from ambler.costmap.driven_cells import DrivenCells
from ambler.costmap.glass_layer import GlassLayer
from ambler.costmap.inflation import Inflation, InflationConfig
from ambler.costmap.layer import Box, L, Layer, Moment, changed_box, clear_layers, layer_of, union, whole
from ambler.costmap.obstacle_layer import ObstacleConfig, ObstacleLayer
from ambler.costmap.range_layer import RangeConfig, RangeLayer
from ambler.costmap.static_layer import StaticConfig, StaticLayer

U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class GlobalCostmapConfig:
    """Configs of the layers."""

    static: StaticConfig = field(default_factory=StaticConfig)
    obstacles: ObstacleConfig = field(default_factory=ObstacleConfig)
    inflation: InflationConfig = field(default_factory=InflationConfig)
    ranges: RangeConfig = field(default_factory=RangeConfig)


def global_layers(config: GlobalCostmapConfig) -> tuple[Layer, ...]:
    """Return the usual layers above the map: obstacles, cones, glass, blocked ways, what people added, the boundary. Without anything fed they cost
    nothing."""
    told = (GlassLayer(), BlockedLayer(), AddedLayer(), BoundaryLayer())
    return ObstacleLayer(config.obstacles), RangeLayer(config.ranges), *told


class GlobalCostmap:
    """`set_map`, feed the layers and `update`, then read `costs` uint8 [iy, ix] and `spec`. `layers` are drawn over the map in their
    order (None: `global_layers`)."""

    def __init__(self, config: GlobalCostmapConfig, robot: RobotModel, layers: Sequence[Layer] | None = None) -> None:
        self.config = config
        self.layers = tuple(global_layers(config) if layers is None else layers)
        self._robot = robot
        self._static = StaticLayer(config.static)
        self._inflation: Inflation | None = None
        self._spec: GridSpec | None = None
        self._driven: DrivenCells | None = None
        self._master: U8 = np.zeros((0, 0), np.uint8)
        self._inflated: U8 = np.zeros((0, 0), np.uint8)
        self._costs = self._inflated
        self._opened = np.zeros(0, np.int64)

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
        """The newest costs; a new array after every change, the same one without."""
        return self._costs

    def layer(self, kind: type[L]) -> L:
        """Return the first layer of a class, to feed it; raises BadInputError."""
        return layer_of(self.layers, kind)

    def set_map(self, spec: GridSpec, occupancy: NDArray[np.int8], moment: Moment | None = None) -> U8:
        """Take a new map, int8 [iy, ix], and update; returns the costs. Raises BadInputError when the map does not fit its geometry."""
        self._static.set_map(spec, occupancy)
        is_new = spec != self._spec
        if self._inflation is None or self._spec is None or spec.resolution != self._spec.resolution:
            self._inflation = Inflation(self.config.inflation, self._robot, spec.resolution)
            self._driven = DrivenCells(self._inflation.inscribed_radius)
        self._spec = spec
        if is_new:
            self._master = np.empty(spec.shape, np.uint8)
            self._inflated = np.empty(spec.shape, np.uint8)
        return self._bring_up(moment, is_new=is_new)

    def update(self, moment: Moment | None = None) -> U8:
        """Take in everything that was fed to the layers since; returns the costs. Raises BadInputError before the first map."""
        _ = self.spec
        return self._bring_up(moment, is_new=False)

    def clear(self) -> U8:
        """Forget what sensors saw; the map and its glass stay."""
        for layer in self.layers:
            layer.clear()
        return self.update() if self.has_map else self._costs

    def forget_driven(self) -> None:
        """Forget where the robot has been: what comes is another map."""
        if self._driven is not None:
            self._driven.forget()

    def clear_within(self, x: float, y: float, radius: float) -> None:
        """Forget what sensors saw within a radius (m) of a place in the map frame; the next update draws it."""
        clear_layers(self.layers, x, y, radius)

    def _bring_up(self, moment: Moment | None, *, is_new: bool) -> U8:
        spec, changed, before = self.spec, None, self._inflated
        now = replace(moment if moment is not None else Moment(), costmap_from_map=SE2())
        for layer in (self._static, *self.layers):
            changed = union(changed, layer.update(spec, now))
        if is_new:
            changed = whole(spec)
        if changed is not None:
            self._draw(changed, is_new=is_new)
        self._open_driven(now.costmap_from_base, is_changed=is_new or self._inflated is not before)
        return self._costs

    def _open_driven(self, map_from_base: SE2 | None, *, is_changed: bool) -> None:
        """Let the robot come back through what it has driven and only the inflation shuts."""
        assert self._driven is not None
        if map_from_base is not None:
            self._driven.add(map_from_base.x, map_from_base.y, self.spec.resolution)
        opened = self._driven.kept_open(self._inflated, self._master, self.spec)
        if not is_changed and np.array_equal(opened, self._opened):
            return
        self._opened, self._costs = opened, self._inflated
        if len(opened):
            self._costs = self._inflated.copy()
            self._costs.ravel()[opened] = COST_INSCRIBED - 1

    def _draw(self, box: Box, *, is_new: bool) -> None:
        """Draw the layers in a box and inflate where that made a difference."""
        assert self._inflation is not None
        y0, y1, x0, x1 = box
        drawn = np.empty(self.spec.shape, np.uint8)
        drawn[y0:y1, x0:x1] = COST_UNKNOWN
        for layer in (self._static, *self.layers):
            layer.draw_into(drawn, self.spec, box)
        if is_new:
            self._master = drawn
            self._inflation.inflate(self._master, self._inflated)
            return
        differing = changed_box(self._master, drawn, box)
        if differing is not None:
            self._master[y0:y1, x0:x1] = drawn[y0:y1, x0:x1]
            self._inflated = self._inflated.copy()
            self._inflation.inflate(self._master, self._inflated, differing)
