"""A joystick or game pad through Linux evdev: 24-byte event records read from `/dev/input/event*` (or a pipe that carries them).

The records are unpacked here, for the package that would do it (`evdev`) comes without wheels and needs a compiler and kernel
headers. Axes follow ROS: forward and left are positive, the opposite of what evdev says. Kernel: Documentation/input/input.rst.
"""

from __future__ import annotations

import fcntl
import os
import stat
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ambler.core import messages as m
from ambler.core.devices import DeviceHealth, DeviceState
from ambler.core.errors import DeviceError
from ambler.drivers.device_clock import DeviceClock, DeviceStamps

EVENT = struct.Struct("<qqHHi")
"""Seconds, microseconds, type, code, value: `struct input_event` of 64-bit kernels."""
EV_SYN, EV_KEY, EV_ABS = 0x00, 0x01, 0x03
SYN_REPORT, SYN_DROPPED = 0, 3
_ABS_INFO = struct.Struct("<6i")
_ABS_COUNT, _KEY_COUNT = 0x40, 0x300
_FIRST_BUTTON = 0x100
_CLOCK_MONOTONIC = 1
_CHUNK = EVENT.size * 256
REPEAT_NS = 80_000_000
"""A state is told again after this time although nothing changed: at least ten times a second between polls of 20 ms."""


@dataclass(frozen=True, slots=True)
class AxisRange:
    """What an axis tells at its ends; within `flat` of the middle it counts as zero."""

    low: int
    high: int
    flat: int = 0

    def normalized(self, value: int) -> float:
        """Return the value in -1..1, forward and left positive; zero for an axis without a range."""
        half = 0.5 * (self.high - self.low)
        off = value - 0.5 * (self.high + self.low)
        if half <= 0 or abs(off) <= self.flat:
            return 0.0
        return -min(max(off / half, -1.0), 1.0)


@dataclass(frozen=True, slots=True)
class JoystickLayout:
    """Which axes and buttons (evdev codes) a state holds, in this order."""

    axes: Mapping[int, AxisRange]
    buttons: tuple[int, ...]


