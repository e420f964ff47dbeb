"""Glass as one visualization_msgs/Marker: a list of lines, whose colour's opacity is the confidence of each."""

from __future__ import annotations

from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.core.se3 import SE3
from ambler.wire.ros_geometry import header_to_ros, pose_to_ros, stamp_from_ros
from ambler.wire.ros_types import record_class

_Marker = record_class("visualization_msgs/msg/Marker")
_MeshFile = record_class("visualization_msgs/msg/MeshFile")
_Color = record_class("std_msgs/msg/ColorRGBA")
_Duration = record_class("builtin_interfaces/msg/Duration")
_CompressedImage = record_class("sensor_msgs/msg/CompressedImage")
_Point = record_class("geometry_msgs/msg/Point")
_Vector3 = record_class("geometry_msgs/msg/Vector3")

_LINE_LIST = 5
_WIDTH = 0.06
_CYAN = (0.0, 0.9, 0.9)


def glass_to_ros(message: m.GlassWalls) -> Any:
    """Every segment is a pair of points; both have the colour of its confidence."""
    ends = message.segments.reshape(-1, 2).tolist()
    colors = [_Color(*_CYAN, float(c)) for c in np.repeat(message.confidence, 2)]
    header = header_to_ros(message.stamp_ns, message.frame)
    return _Marker(
        header,
        "glass",
        0,
        _LINE_LIST,
        0,
        pose_to_ros(SE3()),
        _Vector3(_WIDTH, 0.0, 0.0),
        _Color(*_CYAN, 1.0),
        _Duration(0, 0),
        False,
        [_Point(x, y, 0.0) for x, y in ends],
        colors,
        "",
        _CompressedImage(header_to_ros(0, ""), "", np.empty(0, np.uint8)),
        [],
        "",
        "",
        _MeshFile("", np.empty(0, np.uint8)),
        False,
    )


def glass_from_ros(record: Any) -> m.GlassWalls:
    if record.type != _LINE_LIST or len(record.points) % 2 or len(record.colors) != len(record.points):
        raise ValueError("the marker is no list of lines with a colour at every end")
    ends = np.array([(p.x, p.y) for p in record.points], np.float32).reshape(-1, 4)
    confidence = np.array([c.a for c in record.colors[::2]], np.float32)
    return m.GlassWalls(stamp_from_ros(record.header), record.header.frame_id, ends, confidence)
