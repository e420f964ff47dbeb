"""Where a scanner of many rings falls silent: something stands nearer to it than it can see.

A scanner tells nothing of what is nearer than its least range. Some of its rings look down and meet the floor, so that every direction returns
something; one that returned something shortly before and now returns nothing at all is blocked at once, from the lowest ring to the highest.
Our own idea; it names no sensor's fault, since a lens that is covered by dirt is silent in just the same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.robot import RobotModel, SensorMount

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SilenceConfig:
    """Numbers of the search, SI.

    sectors     of the circle that are told apart
    least       silent sectors in a row that are somebody: a leg of a table, or a post, hides fewer
    most        silent sectors in a row that still are: who stands at the scanner hides less than half of the view
    heard       share of all sectors that must return something, else silence means nothing: the scanner looks into the open
    patience    sweeps after which a sector that stays silent is no news any more: a robot on a slope looks over the ground behind itself
    radius      of a person, from which the distance follows by the width of the silence
    """

    sectors: int = 72
    least: int = 5
    most: int = 36
    heard: float = 0.5
    patience: int = 150
    radius: float = 0.25


class SilentSectors:
    """Feed every sweep of one scanner; read where somebody hides from it."""

    def __init__(self, range_min: float, config: SilenceConfig | None = None) -> None:
        self._range_min = range_min
        self._config = config if config is not None else SilenceConfig()
        self._silent_for = np.full(self._config.sectors, self._config.patience)  # sweeps

    def update(self, points: NDArray[np.float32]) -> F64:
        """Return the middles (K, 2) of whoever stands nearer than the least range, from the returns (N, 3) of a sweep; both in the scanner's frame."""
        c = self._config
        turns = np.arctan2(points[:, 1], points[:, 0]) / (2.0 * math.pi)
        turns = turns[np.isfinite(turns)]
        is_heard = np.bincount(np.floor(turns * c.sectors).astype(np.int64) % c.sectors, minlength=c.sectors) > 0
        self._silent_for = np.where(is_heard, 0, self._silent_for + 1)
        if is_heard.mean() < c.heard:
            return np.zeros((0, 2))
        middles = []
        for begin, width in _runs(~is_heard & (self._silent_for <= c.patience)):
            if c.least <= width <= c.most:
                half = math.pi * width / c.sectors
                away = min(c.radius / math.sin(half), self._range_min + c.radius)
                angle = 2.0 * math.pi * begin / c.sectors + half
                middles.append((away * math.cos(angle), away * math.sin(angle)))
        return np.array(middles).reshape(-1, 2)


def sees_too_late(robot: RobotModel, mount: SensorMount) -> bool:
    """Say whether somebody beside a robot may be nearer to one of its scanners than that can see."""
    x, y, _ = mount.base_from_sensor.translation
    return robot.room_around(x, y) < mount.range_min


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return where each run of set flags on a circle begins, and how long it is; at least one flag is not set."""
    first = int(np.flatnonzero(~flags)[0])
    steps = np.diff(np.concatenate(([0], np.roll(flags, -first).astype(np.int8), [0])))
    begins = np.flatnonzero(steps == 1)
    return list(zip((begins + first).tolist(), (np.flatnonzero(steps == -1) - begins).tolist(), strict=True))
