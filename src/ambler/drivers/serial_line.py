"""A serial line in raw mode through the standard library: termios does all that a base needs, so there is no dependency on pyserial,
whose last release is of 2020 and whose reads hide when the line has hung up."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import termios
import tty
from pathlib import Path

from ambler.core.errors import DeviceError
from ambler.drivers.shared_link import LinkBrokenError

CHUNK = 4096


class SerialLine:
    """Eight bits, no parity, one stop bit, no flow control. Nothing here waits but `wait`. Raises DeviceError when it cannot be opened
    or another program of ours has it."""

    def __init__(self, path: Path, baud: int) -> None:
        self._fd = _open(path, baud)

    def wait(self, seconds: float) -> bool:
        """Wait until bytes are there or the line broke; returns False when neither happened in time."""
        return bool(select.select((self._fd,), (), (), seconds)[0])

    def read(self) -> bytes:
        """Return the bytes that have come, empty when there are none; raises LinkBrokenError."""
        try:
            data = os.read(self._fd, CHUNK)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkBrokenError(error.strerror or str(error)) from error
        if not data:
            raise LinkBrokenError("hung up")
        return data

    def write(self, data: bytes) -> bool:
        """Hand bytes to the line; returns False when it did not take all of them at once. Raises LinkBrokenError."""
        try:
            return os.write(self._fd, data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            raise LinkBrokenError(error.strerror or str(error)) from error

    def close(self) -> None:
        """Give the line back."""
        os.close(self._fd)


def _open(path: Path, baud: int) -> int:
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise DeviceError(f"{path}: {baud} baud is no speed of serial lines")
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise DeviceError(f"{path} cannot be opened: {error.strerror or error}") from error
    with contextlib.ExitStack() as undo:
        undo.callback(os.close, fd)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _make_raw(fd, speed)
        except BlockingIOError as error:
            raise DeviceError(f"{path} is in use by another program") from error
        except termios.error as error:
            raise DeviceError(f"{path} is no serial line") from error
        undo.pop_all()
    return fd


def _make_raw(fd: int, speed: int) -> None:
    """VMIN of 1 makes an empty read mean a line that hung up; without HUPCL closing does not reset boards that watch DTR."""
    tty.setraw(fd)
    attributes = termios.tcgetattr(fd)
    flags = attributes[2] & ~(termios.HUPCL | termios.CSTOPB | termios.PARENB | termios.CRTSCTS)
    attributes[2] = flags | termios.CLOCAL | termios.CREAD
    attributes[4] = attributes[5] = speed
    attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 1, 0
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
    termios.tcflush(fd, termios.TCIOFLUSH)
