"""What a robot learns while it stands docked: how far what it sees lies from where it stands.

Where camera and markers sit, what the lens does and how the floor leans is the same at every docking; so is what they make of the docked
pose. The dock's `offset` takes it out, exactly at the docked pose and more the nearer to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2


@dataclass(frozen=True, slots=True)
class LessonConfig:
    """`sightings` that a lesson takes (of a V shape, whose single yaw is good to 0.4°, their mean is good to 0.05°), `least` of them that it
    needs, `seconds` that it may last. `most`: metres and radians by which what is seen may differ from what is told; beyond, the dock is
    described wrongly. `outlier`: distance from the median, in spreads."""

    sightings: int = 60
    least: int = 20
    seconds: float = 30.0
    most: tuple[float, float] = (0.05, math.radians(3.0))
    outlier: float = 4.0


class DockLesson:
    """Collects detections of the dock in which the robot stands."""

    def __init__(self, config: LessonConfig | None = None) -> None:
        self.config = config if config is not None else LessonConfig()
        self._seen: list[tuple[float, float, float]] = []

    @property
    def count(self) -> int:
        """How many detections there are."""
        return len(self._seen)

    @property
    def is_full(self) -> bool:
        """Whether there are as many as wanted."""
        return self.count >= self.config.sightings

    def add(self, base_from_dock: SE2) -> None:
        """Take a detection without any offset."""
        self._seen.append((base_from_dock.x, base_from_dock.y, base_from_dock.yaw))

    def offset(self) -> SE2:
        """Return what must be added to every detection, in the dock frame, so that the docked pose is where the robot stands.

        Raises BadInputError for too few detections, and when they lie farther off than mounting and printing can explain.
        """
        c = self.config
        if self.count < c.least:
            raise BadInputError(f"the dock was seen {self.count} times in {c.seconds:g} s; {c.least} are needed")
        seen = np.array(self._seen)
        away = np.abs(seen - np.median(seen, axis=0))
        spread = 1.4826 * np.median(away, axis=0) + 1e-6
        x, y, yaw = seen[(away <= c.outlier * spread).all(axis=1)].mean(axis=0).tolist()
        if math.hypot(x, y) > c.most[0] or abs(yaw) > c.most[1]:
            raise BadInputError(
                f"the dock is seen {1e3 * math.hypot(x, y):.0f} mm and {math.degrees(yaw):.1f}° from where it is described: "
                "the robot does not stand in it, or its marks are not those of the file"
            )
        return SE2(x, y, yaw).inverse()
