"""The range layer: what ultrasonic cones say, as log odds of a cell, after ROS's range sensor layer.

An echo proves the cone free up to it and puts an obstacle somewhere on its arc; no echo proves the whole cone free. What is said
once is believed little: it takes two echoes to mark, and as many free cones to clear again. Light never clears this layer.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_UNKNOWN, GridSpec
from ambler.costmap.layer import Box, Moment, cells_within, changed_box, moved, union, whole
from ambler.kernels import costmap as cells_kernels
from ambler.kernels import range_layer as kernels

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]
FED_MAX = 1000  # the newest that wait for an update: a map may be long in coming


@dataclass(frozen=True, slots=True)
class RangeConfig:
    """`hit` and `miss` are the log odds that one measurement adds on the axis of its cone; a cell is marked from `mark` and clear
    from `clear` on, and never surer than `least` or `most`. Certainty halves at `far` metres, within about `fade` of it. Echoes mark up to
    `obstacle_range` from the transducer; cones clear up to `clear_range`. A cell of which nothing was said for `decay` seconds is forgotten
    (inf: never). An arc is `thickness` metres thick to either side, at least 0.7 cells."""

    hit: float = 1.0
    miss: float = 0.5
    mark: float = 1.2
    clear: float = -0.4
    least: float = -1.0
    most: float = 3.0
    thickness: float = 0.03
    far: float = 2.0
    fade: float = 0.5
    obstacle_range: float = 2.0
    clear_range: float = 2.5
    decay: float = math.inf


@dataclass(frozen=True, slots=True)
class RangeCone:
    """One measurement in the layer's frame: place and direction of the transducer, half angle of its cone (rad), how far it saw nothing,
    and where its arc lies (m; inf: there is none, or something else explains it)."""

    x: float
    y: float
    yaw: float
    half_angle: float
    free: float
    echo: float


class RangeLayer:
    """A `Layer` of what cones say: `cells` uint8 [iy, ix] of 0 free, 254 lethal, 255 nothing known; None until there is anything. Only
    marks are drawn, over anything: what cones clear stays as the other layers see it."""

    def __init__(self, config: RangeConfig) -> None:
        self.config = config
        self.cells: U8 | None = None
        self._spec: GridSpec | None = None
        self._log_odds: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._touched: F64 = np.zeros((0, 0))
        self._fed: deque[tuple[tuple[RangeCone, ...], float]] = deque(maxlen=FED_MAX)
        self._is_cleared = False

    def add(self, cones: Sequence[RangeCone], now: float) -> None:
        """Take cones in the costmap's frame, measured at about `now` (seconds), in their order; the next update draws them and forgets
        what has decayed by then."""
        self._fed.append((tuple(cones), now))

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Draw the cones fed since the last update, then forget what lies in the footprint."""
        changed = whole(spec) if self._is_cleared else None
        self._is_cleared = False
        if self._spec is not None and spec.resolution != self._spec.resolution:
            self.cells = None
        is_idle = not self._fed and (self.cells is None or (spec == self._spec and moment.footprint is None))
        if is_idle:
            return changed
        before = None if self.cells is None else self.cells.copy()
        self._draw_fed(spec)
        self._move_to(spec)
        if moment.footprint is not None:
            self._clear_polygon(moment.footprint, spec)
        assert self.cells is not None
        if before is None or before.shape != self.cells.shape:
            return whole(spec)
        return union(changed, changed_box(before, self.cells))

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Draw the marks."""
        if self.cells is not None:
            cells_kernels.lay_lethal(master, self.cells, *box)

    def clear(self) -> None:
        """Forget everything."""
        self.cells, self._spec, self._is_cleared = None, None, True
        self._fed.clear()

    def clear_within(self, x: float, y: float, radius: float) -> None:
        """Forget what was heard there."""
        if self.cells is not None and self._spec is not None:
            near = cells_within(self._spec, x, y, radius)
            self.cells[near], self._log_odds[near], self._touched[near] = COST_UNKNOWN, 0.0, kernels.UNSEEN
            self._is_cleared = True

    def _draw_fed(self, spec: GridSpec) -> None:
        """Draw into the grid as it lay when the cones came; of a new layer into `spec`."""
        if self.cells is None or self._spec is None:
            self._spec, self.cells = spec, np.full(spec.shape, COST_UNKNOWN, np.uint8)
            self._log_odds = np.zeros(spec.shape, np.float32)
            self._touched = np.full(spec.shape, kernels.UNSEEN)
        fed = list(self._fed)
        self._fed.clear()
        for k, (cones, now) in enumerate(fed):
            self._draw(cones, now, self._spec)
            if math.isfinite(self.config.decay) or k == len(fed) - 1:
                c = self.config
                kernels.to_cells(self._log_odds, self._touched, now, c.decay, c.mark, c.clear, self.cells)

    def _draw(self, cones: Sequence[RangeCone], now: float, spec: GridSpec) -> None:
        c = self.config
        thickness = max(c.thickness, 0.7 * spec.resolution)
        model = np.array([c.hit, c.miss, thickness, c.far, c.fade])
        limits = np.array([c.least, c.most])
        for cone in cones:
            echo = cone.echo if cone.echo <= c.obstacle_range else math.inf
            free = min(cone.free, c.clear_range, cone.echo - thickness)
            row = np.array([cone.x, cone.y, cone.yaw, cone.half_angle, free, echo])
            place = (spec.origin_x, spec.origin_y, spec.resolution)
            kernels.draw_cone(self._log_odds, self._touched, *place, row, model, limits, now)

    def _clear_polygon(self, polygon: F64, spec: GridSpec) -> None:
        """Forget the cells inside a convex, counter-clockwise polygon (N, 2): where the robot stands, nothing else does."""
        assert self.cells is not None
        inside = np.zeros(spec.shape, np.uint8)
        points = np.require(polygon, np.float64, ["C", "W"])
        cells_kernels.fill_convex(inside, spec.origin_x, spec.origin_y, spec.resolution, points, 1)
        self._log_odds[inside == 1] = 0.0
        self.cells[inside == 1] = COST_UNKNOWN

    def _move_to(self, spec: GridSpec) -> None:
        assert self.cells is not None
        assert self._spec is not None
        if spec != self._spec:
            self._log_odds = moved(self._log_odds, self._spec, spec, 0.0)
            self._touched = moved(self._touched, self._spec, spec, kernels.UNSEEN)
            self.cells = moved(self.cells, self._spec, spec, COST_UNKNOWN)
            self._spec = spec
