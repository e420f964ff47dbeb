"""Where an exploration holds still for a dense cloud: whenever it has come `spacing` metres away from every earlier station of its level."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.core.units import Radians

SPACING_LEAST = 1.0  # metres
HOLD_MOST = 300.0  # seconds
PASSAGE_CLEAR = (
    3.0  # metres around a place where one level passes into another: that is the edge of a ramp, and in everybody's way
)
RETRY = 0.5  # of the spacing: how far the robot goes from a place where no station was to be had


@dataclass(frozen=True, slots=True)
class StationsConfig:
    """Stations are `spacing` metres apart in the plane (0: there are none) and last `hold` seconds. Where the base leans by more than `tilt_most` rad, and
    within `PASSAGE_CLEAR` of a passage to another level, there is none."""

    spacing: float = 0.0
    hold: float = 5.0
    tilt_most: Radians = math.radians(7.0)

    def __post_init__(self) -> None:
        if self.spacing != 0.0 and not SPACING_LEAST <= self.spacing < math.inf:
            raise BadInputError(f"stations spacing: 0 (none) or at least {SPACING_LEAST:g} m, not {self.spacing:g} m")
        if not 0.0 < self.hold <= HOLD_MOST:
            raise BadInputError(f"stations hold: more than 0 and at most {HOLD_MOST:g} s, not {self.hold:g} s")
        if not self.tilt_most > 0.0:
            raise BadInputError(f"stations tilt_most: must be positive, is {self.tilt_most:g}")


class Stations:
    """Where stations were held and where they failed, by level."""

    def __init__(self, config: StationsConfig) -> None:
        self._config = config
        self.begin()

    def begin(self) -> None:
        """Forget everything: another exploration begins."""
        self.count = 0
        self._held: dict[int, list[SE2]] = {}
        self._failed: dict[int, list[SE2]] = {}
        self._here: tuple[int, SE2] | None = None

    def is_due(self, level: int, map_from_base: SE2, tilt: float, passages: NDArray[np.float64]) -> bool:
        """Say whether there should be a station where the robot is; it leans by `tilt` rad. `passages` (N, 5) are as in core.messages.GroundLevels."""
        spacing, (x, y) = self._config.spacing, (map_from_base.x, map_from_base.y)
        if spacing <= 0.0 or tilt > self._config.tilt_most:
            return False
        own = passages[passages[:, 0] == level]
        if (np.hypot(own[:, 2] - x, own[:, 3] - y) < PASSAGE_CLEAR).any():
            return False
        is_new = all(place.distance_to(map_from_base) >= spacing for place in self._held.get(level, ()))
        return is_new and all(
            place.distance_to(map_from_base) >= RETRY * spacing for place in self._failed.get(level, ())
        )

    def start(self, level: int, map_from_base: SE2) -> int:
        """Begin a station; returns its number, from 1 on."""
        self._here = (level, map_from_base)
        return self.count + 1

    def end(self, *, is_held: bool) -> None:
        """Note how the station ended."""
        if self._here is None:
            return
        level, place = self._here
        (self._held if is_held else self._failed).setdefault(level, []).append(place)
        self.count += is_held
        self._here = None
