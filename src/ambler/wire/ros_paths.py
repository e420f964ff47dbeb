"""Paths as nav_msgs/Path. A path of some hundred poses is written as one array, because all poses after the first have
the same length and alignment; `path_to_ros` is the slow twin that the tests compare it with, byte by byte.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core import messages as m
from ambler.core.se2 import wrap_angle
from ambler.wire.ros_geometry import NANOSECONDS, header_to_ros, stamp_from_ros
from ambler.wire.ros_types import record_class

_Point = record_class("geometry_msgs/msg/Point")
_Quaternion = record_class("geometry_msgs/msg/Quaternion")
_Pose = record_class("geometry_msgs/msg/Pose")
_PoseStamped = record_class("geometry_msgs/msg/PoseStamped")
_Path = record_class("nav_msgs/msg/Path")

_CDR_HEADER = b"\x00\x01\x00\x00"
_POSE_BYTES = 56


def encode_path(message: m.Path) -> bytes:
    """Return nav_msgs/Path as CDR. Offsets count from behind the four header bytes; doubles lie at multiples of 8."""
    frame = message.frame.encode() + b"\x00"
    header = struct.pack("<iII", *divmod(message.stamp_ns, NANOSECONDS), len(frame)) + frame
    count = len(message.poses)
    start = header + bytes(-len(header) % 4) + struct.pack("<I", count)
    if count == 0:
        return _CDR_HEADER + start
    first = header + bytes(-(len(start) + len(header)) % 8)
    later = header + bytes(-len(header) % 8)
    rows = np.empty((count, len(later) + _POSE_BYTES), np.uint8)
    rows[:, : len(later)] = np.frombuffer(later, np.uint8)
    rows[:, len(later) :] = _pose_doubles(message.poses).view(np.uint8)
    return b"".join((_CDR_HEADER, start, first, rows.data.cast("B")[len(later) :]))


def _pose_doubles(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return float64 (N, 7): x y z and the quaternion x y z w of poses (x, y, yaw)."""
    out = np.zeros((len(poses), 7))
    out[:, :2] = poses[:, :2]
    halves = poses[:, 2] / 2
    out[:, 5] = [math.sin(half) for half in halves.tolist()]
    out[:, 6] = [math.cos(half) for half in halves.tolist()]
    return out


def path_to_ros(message: m.Path) -> Any:
    header = header_to_ros(message.stamp_ns, message.frame)
    poses = []
    for x, y, yaw in message.poses.tolist():
        turn = _Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        poses.append(_PoseStamped(header, _Pose(_Point(x, y, 0.0), turn)))
    return _Path(header, poses)


def path_from_ros(record: Any) -> m.Path:
    """Read a path; yaw comes back in [-pi, pi), equal to the original up to rounding."""
    poses = np.empty((len(record.poses), 3))
    for row, stamped in zip(poses, record.poses, strict=True):
        q = stamped.pose.orientation
        yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
        row[:] = stamped.pose.position.x, stamped.pose.position.y, wrap_angle(yaw)
    return m.Path(stamp_from_ros(record.header), record.header.frame_id, poses)
