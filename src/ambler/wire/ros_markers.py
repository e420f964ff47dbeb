"""Frontiers as visualization_msgs/MarkerArray: cells as points, the goal as an arrow, the reason as text, coloured by state."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.wire.ros_geometry import header_to_ros, pose_to_ros
from ambler.wire.ros_types import record_class

_Marker = record_class("visualization_msgs/msg/Marker")
_MarkerArray = record_class("visualization_msgs/msg/MarkerArray")
_MeshFile = record_class("visualization_msgs/msg/MeshFile")
_Color = record_class("std_msgs/msg/ColorRGBA")
_Duration = record_class("builtin_interfaces/msg/Duration")
_CompressedImage = record_class("sensor_msgs/msg/CompressedImage")
_Point = record_class("geometry_msgs/msg/Point")
_Vector3 = record_class("geometry_msgs/msg/Vector3")

_ARROW, _POINTS, _TEXT = 0, 8, 9
_ADD, _DELETE_ALL = 0, 3
_CELL_SIZE = 0.05
_TEXT_HEIGHT = 0.25
_COLORS = {
    m.FrontierState.OPEN: (0.1, 0.6, 1.0),
    m.FrontierState.TARGET: (0.1, 0.9, 0.2),
    m.FrontierState.UNREACHABLE: (0.9, 0.2, 0.1),
    m.FrontierState.TOO_SMALL: (0.6, 0.6, 0.6),
    m.FrontierState.OUTSIDE_BOUNDARY: (0.7, 0.3, 0.8),
}
_IDENTITY = SE3()
_NO_LIFETIME = _Duration(0, 0)
_NO_TEXTURE = _CompressedImage(header_to_ros(0, ""), "", np.empty(0, np.uint8))
_NO_MESH = _MeshFile("", np.empty(0, np.uint8))


def frontiers_to_ros(message: m.Frontiers) -> Any:
    """Build the markers; the first one deletes those of the map before."""
    header = header_to_ros(message.stamp_ns, message.frame)
    markers = [_marker(header, "", 0, _POINTS, m.FrontierState.OPEN, action=_DELETE_ALL)]
    for index, frontier in enumerate(message.frontiers):
        cells = [_Point(x, y, 0.0) for x, y in frontier.cells.tolist()]
        size = (_CELL_SIZE, _CELL_SIZE, 0.0)
        markers.append(_marker(header, "cells", index, _POINTS, frontier.state, scale=size, points=cells))
        if frontier.goal is not None:
            pose = SE3.from_se2(SE2(*frontier.goal))
            markers.append(_marker(header, "goal", index, _ARROW, frontier.state, pose=pose, scale=(0.4, 0.08, 0.08)))
        pose = SE3((*frontier.centroid, 0.5))
        size = (0.0, 0.0, _TEXT_HEIGHT)
        markers.append(
            _marker(header, "reason", index, _TEXT, frontier.state, pose=pose, scale=size, text=_label(frontier))
        )
    return _MarkerArray(markers)


def _label(frontier: m.Frontier) -> str:
    words = [frontier.state.name.lower().replace("_", " ")]
    if math.isfinite(frontier.path_distance):
        words.append(f"{frontier.path_distance:.1f} m")
    if frontier.reason:
        words.append(frontier.reason)
    return ", ".join(words)


def _marker(
    header: Any,
    namespace: str,
    index: int,
    kind: int,
    state: m.FrontierState,
    *,
    action: int = _ADD,
    pose: SE3 = _IDENTITY,
    scale: tuple[float, float, float] = (0.0, 0.0, 0.0),
    points: list[Any] | None = None,
    text: str = "",
) -> Any:
    return _Marker(
        header,
        namespace,
        index,
        kind,
        action,
        pose_to_ros(pose),
        _Vector3(*scale),
        _Color(*_COLORS[state], 1.0),
        _NO_LIFETIME,
        False,
        points or [],
        [],
        "",
        _NO_TEXTURE,
        [],
        text,
        "",
        _NO_MESH,
        False,
    )
