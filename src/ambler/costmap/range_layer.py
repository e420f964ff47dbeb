"""The range layer: what ultrasonic cones say, as log odds of a cell, after ROS's range sensor layer.

An echo proves the cone free up to it and puts an obstacle somewhere on its arc; no echo proves the whole cone free. What is said
once is believed little: it takes two echoes to mark, and as many free cones to clear again. Light never clears this layer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.kernels import costmap as cells_kernels
from ambler.kernels import range_layer as kernels

T = TypeVar("T", bound=np.generic)
U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]


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
    """`update` with cones, then read `cells` uint8 [iy, ix] of 0 free, 254 lethal, 255 nothing known."""

    def __init__(self, config: RangeConfig, spec: GridSpec) -> None:
        self.config = config
        self.spec = spec
        self.cells: U8 = np.full(spec.shape, COST_UNKNOWN, np.uint8)
        self._log_odds = np.zeros(spec.shape, np.float32)
        self._touched = np.full(spec.shape, kernels.UNSEEN)

    def update(self, cones: Sequence[RangeCone], now: float) -> bool:
        """Draw the cones, measured at about `now` (seconds), in their order; forget what has decayed. Says whether a mark came or went."""
        c, spec = self.config, self.spec
        thickness = max(c.thickness, 0.7 * spec.resolution)
        model = np.array([c.hit, c.miss, thickness, c.far, c.fade])
        limits = np.array([c.least, c.most])
        for cone in cones:
            echo = cone.echo if cone.echo <= c.obstacle_range else math.inf
            free = min(cone.free, c.clear_range, cone.echo - thickness)
            row = np.array([cone.x, cone.y, cone.yaw, cone.half_angle, free, echo])
            place = (spec.origin_x, spec.origin_y, spec.resolution)
            kernels.draw_cone(self._log_odds, self._touched, *place, row, model, limits, now)
        before = self.cells == COST_LETHAL
        kernels.to_cells(self._log_odds, self._touched, now, c.decay, c.mark, c.clear, self.cells)
        return not np.array_equal(before, self.cells == COST_LETHAL)

    def clear_polygon(self, polygon: F64) -> None:
        """Forget the cells inside a convex, counter-clockwise polygon (N, 2): where the robot stands, nothing else does."""
        spec = self.spec
        inside = np.zeros(spec.shape, np.uint8)
        points = np.require(polygon, np.float64, ["C", "W"])
        cells_kernels.fill_convex(inside, spec.origin_x, spec.origin_y, spec.resolution, points, 1)
        self._log_odds[inside == 1] = 0.0
        self.cells[inside == 1] = COST_UNKNOWN

    def move_to(self, spec: GridSpec) -> None:
        """Keep what overlaps with another grid of the same resolution, aligned to whole cells; of the rest nothing is known."""
        if spec == self.spec:
            return
        dy, dx = spec.offset_in(self.spec)
        self._log_odds = _moved(self._log_odds, spec.shape, dy, dx, 0.0)
        self._touched = _moved(self._touched, spec.shape, dy, dx, kernels.UNSEEN)
        self.cells = _moved(self.cells, spec.shape, dy, dx, COST_UNKNOWN)
        self.spec = spec

    def reset(self) -> None:
        """Forget everything."""
        self._log_odds[:] = 0.0
        self._touched[:] = kernels.UNSEEN
        self.cells[:] = COST_UNKNOWN


def _moved(old: NDArray[T], shape: tuple[int, int], dy: int, dx: int, fill: float) -> NDArray[T]:
    new = np.full(shape, fill, old.dtype)
    y0, y1 = max(0, dy), min(old.shape[0], dy + shape[0])
    x0, x1 = max(0, dx), min(old.shape[1], dx + shape[1])
    if y1 > y0 and x1 > x0:
        new[y0 - dy : y1 - dy, x0 - dx : x1 - dx] = old[y0:y1, x0:x1]
    return new
