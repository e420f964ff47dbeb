"""The frame between a host and a base on a serial line, and what its messages hold (docs/drivers.md has the tables).

A frame is a header, a payload and a CRC-32, made free of zeros by COBS (Cheshire and Baker, 1999) and put between zeros: whatever
is lost or garbled, the next zero is the end of a frame, so damage never reaches beyond the frame it hit. CRC-32 (that of zlib, in
the hardware of most controllers) because a velocity must not be read out of noise: CRC-16 lets one garbled frame of 65536 pass.
"""

from __future__ import annotations

import enum
import struct
import zlib
from dataclasses import dataclass

VERSION = 1
FRAME_MAX = 253
"""Bytes of a frame before COBS; up to here COBS needs no group codes and costs exactly one byte."""

_HEADER = struct.Struct("<BBHI")
_CRC = struct.Struct("<I")
_STAMP_BITS = 32
STAMP_MASK = (1 << _STAMP_BITS) - 1


class FrameKind(enum.IntEnum):
    """What a frame says; below 0x80 from the host to the base."""

    VELOCITY = 0x01
    STOP = 0x02
    REQUEST_INFO = 0x03
    STOP_CHARGING = 0x04
    ODOMETRY = 0x81
    BATTERY = 0x82
    INFO = 0x83
    FAULT = 0x84


VELOCITY = struct.Struct("<3d")
"""vx, vy (m/s), wz (rad/s) in the base frame."""
ODOMETRY = struct.Struct("<I13d")
"""Stamp (µs), x y z (m), qw qx qy qz of `odom_from_base`; vx vy vz (m/s), wx wy wz (rad/s) in the base frame."""
BATTERY = struct.Struct("<I3fB")
"""Stamp (µs), volts, amperes (positive while charging), share 0..1, supply as in `PowerSupply`."""
INFO = struct.Struct("<H24s24s")
"""Watchdog (ms), name and firmware in UTF-8, filled with zeros."""
FAULT = struct.Struct("<H")
"""Code; a sentence in UTF-8 follows."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One valid frame: `sent_us` is when it left, of the sender's own clock, which wraps every 71.6 minutes."""

    kind: int
    sequence: int
    sent_us: int
    payload: bytes
    version: int = VERSION


def cobs_encode(data: bytes) -> bytes:
    """Return at most FRAME_MAX bytes without zeros, one byte longer."""
    if len(data) > FRAME_MAX:
        raise ValueError(f"a frame holds {FRAME_MAX} bytes, not {len(data)}")
    return b"".join(bytes((len(part) + 1,)) + part for part in data.split(b"\x00"))


def cobs_decode(data: bytes) -> bytes | None:
    """Return what was encoded, None when these bytes cannot have come from `cobs_encode`."""
    parts, i = [], 0
    while i < len(data):
        end = i + data[i]
        if data[i] == 0 or data[i] == 0xFF or end > len(data):
            return None
        parts.append(data[i + 1 : end])
        i = end
    return b"\x00".join(parts)


def encode_frame(frame: Frame) -> bytes:
    """Return the frame as it travels, between zeros."""
    body = _HEADER.pack(frame.version, frame.kind, frame.sequence, frame.sent_us) + frame.payload
    return b"\x00" + cobs_encode(body + _CRC.pack(zlib.crc32(body))) + b"\x00"


def decode_frame(data: bytes) -> Frame | None:
    """Return the frame between two zeros, None when it is damaged."""
    raw = cobs_decode(data)
    if raw is None or len(raw) < _HEADER.size + _CRC.size:
        return None
    body = raw[: -_CRC.size]
    if _CRC.unpack(raw[-_CRC.size :])[0] != zlib.crc32(body):
        return None
    version, kind, sequence, sent_us = _HEADER.unpack_from(body)
    return Frame(kind, sequence, sent_us, body[_HEADER.size :], version)


class FrameReader:
    """Cuts a stream of bytes into frames. `damaged` counts pieces that were none, `lost` the frames that are missing between the
    sequence numbers of valid ones. What comes before the first zero began before we listened and is not counted."""

    def __init__(self) -> None:
        self.damaged = 0
        self.lost = 0
        self._rest = b""
        self._is_aligned = False
        self._sequence: int | None = None

    def feed(self, data: bytes) -> list[Frame]:
        """Take the next bytes; returns the frames that they completed, oldest first."""
        if not self._is_aligned:
            _, zero, data = data.partition(b"\x00")
            if not zero:
                return []
            self._is_aligned = True
        *pieces, self._rest = (self._rest + data).split(b"\x00")
        if len(self._rest) > FRAME_MAX + 1:
            self._rest = self._rest[-FRAME_MAX - 2 :]
        frames = []
        for piece in filter(None, pieces):
            frame = decode_frame(piece)
            if frame is None:
                self.damaged += 1
                continue
            self._count_gap(frame.sequence)
            frames.append(frame)
        return frames

    def _count_gap(self, sequence: int) -> None:
        """A step back is a sender that began anew, not a loss of half the numbers."""
        if self._sequence is not None:
            gap = (sequence - self._sequence - 1) & 0xFFFF
            self.lost += gap if gap < 0x8000 else 0
        self._sequence = sequence


class FrameWriter:
    """Numbers the frames of one direction."""

    def __init__(self) -> None:
        self._sequence = 0

    def encode(self, kind: FrameKind, sent_us: int, payload: bytes = b"") -> bytes:
        """Return the next frame as it travels."""
        frame = Frame(kind, self._sequence, sent_us & STAMP_MASK, payload)
        self._sequence = (self._sequence + 1) & 0xFFFF
        return encode_frame(frame)
