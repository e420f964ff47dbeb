"""A base, and its battery, at the other end of a serial line (frames: docs/drivers.md; the line itself: `serial_link`).

The driver never repeats a command: whoever drives must send anew within the base's watchdog, so a node that hangs stops the robot.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from ambler.core import messages as m
from ambler.core.devices import DeviceHealth
from ambler.core.protocols import BodyVelocity
from ambler.core.se3 import SE3
from ambler.drivers.device_clock import DeviceStamps
from ambler.drivers.serial_frame import BATTERY, ODOMETRY, VELOCITY, Frame, FrameKind
from ambler.drivers.serial_link import SerialLink

M = TypeVar("M")

QUEUE = 256
"""Messages that wait for a node that is late; then the oldest are lost, and counted."""
ROTATION_ERROR = 0.01
"""By how much the length of a quaternion may differ from 1; other frames are dropped."""
_SUPPLIES = frozenset(int(supply) for supply in m.PowerSupply)


@dataclass(frozen=True, slots=True)
class SerialBaseConfig:
    """How the base is reached, and how far its dead reckoning is trusted, which no frame tells: variances of its velocity along x, y
    and about z, and by what share of the path and of the turning its pose errs (one sigma)."""

    baud: int = 115_200
    frame: str = "odom"
    child: str = "base"
    battery_frame: str = "base"
    twist_variance: tuple[float, float, float] = (1e-3, 1e-3, 1e-3)
    path_error: float = 0.02
    turn_error: float = 0.02
    turn_per_path: float = 0.01


class SerialBase:
    """A `Base` over a serial line; `battery` is the `Battery` on the same line. `now_ns` is the host's clock, the executor's."""

    poll_period = 0.01

    def __init__(
        self,
        path: Path,
        now_ns: Callable[[], int],
        config: SerialBaseConfig | None = None,
        name: str = "serial_base",
    ) -> None:
        self.name = name
        self.config = config if config is not None else SerialBaseConfig()
        self._link = SerialLink(Path(path), now_ns, self.config.baud)
        self._link.receive(FrameKind.ODOMETRY, self, self._on_odometry)
        self._queue: deque[m.Odometry] = deque(maxlen=QUEUE)
        self._begin()
        self.battery = SerialBattery(self._link, self.config.battery_frame, f"{name}.battery")

    def _begin(self) -> None:
        self._queue.clear()
        self._stamps = DeviceStamps(self._link.clock)
        self._messages = self._dropped = 0
        self._path = self._turned = 0.0
        self._last: SE3 | None = None

    @property
    def watchdog(self) -> float:
        """Seconds after which the base stops by itself, as it said when it was opened (WATCHDOG_MAX before)."""
        return self._link.watchdog

    @property
    def robot_name(self) -> str:
        """What the base calls itself and the version of its firmware."""
        return f"{self._link.robot_name} {self._link.firmware}".strip()

    @property
    def damaged(self) -> int:
        """Pieces of bytes on the line that were no frames."""
        return self._link.reader.damaged

    def open(self) -> None:
        """Open the line and ask the base who it is; raises DeviceError. Opens a broken line anew."""
        if self._link.is_open(self):
            return
        self._begin()
        self._link.open(self)

    def health(self) -> DeviceHealth:
        return self._link.health(self, self._messages, self._dropped + self._link.reader.lost)

    def close(self) -> None:
        if self._link.is_open(self):
            self._link.send(FrameKind.STOP)
        self._link.close(self)
        self._queue.clear()

    def command(self, velocity: BodyVelocity) -> None:
        """Send a velocity; one that is not finite is a stop."""
        if not self._link.is_open(self):
            return
        values = (velocity.vx, velocity.vy, velocity.wz)
        if all(map(math.isfinite, values)):
            self._link.send(FrameKind.VELOCITY, VELOCITY.pack(*values))
        else:
            self._link.send(FrameKind.STOP)

    def read(self, now_ns: int) -> Sequence[m.Odometry]:
        return _drain(self._queue) if self._link.is_open(self) else ()

    def _on_odometry(self, frame: Frame, arrival_ns: int) -> None:
        if len(frame.payload) != ODOMETRY.size:
            return
        stamp_us, x, y, z, qw, qx, qy, qz, *twist = ODOMETRY.unpack(frame.payload)
        is_rotation = abs(math.hypot(qw, qx, qy, qz) - 1.0) < ROTATION_ERROR
        if not is_rotation or not all(map(math.isfinite, (x, y, z, *twist))):
            return
        pose = SE3((x, y, z), (qw, qx, qy, qz))
        if self._stamps.clock is not self._link.clock:
            self._stamps = DeviceStamps(self._link.clock)
        self._grow(pose)
        self._messages += 1
        self._dropped += len(self._queue) == QUEUE
        self._queue.append(
            m.Odometry(
                self._stamps.to_host(stamp_us, arrival_ns),
                self.config.frame,
                self.config.child,
                pose,
                (twist[0], twist[1], twist[2]),
                (twist[3], twist[4], twist[5]),
                self._pose_covariance(),
                self._twist_covariance(),
            )
        )

    def _grow(self, pose: SE3) -> None:
        """Add up path and turning, by which the pose's covariance grows."""
        if self._last is not None:
            step = self._last.inverse() @ pose
            self._path += math.hypot(step.translation[0], step.translation[1])
            self._turned += abs(step.to_se2().yaw)
        self._last = pose

    def _pose_covariance(self) -> m.F64:
        config = self.config
        along = (config.path_error * self._path) ** 2 + 1e-6
        turn = (config.turn_error * self._turned) ** 2 + (config.turn_per_path * self._path) ** 2 + 1e-6
        return np.diag([along, along, 1e-6, 1e-6, 1e-6, turn])

    def _twist_covariance(self) -> m.F64:
        vx, vy, wz = self.config.twist_variance
        return np.diag([vx, vy, 1e-6, 1e-6, 1e-6, wz])


