"""Frames of sensors over a local socket: length, header, name, ROS type, CDR (docs/drivers.md has the table)."""

from __future__ import annotations

import enum
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from ambler.core.errors import BadInputError, DeviceError

VERSION = 1
FRAME_MAX = 64 << 20
"""Bytes of a frame; more is taken for garbage."""
_LENGTH = struct.Struct("<I")
_HEADER = struct.Struct("<BBBxIq")
SECONDS = struct.Struct("<d")


class StreamKind(enum.IntEnum):
    """What a frame is: HELLO, MESSAGE and TIME come from the server, PICTURES and STOP_CHARGING from the client."""

    HELLO = 1
    MESSAGE = 2
    TIME = 3
    PICTURES = 16
    STOP_CHARGING = 17


@dataclass(frozen=True, slots=True)
class StreamFrame:
    """One frame: `device` is whom it concerns, `sequence` counts the messages of that device, `sent_ns` is when it left by the sender's
    own clock, which also stamped the message in `body`; `ros_type` says what that is."""

    kind: int
    device: str = ""
    ros_type: str = ""
    sequence: int = 0
    sent_ns: int = 0
    body: bytes = b""

    def encode(self) -> bytes:
        """Return the frame as it travels."""
        name, ros_type = self.device.encode(), self.ros_type.encode()
        header = _HEADER.pack(self.kind, len(name), len(ros_type), self.sequence, self.sent_ns)
        length = _LENGTH.pack(len(header) + len(name) + len(ros_type) + len(self.body))
        return b"".join((length, header, name, ros_type, self.body))


class StreamReader:
    """Cuts a stream of bytes into frames. A local socket loses nothing, so what is no frame raises BadInputError: the other end speaks
    something else."""

    def __init__(self) -> None:
        self._data = bytearray()

    def feed(self, data: bytes) -> Iterator[StreamFrame]:
        """Take the next bytes; yields the frames that they completed."""
        self._data += data
        while len(self._data) >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._data)
            if not _HEADER.size <= length <= FRAME_MAX:
                raise BadInputError(f"{length} bytes are no frame")
            end = _LENGTH.size + length
            if len(self._data) < end:
                return
            raw = bytes(self._data[_LENGTH.size : end])
            del self._data[:end]
            yield _decode(raw)


def _decode(raw: bytes) -> StreamFrame:
    kind, name_size, type_size, sequence, sent_ns = _HEADER.unpack_from(raw)
    names, body = _HEADER.size + name_size, _HEADER.size + name_size + type_size
    try:
        name, ros_type = raw[_HEADER.size : names].decode(), raw[names:body].decode()
    except UnicodeDecodeError as error:
        raise BadInputError(f"a frame's name is no UTF-8: {error}") from error
    if body > len(raw):
        raise BadInputError("a frame ends within its names")
    return StreamFrame(kind, name, ros_type, sequence, sent_ns, raw[body:])


def socket_of(address: str) -> tuple[socket.socket, str | tuple[str, int]]:
    """Return an unbound socket and what to bind or connect it to. `address` is `unix:PATH` or `tcp:PORT`, which is one of this machine
    alone (127.0.0.1). Raises DeviceError."""
    kind, _, rest = address.partition(":")
    if kind == "unix" and rest:
        return socket.socket(socket.AF_UNIX), rest
    if kind == "tcp" and rest.isdecimal() and int(rest) < 65536:
        return socket.socket(socket.AF_INET), ("127.0.0.1", int(rest))
    raise DeviceError(f"{address!r} is neither unix:PATH nor tcp:PORT")
