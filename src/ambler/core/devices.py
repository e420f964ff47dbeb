"""What a robot is made of: devices behind Protocols. The simulator supplies simulated ones, `drivers` real ones, a recording recorded ones.

Life of a device: `open` (raises DeviceError), then `read` again and again, `health` at any time, `close` once. `read` never waits: it
returns what has come since the last call, oldest first. Stamps are instants of the host's clock, the executor's; a driver translates
those of the device at its border and counts jumps. A device whose line breaks becomes FAILED and returns nothing; it does not raise.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.protocols import BodyVelocity

WATCHDOG_MAX = 0.5
"""Seconds after which every base must have stopped by itself when no command comes."""


class DeviceState(enum.Enum):
    """Where a device is in its life."""

    CLOSED = "closed"
    OPEN = "open"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class DeviceHealth:
    """How a device does: `text` is one sentence, empty while all is well; `messages` were delivered, `lost` got lost on the line, were
    damaged, or came too fast; `clock_jumps` of the device's clock, whose `clock_offset` (host minus device, seconds) is None where the
    device has no clock of its own."""

    state: DeviceState
    text: str = ""
    messages: int = 0
    lost: int = 0
    clock_jumps: int = 0
    clock_offset: float | None = None


class Device(Protocol):
    """What all devices share. `poll_period` is how often (s) its node should read it."""

    @property
    def name(self) -> str: ...

    @property
    def poll_period(self) -> float: ...

    def open(self) -> None:
        """Begin; raises DeviceError with one sentence when the device is not there or does not answer. `read` is allowed from now on."""
        ...

    def health(self) -> DeviceHealth:
        """Return how it does; never waits."""
        ...

    def close(self) -> None:
        """End; a base stops first. Calling it again does nothing."""
        ...


@runtime_checkable
class Announces(Protocol):
    """A device that says when there is something to read, so that nobody has to look again and again."""

    def announce(self, tell: Callable[[], None]) -> None:
        """From now on call `tell`, from any thread, when something has come since the last `read`."""
        ...


M_co = TypeVar("M_co", covariant=True)


class Sensor(Device, Protocol[M_co]):
    """A device that measures. `frame` is its mount's in the robot model."""

    @property
    def frame(self) -> str: ...

    def read(self, now_ns: int) -> Sequence[M_co]:
        """Return what was measured since the last call, oldest first; `now_ns` is the executor's time."""
        ...


class Lidar(Sensor[m.LaserScan | m.PointCloud], Protocol):
    """A planar scanner or one of many rings; each always sends the same of the two kinds."""


class Imu(Sensor[m.Imu], Protocol):
    """An inertial measurement unit."""


class RangeSensor(Sensor[m.Range], Protocol):
    """A transducer that tells one distance within a cone."""


class Camera(Sensor[m.Image], Protocol):
    """A camera, of grey pictures or of depth. Pictures cost much: it takes them only while they are wanted."""

    @property
    def model(self) -> CameraModel:
        """How it projects, as it was calibrated."""
        ...

    def request(self, until_ns: int) -> None:
        """Take pictures until that instant; a later request prolongs it, an earlier one does not shorten it."""
        ...


class Battery(Device, Protocol):
    """A battery with its charger's contacts."""

    def read(self, now_ns: int) -> Sequence[m.BatteryState]: ...

    def stop_charging(self) -> None:
        """Let no current flow until the contacts have opened."""
        ...


class Base(Device, Protocol):
    """What drives. It stops by itself when no command has come for `watchdog` seconds (at most WATCHDOG_MAX)."""

    @property
    def watchdog(self) -> float: ...

    def command(self, velocity: BodyVelocity) -> None:
        """Take a velocity in the base frame; never waits, never raises."""
        ...

    def read(self, now_ns: int) -> Sequence[m.Odometry]:
        """Return the base's own dead reckoning, `odom_from_base` with the velocity in the base frame."""
        ...


class Legs(Protocol):
    """What a base that walks can do besides walking. While it does not stand it obeys no velocity."""

    def stand(self) -> None:
        """Rise, within a second or two; standing already is no error."""
        ...

    def sit(self) -> None:
        """Halt and sit down."""
        ...


class Joystick(Device, Protocol):
    """Something a person holds."""

    def read(self, now_ns: int) -> Sequence[m.JoystickState]:
        """Return the newest state of axes and buttons whenever something changed, and at least ten times a second while it is there."""
        ...


@dataclass(frozen=True, slots=True)
class RobotDevices:
    """The devices of one robot, each of a kind in the order of its mounts; what it does not have is empty or None."""

    base: Base
    lidars: tuple[Lidar, ...] = ()
    imus: tuple[Imu, ...] = ()
    ranges: tuple[RangeSensor, ...] = ()
    cameras: tuple[Camera, ...] = ()
    depth_cameras: tuple[Camera, ...] = ()
    battery: Battery | None = None
    joystick: Joystick | None = None
    legs: Legs | None = None
