"""What every room must know about the robot: footprint, limits, drive, and where its sensors sit."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import LaserScan, PointCloud, Range
from ambler.core.se3 import SE3

Measured = TypeVar("Measured", bound=LaserScan | PointCloud | Range)

MERGED_FRAME = "merged"
"""The frame of the virtual scanner that several planar scanners are merged into."""


class DriveKind(enum.Enum):
    """How a base moves."""

    DIFFERENTIAL = "differential"
    OMNI = "omni"


@dataclass(frozen=True, slots=True)
class VelocityLimits:
    """Limits of the base, SI: forward, backward (negative), sideways, yaw rate; accelerations and decelerations are positive.

    `ax_brake` and `ay_brake` are the decelerations that are planned with; `ax_stop` and `ay_stop` those with which the base's own
    controller obeys a sudden zero (an emergency stop, its watchdog), when it matters more to stand than to stand gently.
    """

    vx_max: float = 0.8
    vx_min: float = -0.3
    vy_max: float = 0.0
    wz_max: float = 1.5
    ax_max: float = 1.0
    ay_max: float = 1.0
    az_max: float = 2.5
    ax_brake: float = 1.5
    ay_brake: float = 1.5
    ax_stop: float = 3.0
    ay_stop: float = 3.0


class SensorKind(enum.StrEnum):
    """What a sensor measures. `nodes.devices.table` says which node reads a kind and on which topics it is told."""

    SCAN = "scan"
    CLOUD = "cloud"
    RANGE = "range"
    IMU = "imu"
    CAMERA = "camera"
    DEPTH = "depth"


@dataclass(frozen=True, slots=True)
class SensorMount:
    """A sensor and its pose; `frame` names it in the transform tree. A scanner measures
    nothing nearer than `range_min` (m) and nothing well beyond `range_max`, of a scan nothing outside the `azimuth` limits and of a cloud nothing outside the
    `elevation` limits (rad). Its stamps are `clock_offset` seconds ahead: what is stamped t was measured at t - clock_offset
    (calibration finds it of planar scanners; of clouds only the gate asks for it)."""

    frame: str
    kind: SensorKind
    base_from_sensor: SE3
    range_min: float = 0.0
    elevation: tuple[float, float] = (-math.pi, math.pi)
    azimuth: tuple[float, float] = (-math.pi, math.pi)
    range_max: float = math.inf
    clock_offset: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", SensorKind(self.kind))  # words of a file become kinds

    @property
    def sees_floor_from(self) -> float:
        """How far ahead of a level base its lowest beam meets the floor, metres; inf where none does."""
        rise = self.base_from_sensor.rotate((1.0, 0.0, 0.0))[2]
        down = -self.elevation[0] - math.asin(max(-1.0, min(1.0, rise)))
        if down >= 0.5 * math.pi:
            return 0.0
        x, _, z = self.base_from_sensor.translation
        return x + z / math.tan(down) if down > 0.0 else math.inf


@dataclass(frozen=True)
class RobotModel:
    """A robot as its algorithms see it. `footprint` is a convex polygon (N, 2) in the base frame, counter-clockwise."""

    name: str
    drive: DriveKind
    footprint: NDArray[np.float64]
    limits: VelocityLimits
    sensors: tuple[SensorMount, ...] = field(default=())
    body_height: float = 0.5

    @property
    def inscribed_radius(self) -> float:
        """Largest circle about the base origin inside the footprint, metres."""
        return self.room_around(0.0, 0.0)

    def room_around(self, x: float, y: float) -> float:
        """Return the radius of the largest circle about a place inside the (convex) footprint, metres."""
        a = self.footprint - (x, y)
        edge = np.roll(a, -1, axis=0) - a
        cross = edge[:, 0] * a[:, 1] - edge[:, 1] * a[:, 0]
        return float(np.min(np.abs(cross) / np.hypot(edge[:, 0], edge[:, 1])))

    @property
    def circumscribed_radius(self) -> float:
        """Smallest circle about the base origin that contains the footprint, metres."""
        return float(np.max(np.hypot(self.footprint[:, 0], self.footprint[:, 1])))

    @property
    def scanners(self) -> tuple[SensorMount, ...]:
        """The planar scanners themselves, without the virtual one that several of them are merged into."""
        return tuple(m for m in self.sensors if m.kind is SensorKind.SCAN and m.frame != MERGED_FRAME)

    @property
    def rangers(self) -> tuple[SensorMount, ...]:
        """The ultrasonic transducers; they look along their x axis."""
        return tuple(m for m in self.sensors if m.kind is SensorKind.RANGE)

    @property
    def clouds(self) -> tuple[SensorMount, ...]:
        """The scanners of many rings."""
        return self.of_kind(SensorKind.CLOUD)

    @property
    def depth_cameras(self) -> tuple[SensorMount, ...]:
        """The cameras that measure distances; their frames are optical."""
        return self.of_kind(SensorKind.DEPTH)

    @property
    def top(self) -> float:
        """Height of the body and of all that is mounted on it, metres above the floor."""
        return max([self.body_height, *(m.base_from_sensor.translation[2] for m in self.sensors)])

    @property
    def camera(self) -> SensorMount | None:
        """The first camera, None when there is none."""
        return next((m for m in self.sensors if m.kind is SensorKind.CAMERA), None)

    def of_kind(self, kind: SensorKind) -> tuple[SensorMount, ...]:
        """Return the mounts of a kind, in their order."""
        return tuple(m for m in self.sensors if m.kind is kind)

    def timed(self, message: Measured) -> Measured:
        """Return a sensor's message with the stamp of when it was measured (`SensorMount.clock_offset`); others as they are."""
        ahead = next((m.clock_offset for m in self.sensors if m.frame == message.frame), 0.0)
        return replace(message, stamp_ns=message.stamp_ns - round(ahead * 1e9)) if ahead else message

    def sensor(self, frame: str) -> SensorMount:
        """Return the sensor mounted as `frame`; raises KeyError with the known names."""
        for mount in self.sensors:
            if mount.frame == frame:
                return mount
        raise KeyError(f"robot {self.name} has no sensor {frame!r}, only {[m.frame for m in self.sensors]}")