class SerialBattery:
    """The `Battery` on a base's line."""

    poll_period = 0.1

    def __init__(self, link: SerialLink, frame: str, name: str) -> None:
        self.name = name
        self._link, self._frame = link, frame
        link.receive(FrameKind.BATTERY, self, self._on_battery)
        self._queue: deque[m.BatteryState] = deque(maxlen=QUEUE)
        self._begin()

    def _begin(self) -> None:
        self._queue.clear()
        self._stamps = DeviceStamps(self._link.clock)
        self._messages = self._dropped = 0

    def open(self) -> None:
        """Open the line unless the base has done so; raises DeviceError."""
        if self._link.is_open(self):
            return
        self._begin()
        self._link.open(self)

    def health(self) -> DeviceHealth:
        return self._link.health(self, self._messages, self._dropped + self._link.reader.lost)

    def close(self) -> None:
        self._link.close(self)
        self._queue.clear()

    def read(self, now_ns: int) -> Sequence[m.BatteryState]:
        return _drain(self._queue) if self._link.is_open(self) else ()

    def stop_charging(self) -> None:
        if self._link.is_open(self):
            self._link.send(FrameKind.STOP_CHARGING)

    def _on_battery(self, frame: Frame, arrival_ns: int) -> None:
        if len(frame.payload) != BATTERY.size:
            return
        stamp_us, voltage, current, share, supply = BATTERY.unpack(frame.payload)
        if supply not in _SUPPLIES:
            return
        if self._stamps.clock is not self._link.clock:
            self._stamps = DeviceStamps(self._link.clock)
        stamp_ns = self._stamps.to_host(stamp_us, arrival_ns)
        self._messages += 1
        self._dropped += len(self._queue) == QUEUE
        self._queue.append(m.BatteryState(stamp_ns, self._frame, voltage, current, share, m.PowerSupply(supply)))


def _drain(queue: deque[M]) -> list[M]:
    """Take what waits; the thread of the line may append meanwhile."""
    return [queue.popleft() for _ in range(len(queue))]
