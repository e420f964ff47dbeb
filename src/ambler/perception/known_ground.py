"""A saved map of ground, level by level: where there is ground, and on which level a robot stands that knows its place and height in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import OCC_FREE, GridSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class KnownGroundConfig:
    """A robot stands on a level where at least `cells` cells of its ground within `stand` metres around the base lie within `step` metres of the base's height. It changes to the wanted one where that carries it on
    `room` of what the present one does, or within `near` metres of a passage: closer to its end it would stand in what closes it."""

    stand: float = 1.0
    step: float = 0.7
    cells: int = 30
    room: float = 0.9
    near: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class KnownLevel:
    """Geometry, occupancy int8 [iy, ix] (-1 unknown, 0 ground, 100 in the way) and heights float32 [iy, ix] of the ground, metres, NaN where not known."""

    spec: GridSpec
    occupancy: NDArray[np.int8]
    heights: F32

    def is_ground(self, x: float, y: float) -> bool:
        """Say whether a place of the map is ground of this level."""
        return self.spec.contains(x, y) and bool(self.occupancy[self.spec.cell_of(x, y)] == OCC_FREE)

    def height_at(self, x: float, y: float) -> float | None:
        """Return how high the ground lies at a place, None where it is not known."""
        if not self.is_ground(x, y):
            return None
        height = float(self.heights[self.spec.cell_of(x, y)])
        return height if np.isfinite(height) else None

    def support(self, place: tuple[float, float, float], config: KnownGroundConfig) -> int:
        """Return how many cells of ground around a base in the map carry it."""
        reach = int(np.ceil(config.stand / self.spec.resolution))
        iy, ix = self.spec.cell_of(place[0], place[1])
        y0, y1, x0, x1 = max(0, iy - reach), max(0, iy + reach + 1), max(0, ix - reach), max(0, ix + reach + 1)
        near = np.s_[y0:y1, x0:x1]
        off = np.abs(self.heights[near].astype(np.float64) - place[2])
        rows, columns = np.ogrid[y0 - iy : y0 - iy + off.shape[0], x0 - ix : x0 - ix + off.shape[1]]
        is_near = np.hypot(rows, columns) * self.spec.resolution <= config.stand
        with np.errstate(invalid="ignore"):
            return int(np.count_nonzero(is_near & (off <= config.step) & (self.occupancy[near] == OCC_FREE)))


class KnownGround:
    """`active` is the level on which the robot is. `wanted`: a level that is changed to as soon as the robot stands on it. Who stands at one of `passages` float64 (N, 5)
    (level from, level to, x, y, yaw) is on both."""

    def __init__(
        self, levels: Sequence[KnownLevel], passages: F64 | None = None, config: KnownGroundConfig | None = None
    ) -> None:
        if not levels:
            raise BadInputError("a known ground needs at least one level")
        self.levels = tuple(levels)
        self.passages: F64 = np.zeros((0, 5)) if passages is None else passages
        if len(self.passages) and not ((self.passages[:, :2] >= 0) & (self.passages[:, :2] < len(levels))).all():
            raise BadInputError(f"a passage leads to a level that is none of {len(levels)}")
        self.config = config if config is not None else KnownGroundConfig()
        self.active = 0
        self.wanted: int | None = None

    def update(self, map_from_base: SE3) -> bool:
        """Take where the robot is; say whether it is on another level now. One that carries it is only left for the wanted one."""
        place = map_from_base.translation
        support = [level.support(place, self.config) for level in self.levels]
        carries = [k for k, count in enumerate(support) if count >= self.config.cells]
        before = self.active
        if self.wanted is not None and self.wanted in carries and self._has_room(support, map_from_base):
            self.active = self.wanted
        elif self.active not in carries and carries:
            self.active = max(carries, key=lambda k: support[k])
        if self.active == self.wanted:
            self.wanted = None
        return self.active != before

    def _has_room(self, support: Sequence[int], map_from_base: SE3) -> bool:
        """Say whether the wanted level goes on around the robot as far as the present one, or the robot is at a passage between them."""
        here, there, c = self.active, self.wanted, self.config
        assert there is not None
        of_both = self.passages[(self.passages[:, 0] == here) & (self.passages[:, 1] == there), 2:4]
        is_near = np.hypot(*(of_both - map_from_base.translation[:2]).T) <= c.near
        return bool(is_near.any()) or support[there] >= c.room * support[here]

    def level_at(self, pose: SE2) -> int | None:
        """Return the first level that has ground at a place, None: none has."""
        return next((k for k, level in enumerate(self.levels) if level.is_ground(pose.x, pose.y)), None)

    def standing_at(self, pose: SE2) -> SE3:
        """Return the pose in space of a base on the ground of the first level that has some there; raises BadInputError."""
        heights = (level.height_at(pose.x, pose.y) for level in self.levels)
        height = next((h for h in heights if h is not None), None)
        if height is None:
            raise BadInputError(f"there is no ground at {pose.x:g}, {pose.y:g} m in the map")
        return SE3.from_se2(pose, height)