class EvdevJoystick:
    """A `Joystick`. A device of the kernel tells its own layout; a pipe needs one. Until an axis has told where it is, and from the
    moment on when events were lost or the device is gone, it is zero: no stale deflection drives a robot."""

    poll_period = 0.02

    def __init__(
        self, path: Path, layout: JoystickLayout | None = None, name: str = "joystick", frame: str = "joystick"
    ) -> None:
        self.name, self.frame = name, frame
        self._path, self._given = Path(path), layout
        self._state, self._failure = DeviceState.CLOSED, ""
        self._fd = -1
        self._messages = self._lost = 0
        self._clock = DeviceClock(tick_ns=1000)

    def open(self) -> None:
        """Open the device; raises DeviceError when it is not there or not readable, or tells no layout."""
        if self._state is DeviceState.OPEN:
            return
        self._fd = _open(self._path)
        self._is_kernel = stat.S_ISCHR(os.fstat(self._fd).st_mode)
        try:
            if self._is_kernel or self._given is None:
                fcntl.ioctl(self._fd, _request(1, 0xA0, 4), struct.pack("<i", _CLOCK_MONOTONIC))
            self.layout = self._given if self._given is not None else self._ask_layout()
            self._forget()
        except OSError as error:
            os.close(self._fd)
            raise DeviceError(f"{self._path} is no input device: {error.strerror or error}") from error
        self._clock = DeviceClock(tick_ns=1000)
        self._stamps = DeviceStamps(self._clock)
        self._rest, self._is_skipping = b"", False
        self._told_ns: int | None = None
        self._messages = self._lost = 0
        self._state, self._failure = DeviceState.OPEN, ""

    def health(self) -> DeviceHealth:
        clock = self._clock
        text = self._failure or clock.text
        return DeviceHealth(self._state, text, self._messages, self._lost, clock.jumps, clock.offset)

    def close(self) -> None:
        if self._state is DeviceState.OPEN:
            os.close(self._fd)
        self._state, self._failure = DeviceState.CLOSED, ""

    def read(self, now_ns: int) -> Sequence[m.JoystickState]:
        """Return a state for every report of the device since the last call, or the present one again when it is due."""
        if self._state is not DeviceState.OPEN:
            return ()
        try:
            return self._take(self._receive(), now_ns)
        except OSError as error:
            os.close(self._fd)
            self._state, self._failure = DeviceState.FAILED, f"{self._path} is gone: {error.strerror or error}"
            return ()

    def _take(self, data: bytes, now_ns: int) -> list[m.JoystickState]:
        states = []
        events = [(1_000_000 * s + us, *event) for s, us, *event in EVENT.iter_unpack(data)]
        for ticks, *_ in events:
            self._clock.observe(ticks, now_ns)
        for ticks, kind, code, value in events:
            if kind == EV_SYN and self._synchronize(code):
                states.append(self._tell(self._stamps.to_host(ticks, now_ns)))
            elif kind == EV_ABS and code in self._raw and not self._is_skipping:
                self._raw[code] = value
            elif kind == EV_KEY and code in self._pressed and not self._is_skipping:
                self._pressed[code] = value != 0
        if not states and (self._told_ns is None or now_ns - self._told_ns >= REPEAT_NS):
            states.append(self._tell(now_ns))
        return states

    def _receive(self) -> bytes:
        """Return whole records; raises OSError when the device is gone, even if its last words came with it."""
        data = self._rest
        while True:
            try:
                chunk = os.read(self._fd, _CHUNK)
            except BlockingIOError:
                break
            if not chunk:
                raise OSError("it ended")
            data += chunk
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        return data[:whole]

    def _synchronize(self, code: int) -> bool:
        """Take the end of a report; returns whether the state is whole. After lost events everything up to the next end is old."""
        if code == SYN_DROPPED:
            self._lost += 1
            self._is_skipping = True
            return False
        if code == SYN_REPORT and self._is_skipping:
            self._is_skipping = False
            self._forget()
        return code == SYN_REPORT

    def _tell(self, stamp_ns: int) -> m.JoystickState:
        if self._told_ns is not None:
            stamp_ns = max(stamp_ns, self._told_ns + 1)
        self._told_ns = stamp_ns
        self._messages += 1
        axes = [0.0 if v is None else self.layout.axes[c].normalized(v) for c, v in self._raw.items()]
        buttons = np.array(list(self._pressed.values()), np.uint8)
        return m.JoystickState(stamp_ns, self.frame, np.array(axes, np.float32), buttons)

    def _forget(self) -> None:
        """Forget where axes and buttons were; the kernel is asked where they are."""
        self._raw: dict[int, int | None] = dict.fromkeys(self.layout.axes)
        self._pressed = dict.fromkeys(self.layout.buttons, False)
        if self._is_kernel:
            for code in self._raw:
                self._raw[code] = _ABS_INFO.unpack(_ask(self._fd, 0x40 + code, _ABS_INFO.size))[0]
            down = _bits(_ask(self._fd, 0x18, _KEY_COUNT // 8))
            self._pressed = {code: code in down for code in self._pressed}

    def _ask_layout(self) -> JoystickLayout:
        """Ask the kernel for the axes with their ranges and for the buttons."""
        axes = {}
        for code in sorted(_bits(_ask(self._fd, 0x20 + EV_ABS, _ABS_COUNT // 8))):
            _, low, high, _, flat, _ = _ABS_INFO.unpack(_ask(self._fd, 0x40 + code, _ABS_INFO.size))
            axes[code] = AxisRange(low, high, flat)
        buttons = sorted(c for c in _bits(_ask(self._fd, 0x20 + EV_KEY, _KEY_COUNT // 8)) if c >= _FIRST_BUTTON)
        return JoystickLayout(axes, tuple(buttons))


def _open(path: Path) -> int:
    try:
        return os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise DeviceError(f"{path} cannot be opened: {error.strerror or error}") from error


def _request(direction: int, number: int, size: int) -> int:
    """Build the number of an ioctl of evdev (magic 'E'): direction 1 writes, 2 reads."""
    return direction << 30 | size << 16 | ord("E") << 8 | number


def _ask(fd: int, number: int, size: int) -> bytes:
    return fcntl.ioctl(fd, _request(2, number, size), bytes(size))


def _bits(data: bytes) -> set[int]:
    return {8 * i + bit for i, byte in enumerate(data) for bit in range(8) if byte >> bit & 1}
