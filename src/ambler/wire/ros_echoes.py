"""Judged echoes as records of the own package `ambler_msgs`; bit-exact both ways."""

from __future__ import annotations

from typing import Any

from ambler.core import messages as m
from ambler.wire.ros_geometry import header_to_ros, pose_from_ros, pose_to_ros, stamp_from_ros
from ambler.wire.ros_types import record_class

_JudgedEcho = record_class("ambler_msgs/msg/JudgedEcho")


def echo_to_ros(message: m.JudgedEcho) -> Any:
    return _JudgedEcho(
        header_to_ros(message.stamp_ns, message.frame),
        message.sensor,
        pose_to_ros(message.pose),
        message.half_angle,
        message.distance,
        message.free,
        message.is_unexplained,
    )


def echo_from_ros(record: Any) -> m.JudgedEcho:
    return m.JudgedEcho(
        stamp_from_ros(record.header),
        record.header.frame_id,
        record.sensor,
        pose_from_ros(record.pose),
        record.half_angle,
        record.distance,
        record.free,
        record.is_unexplained,
    )
