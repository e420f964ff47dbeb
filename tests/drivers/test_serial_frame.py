"""The frame: what is encoded comes back, what is damaged does not, and damage ends at the next zero."""

import random
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ambler.drivers.serial_frame import (
    BATTERY,
    FRAME_MAX,
    ODOMETRY,
    VELOCITY,
    Frame,
    FrameKind,
    FrameReader,
    FrameWriter,
    cobs_decode,
    cobs_encode,
    decode_frame,
    encode_frame,
)

FRAMES = st.builds(
    Frame,
    st.sampled_from(FrameKind),
    st.integers(0, 0xFFFF),
    st.integers(0, 2**32 - 1),
    st.binary(max_size=FRAME_MAX - 12),
)


@settings(derandomize=True)
@given(st.binary(max_size=FRAME_MAX))
def test_cobs_has_no_zeros_and_comes_back(data: bytes) -> None:
    encoded = cobs_encode(data)
    assert 0 not in encoded
    assert len(encoded) == len(data) + 1
    assert cobs_decode(encoded) == data


@settings(derandomize=True)
@given(FRAMES)
def test_frames_come_back(frame: Frame) -> None:
    data = encode_frame(frame)
    assert data[0] == data[-1] == 0
    assert decode_frame(data[1:-1]) == frame


def test_bytes_of_a_velocity() -> None:
    """The example of docs/drivers.md, byte for byte."""
    data = FrameWriter().encode(FrameKind.VELOCITY, 1_000_000, VELOCITY.pack(0.5, 0.0, -0.25))
    body = bytes.fromhex("01 01 0000 40420f00 000000000000e03f 0000000000000000 000000000000d0bf")
    assert cobs_decode(data[1:-1]) == body + zlib.crc32(body).to_bytes(4, "little")
    assert zlib.crc32(b"123456789") == 0xCBF43926


def test_sizes_of_the_tables() -> None:
    assert (VELOCITY.size, ODOMETRY.size, BATTERY.size) == (24, 108, 17)


def test_a_frame_that_is_too_long_is_refused() -> None:
    with pytest.raises(ValueError, match="253"):
        encode_frame(Frame(1, 0, 0, bytes(FRAME_MAX - 11)))


@settings(derandomize=True, max_examples=200)
@given(st.binary(max_size=400), st.integers(1, 7))
def test_after_any_garbage_the_next_frame_is_read(garbage: bytes, size: int) -> None:
    reader, data = FrameReader(), garbage + encode_frame(Frame(2, 7, 1, b"\x00\x01"))
    frames = [f for i in range(0, len(data), size) for f in reader.feed(data[i : i + size])]
    assert frames[-1] == Frame(2, 7, 1, b"\x00\x01")


def test_damage_costs_the_frame_it_hit_and_nothing_else() -> None:
    rng, writer, reader = random.Random(4), FrameWriter(), FrameReader()
    hit = 0
    received = reader.feed(b"\x00")
    for i in range(2000):
        data = bytearray(writer.encode(FrameKind.ODOMETRY, i, ODOMETRY.pack(i, *[float(i)] * 13)))
        if rng.random() < 0.1 and i not in (0, 1999):
            hit += 1
            data[rng.randrange(1, len(data) - 1)] ^= 1 << rng.randrange(8)
        received += reader.feed(bytes(data))
    assert len(received) == 2000 - hit
    assert all(ODOMETRY.unpack(f.payload) == (f.sequence, *[float(f.sequence)] * 13) for f in received)
    assert reader.lost == hit
    assert reader.damaged >= hit


def test_gaps_wrap_and_a_new_beginning_is_none() -> None:
    reader = FrameReader()
    for sequence in (0xFFFE, 1, 2, 0):
        reader.feed(encode_frame(Frame(2, sequence, 0, b"")))
    assert reader.lost == 2
