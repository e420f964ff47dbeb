"""Clouds as Livox' own drivers send them (`CustomMsg`): points with nanoseconds after the stamp, their list the last part of the message.

A scan has tens of thousands of points, and a record of each takes twenty times as long as all else in reading them: the list is taken from the bytes at once.
In ROS 1 nothing lies between two parts. CDR aligns every number to its own size, counted from behind the four header bytes, so one byte lies between two
points and none need follow the last. `tests/wire` compares every value with what rosbags reads.
"""

from __future__ import annotations

import struct
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import TypesysError
from rosbags.typesys.store import Typestore

from ambler.core import messages as m
from ambler.wire.ros_geometry import NANOSECONDS, stamp_from_ros

_Order = Literal["<", ">"]
# MD5 sums of the drivers' definition with the header of ROS 1, as `rosmsg md5` tells it, and with that of ROS 2, which is not numbered.
_LAYOUTS = ("e4d6829bdfe657cb6c21a746c86b21a6", "ebbaadd204c0cb2615c99716902f2738")
_POINT = np.dtype(
    [("offset_time", "u4"), ("xyz", "f4", (3,)), ("reflectivity", "u1"), ("tag", "u1"), ("line", "u1")]
)  # packed, 19 bytes
_BEFORE_COUNT = 16  # bytes: time base, number of points, number of the LiDAR, reserved
_CDR_ORDERS: dict[bytes, _Order] = {b"\x00\x00": ">", b"\x00\x01": "<"}
_CDR_STEP = 20
_CDR_PADDING = 3  # bytes that may follow the last part


def has_drivers_layout(store: Typestore, ros_type: str, *, is_cdr: bool) -> bool:
    """Say whether a bag defines a type as the drivers do, so that its bytes can be read without records. One that defines none, as those of ROS 2 Humble and before, means the drivers'."""
    try:
        return store.generate_msgdef(ros_type)[1] == _LAYOUTS[is_cdr]
    except TypesysError:
        return True


def livox_from_ros1(data: bytes) -> m.PointCloud:
    """Read a message of ROS 1. Raises ValueError or struct.error for bytes that are none."""
    sec, nanosec, length = struct.unpack_from("<iII", data, 4)
    end = 16 + length
    points = _points(data, end, "<", _POINT.itemsize, padding=0)
    return _cloud(sec * NANOSECONDS + nanosec, str(data[16:end], "utf-8"), points)


def livox_from_cdr(data: bytes) -> m.PointCloud:
    """Read a message of ROS 2, of either order of bytes. Raises ValueError or struct.error for bytes that are none."""
    order = _CDR_ORDERS.get(bytes(data[:2]))
    if order is None:
        raise ValueError("the first bytes are no header of CDR")
    sec, nanosec, length = struct.unpack_from(order + "iII", data, 4)
    end = 16 + length
    if length == 0 or data[end - 1 : end] != b"\x00":
        raise ValueError("the name of the frame has no end")
    aligned = end + (4 - end) % 8
    points = _points(data, aligned, order, _CDR_STEP, padding=_CDR_PADDING)
    return _cloud(sec * NANOSECONDS + nanosec, str(data[16 : end - 1], "utf-8"), points)


def livox_from_ros(record: Any) -> m.PointCloud:
    """Read a record, of any layout with the drivers' names."""
    rows = [(p.x, p.y, p.z, p.reflectivity, p.offset_time, p.line) for p in record.points]
    table = np.array(rows, np.float64).reshape(-1, 6)
    return m.PointCloud(
        stamp_from_ros(record.header),
        record.header.frame_id,
        table[:, :3].astype(np.float32),
        table[:, 3].astype(np.float32),
        (table[:, 4] * 1e-9).astype(np.float32),
        table[:, 5].astype(np.uint16),
    )


def _points(data: bytes, begin: int, order: _Order, step: int, *, padding: int) -> NDArray[np.void]:
    """Return a view of the points, one every `step` bytes, of a message whose time base lies at `begin`."""
    (count,) = struct.unpack_from(order + "I", data, begin + _BEFORE_COUNT)
    first = begin + _BEFORE_COUNT + 4
    end = first + max(0, (count - 1) * step + _POINT.itemsize)
    if not end <= len(data) <= end + padding:
        raise ValueError(f"{count} points end at byte {end}")
    return np.ndarray(count, _POINT.newbyteorder(order), data, first, step)


def _cloud(stamp_ns: int, frame: str, points: NDArray[np.void]) -> m.PointCloud:
    return m.PointCloud(
        stamp_ns,
        frame,
        points["xyz"].astype(np.float32),
        points["reflectivity"].astype(np.float32),
        (points["offset_time"] * 1e-9).astype(np.float32),
        points["line"].astype(np.uint16),
    )
