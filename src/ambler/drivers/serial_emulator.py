"""The base's end of the serial line on a pseudo-terminal: what a controller's firmware does, for tests and for the simulator process.

It owns no thread: whoever runs it calls `step`. It stops its base when no velocity has come for the watchdog's time, whatever the
line does, as firmware must.
"""

from __future__ import annotations

import contextlib
import math
import os
import pty
import tty
from dataclasses import dataclass
from pathlib import Path

from ambler.core import messages as m
from ambler.core.devices import Base, Battery
from ambler.core.protocols import BodyVelocity
from ambler.drivers.serial_frame import (
    BATTERY,
    FAULT,
    INFO,
    ODOMETRY,
    STAMP_MASK,
    VELOCITY,
    VERSION,
    Frame,
    FrameKind,
    FrameReader,
    FrameWriter,
)
from ambler.drivers.serial_line import CHUNK


@dataclass(frozen=True, slots=True)
class EmulatorConfig:
    """What the firmware says of itself, and its clock: it stands `clock_offset` s from the one that steps it and drifts by
    `clock_drift` (s/s)."""

    name: str = "emulated base"
    firmware: str = "1"
    watchdog: float = 0.2
    clock_offset: float = 0.0
    clock_drift: float = 0.0

    def device_ns(self, now_ns: int) -> int:
        """Return what its clock says at an instant."""
        return now_ns + round(self.clock_offset * 1e9) + round(self.clock_drift * now_ns)


class SerialEmulator:
    """Gives what comes over the line to `base` and `battery`, and what they read back onto it. With `link`, a symbolic link leads to
    the pseudo-terminal, which has another path whenever it is plugged in."""

    def __init__(
        self,
        base: Base,
        battery: Battery | None = None,
        config: EmulatorConfig | None = None,
        link: Path | None = None,
    ) -> None:
        self._base, self._battery = base, battery
        self.config = config if config is not None else EmulatorConfig()
        self._link = link
        self._ends: tuple[int, int] | None = None
        self._commanded_ns: int | None = None
        self.commands = self.unsent = 0
        """Velocities taken; frames that nobody fetched in time."""
        self.plug()

    @property
    def path(self) -> Path:
        """Where a driver finds the line; raises ValueError while it is unplugged."""
        if self._ends is None:
            raise ValueError("the line is unplugged")
        return self._link if self._link is not None else Path(os.ttyname(self._ends[1]))

    def plug(self) -> None:
        """Make the line, unless it is there. Both its ends are kept, so that it waits for a driver without hanging up."""
        if self._ends is not None:
            return
        self._ends = master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._reader, self._writer = FrameReader(), FrameWriter()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(os.ttyname(slave))

    def unplug(self) -> None:
        """Pull the cable. The watchdog goes on with every `step`."""
        if self._ends is not None:
            for end in self._ends:
                os.close(end)
        self._ends = None
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def step(self, now_ns: int) -> None:
        """Do what the firmware does in one turn of its loop: commands in, watchdog, measurements out."""
        self._take_commands(now_ns)
        if self._commanded_ns is not None and now_ns - self._commanded_ns >= self.config.watchdog * 1e9:
            self._stop()
        measured: list[m.Odometry | m.BatteryState] = list(self._base.read(now_ns))
        if self._battery is not None:
            measured += self._battery.read(now_ns)
        for message in sorted(measured, key=lambda message: message.stamp_ns):
            self._tell(message, now_ns)

    def report_fault(self, code: int, text: str, now_ns: int) -> None:
        """Tell the host that the base cannot go on."""
        self._send(FrameKind.FAULT, FAULT.pack(code) + text.encode()[:200], now_ns)

    def send_raw(self, data: bytes) -> None:
        """Put bytes on the line as they are: noise, for tests."""
        if self._ends is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._ends[0], data)

    def _take_commands(self, now_ns: int) -> None:
        if self._ends is None:
            return
        try:
            data = os.read(self._ends[0], CHUNK)
        except BlockingIOError:
            return
        for frame in self._reader.feed(data):
            if frame.version == VERSION:
                self._obey(frame, now_ns)

    def _obey(self, frame: Frame, now_ns: int) -> None:
        if frame.kind == FrameKind.VELOCITY and len(frame.payload) == VELOCITY.size:
            velocity = VELOCITY.unpack(frame.payload)
            if all(map(math.isfinite, velocity)):
                self.commands += 1
                self._commanded_ns = now_ns
                self._base.command(BodyVelocity(*velocity))
            else:
                self._stop()
        elif frame.kind == FrameKind.STOP:
            self._stop()
        elif frame.kind == FrameKind.REQUEST_INFO:
            self._introduce(now_ns)
        elif frame.kind == FrameKind.STOP_CHARGING and self._battery is not None:
            self._battery.stop_charging()

    def _stop(self) -> None:
        self._commanded_ns = None
        self._base.command(BodyVelocity())

    def _introduce(self, now_ns: int) -> None:
        config = self.config
        payload = INFO.pack(round(config.watchdog * 1000), config.name.encode(), config.firmware.encode())
        self._send(FrameKind.INFO, payload, now_ns)

    def _tell(self, message: m.Odometry | m.BatteryState, now_ns: int) -> None:
        stamp_us = self._device_us(message.stamp_ns)
        if isinstance(message, m.Odometry):
            numbers = (*message.pose.translation, *message.pose.rotation, *message.linear, *message.angular)
            self._send(FrameKind.ODOMETRY, ODOMETRY.pack(stamp_us, *numbers), now_ns)
        else:
            supply = int(message.supply)
            payload = BATTERY.pack(stamp_us, message.voltage, message.current, message.share, supply)
            self._send(FrameKind.BATTERY, payload, now_ns)

    def _device_us(self, now_ns: int) -> int:
        return (self.config.device_ns(now_ns) // 1000) & STAMP_MASK

    def _send(self, kind: FrameKind, payload: bytes, now_ns: int) -> None:
        if self._ends is None:
            return
        data = self._writer.encode(kind, self._device_us(now_ns), payload)
        try:
            self.unsent += os.write(self._ends[0], data) != len(data)
        except BlockingIOError:
            self.unsent += 1
