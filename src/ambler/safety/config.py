"""What the velocity gate is told once: its sources, its timeouts, and the numbers of the protective field."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ambler.core.errors import BadInputError
from ambler.core.units import Radians

MIN_POINTS_MOST = 10  # a leg is not many more: the gate would look through it


@dataclass(frozen=True, slots=True)
class VelocitySource:
    """Somebody who may ask for a velocity. The highest priority that is not older than `timeout` seconds drives."""

    name: str
    priority: int
    timeout: float


@dataclass(frozen=True, slots=True)
class GateConfig:
    """Numbers of the gate, SI. Limits of the robot come from its model, not from here.

    reaction_time      from a command to the base obeying it, including one period of the gate
    margin             distance that the footprint keeps from every point
    min_points         points that must agree before they count as an obstacle (one alone may be noise)
    stop_scale         below this share of the wanted speed the gate stops for good: a protective stop
    resume_scale       from this share on the field counts as clear
    resume_delay       how long the field must be clear before motion resumes
    stale_delay        how long input must be fresh again before motion resumes
    max_step_gap       a longer pause between two steps means that the gate was starved
    max_future         a stamp further ahead of the clock than this is refused
    self_depth         points deeper than this inside the footprint are the robot itself
    slope              steepest floor (m per m) that points of a cloud may show without being obstacles; 0: the floor is level. What stands on a slope counts
                       from there
    tipped             radians off the vertical from which on a base lies on its side: stairs and ramps stay below 40°
    tipped_time        seconds for which it must, before it is believed
    memory_travel      metres of the outermost corner after which a point that no scanner can see any more is forgotten; what was turned back counts a tenth
    """

    sources: tuple[VelocitySource, ...] = (
        VelocitySource("teleop", 100, 0.4),
        VelocitySource("docking", 20, 0.3),
        VelocitySource("navigation", 10, 0.3),
    )
    reaction_time: float = 0.2
    margin: float = 0.03
    min_points: int = 2
    stop_scale: float = 0.1
    resume_scale: float = 0.3
    resume_delay: float = 2.0
    stale_delay: float = 0.5
    points_timeout: float = 0.5
    odometry_timeout: float = 0.3
    max_step_gap: float = 0.25
    max_future: float = 0.1
    self_depth: float = 0.05
    slope: float = 0.0
    tipped: Radians = math.radians(50.0)
    tipped_time: float = 0.3
    memory_travel: float = 12.0

    def __post_init__(self) -> None:
        times = ("reaction_time", "points_timeout", "odometry_timeout", "max_step_gap")
        for name in (*times, "tipped", "tipped_time"):
            if getattr(self, name) <= 0.0:
                raise BadInputError(f"gate.{name} must be positive, not {getattr(self, name):g}")
        for name in ("margin", "resume_delay", "stale_delay", "max_future", "self_depth", "slope", "memory_travel"):
            if getattr(self, name) < 0.0:
                raise BadInputError(f"gate.{name} must not be negative, and is {getattr(self, name):g}")
        if not 1 <= self.min_points <= MIN_POINTS_MOST:
            raise BadInputError(f"gate.min_points must be 1 to {MIN_POINTS_MOST}, not {self.min_points}")
        if not 0.0 < self.stop_scale <= self.resume_scale <= 1.0:
            raise BadInputError("gate.stop_scale and resume_scale must rise within 0 … 1")
        if len({source.name for source in self.sources}) != len(self.sources) or not self.sources:
            raise BadInputError("gate.sources must name who may drive, everyone once")
        for source in self.sources:
            if source.timeout <= 0.0:
                raise BadInputError(
                    f"gate.sources: the timeout of {source.name} must be positive, not {source.timeout:g}"
                )
