"""A robot as data: what algorithms know of it, and the rest of its shape."""

from __future__ import annotations

from dataclasses import dataclass

from ambler.core.robot import RobotModel


@dataclass(frozen=True, slots=True)
class Chassis:
    """The body is a prism over the footprint from `body_bottom` to the model's body height (m). `wheel_radius` (0: legs) and `track`
    describe driven wheels; with a `wheel_base` (distance of the axles) there are four mecanum wheels, else two."""

    body_bottom: float
    wheel_radius: float = 0.0
    track: float = 0.0
    wheel_base: float = 0.0

    @property
    def has_two_wheels(self) -> bool:
        return self.wheel_radius > 0 and self.wheel_base == 0

    @property
    def has_mecanum_wheels(self) -> bool:
        return self.wheel_radius > 0 and self.wheel_base > 0


@dataclass(frozen=True)
class RobotDescription:
    """A robot: its model and its chassis."""

    model: RobotModel
    chassis: Chassis
