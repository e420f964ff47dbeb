"""Frontiers and visibility graphs as visualization_msgs/MarkerArray: cells as points, goals as arrows, reasons as text, edges as lines,
coloured by state or kind.

Thousands of cells are written as arrays; `frontiers_to_ros` is the slow twin that the tests compare with, byte by byte.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core import messages as m
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.wire.ros_geometry import NANOSECONDS, header_to_ros, pose_to_ros
from ambler.wire.ros_types import record_class

_Marker = record_class("visualization_msgs/msg/Marker")
_MarkerArray = record_class("visualization_msgs/msg/MarkerArray")
_MeshFile = record_class("visualization_msgs/msg/MeshFile")
_Color = record_class("std_msgs/msg/ColorRGBA")
_Duration = record_class("builtin_interfaces/msg/Duration")
_CompressedImage = record_class("sensor_msgs/msg/CompressedImage")
_Point = record_class("geometry_msgs/msg/Point")
_Vector3 = record_class("geometry_msgs/msg/Vector3")

_ARROW, _LINES, _POINTS, _TEXT = 0, 5, 8, 9
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
Color = tuple[float, float, float]
_WHITE = (1.0, 1.0, 1.0)
_NODE_COLORS = (("corners", (0.9, 0.3, 0.1)), ("gaps", (0.7, 0.3, 0.8)), ("driven", (0.1, 0.9, 0.2)))
_EDGE_COLORS = (("sight", (0.2, 0.7, 0.9)), ("along_contours", (1.0, 0.7, 0.1)), ("trajectory", (0.1, 0.9, 0.2)))
_IDENTITY = SE3()

_NO_LIFETIME = _Duration(0, 0)
_NO_TEXTURE = _CompressedImage(header_to_ros(0, ""), "", np.empty(0, np.uint8))
_NO_MESH = _MeshFile("", np.empty(0, np.uint8))


# Between the points and the text of a marker lie: how many colours of points; texture: resource (an empty text is one byte, and three to the next
# number), stamp, frame, format, how many bytes; how many texture coordinates.
_BETWEEN_LAYOUT = "II4xiII4xI4xII"
_BETWEEN = (0, 1, 0, 0, 1, 1, 0, 0)


def _no_points() -> NDArray[np.float64]:
    return np.zeros((0, 3))


@dataclass(frozen=True, slots=True)
class _Shape:
    """What the two encoders need of one marker; points float64 (N, 3) or none."""

    namespace: str
    index: int
    kind: int
    color: Color
    action: int = _ADD
    pose: SE3 = _IDENTITY
    scale: tuple[float, float, float] = (0.0, 0.0, 0.0)
    points: NDArray[np.float64] = field(default_factory=_no_points)
    text: str = ""


def _shapes(message: m.Frontiers) -> Iterator[_Shape]:
    """Yield the markers: the first deletes those of the map before; then all cells of one state in one marker; then the goal and
    the reason of each frontier that is more than dust, that of the target in a namespace of its own: a hundred reasons at once cover
    the rooms, so the layout shows the target's alone."""
    yield _Shape("", 0, _POINTS, _COLORS[m.FrontierState.OPEN], action=_DELETE_ALL)
    for state in m.FrontierState:
        cells = [f.cells for f in message.frontiers if f.state == state]
        if cells:
            flat = np.concatenate(cells)
            points = np.zeros((len(flat), 3))
            points[:, :2] = flat
            yield _Shape(
                "cells", int(state), _POINTS, _COLORS[state], scale=(_CELL_SIZE, _CELL_SIZE, 0.0), points=points
            )
    for index, frontier in enumerate(message.frontiers):
        if frontier.state == m.FrontierState.TOO_SMALL:
            continue
        if frontier.goal is not None:
            pose = SE3.from_se2(SE2(*frontier.goal))
            yield _Shape("goal", index, _ARROW, _COLORS[frontier.state], pose=pose, scale=(0.4, 0.08, 0.08))
        pose = SE3((*frontier.centroid, 0.5))
        size = (0.0, 0.0, _TEXT_HEIGHT)
        namespace = "target" if frontier.state == m.FrontierState.TARGET else "reason"
        yield _Shape(namespace, index, _TEXT, _COLORS[frontier.state], pose=pose, scale=size, text=_label(frontier))


def _label(frontier: m.Frontier) -> str:
    words = [frontier.state.name.lower().replace("_", " ")]
    if math.isfinite(frontier.path_distance):
        words.append(f"{frontier.path_distance:.1f} m")
    if frontier.reason:
        words.append(frontier.reason)
    return ", ".join(words)


class _CdrWriter:
    """Appends CDR; offsets count from behind the four header bytes."""

    def __init__(self) -> None:
        self.out = bytearray()

    def put(self, alignment: int, layout: str, *values: float) -> None:
        """Append numbers whose first one has to lie at a multiple of `alignment`."""
        self.out += bytes(-len(self.out) % alignment) + struct.pack("<" + layout, *values)

    def put_text(self, *texts: str) -> None:
        for text in texts:
            raw = text.encode() + b"\x00"
            self.put(4, "I", len(raw))
            self.out += raw


def _graph_shapes(message: m.VisibilityGraphView) -> Iterator[_Shape]:
    """Yield the markers of a graph: the first deletes those of the graph before; then contours, edges and nodes, one marker for each kind."""
    yield _Shape("", 0, _POINTS, _WHITE, action=_DELETE_ALL)
    lines = [np.repeat(line, 2, axis=0)[1:-1] for line in message.contours if len(line) > 1]
    if lines:
        yield _Shape(
            "contours", 0, _LINES, _WHITE, scale=(0.03, 0.0, 0.0), points=np.concatenate(lines).astype(np.float64)
        )
    for kind, (name, color) in enumerate(_EDGE_COLORS):
        ends = message.edges[message.edge_kinds == kind].reshape(-1, 3)
        if len(ends):
            yield _Shape(name, 0, _LINES, color, scale=(0.01, 0.0, 0.0), points=ends.astype(np.float64))
    for kind, (name, color) in enumerate(_NODE_COLORS):
        nodes = message.nodes[message.node_kinds == kind]
        if len(nodes):
            yield _Shape(name, 0, _POINTS, color, scale=(0.08, 0.08, 0.0), points=nodes.astype(np.float64))


def encode_frontiers(message: m.Frontiers) -> bytes:
    """Return the marker array as CDR."""
    return _encode(message, list(_shapes(message)))


def encode_visibility_graph(message: m.VisibilityGraphView) -> bytes:
    """Return the marker array as CDR."""
    return _encode(message, list(_graph_shapes(message)))


def _encode(message: m.Frontiers | m.VisibilityGraphView, shapes: list[_Shape]) -> bytes:
    writer = _CdrWriter()
    writer.put(4, "I", len(shapes))
    for shape in shapes:
        _put_marker(writer, message, shape)
    return b"\x00\x01\x00\x00" + bytes(writer.out)


def _put_marker(writer: _CdrWriter, message: m.Frontiers | m.VisibilityGraphView, shape: _Shape) -> None:
    w, x, y, z = shape.pose.rotation
    writer.put(4, "iI", *divmod(message.stamp_ns, NANOSECONDS))
    writer.put_text(message.frame, shape.namespace)
    writer.put(4, "3i", shape.index, shape.kind, shape.action)
    writer.put(8, "10d", *shape.pose.translation, x, y, z, w, *shape.scale)
    writer.put(4, "4f2iB", *shape.color, 1.0, 0, 0, 0)  # colour, lifetime, not frame-locked
    writer.put(4, "I", len(shape.points))
    if len(shape.points):
        writer.put(8, "")
        writer.out += shape.points.tobytes()
    writer.put(4, _BETWEEN_LAYOUT, *_BETWEEN)
    writer.put_text(shape.text, "", "")  # text, mesh resource, mesh file
    writer.put(4, "IB", 0, 0)  # mesh data, no embedded materials


def frontiers_to_ros(message: m.Frontiers) -> Any:
    """Build the marker array as records of the type store."""
    header = header_to_ros(message.stamp_ns, message.frame)
    return _MarkerArray([_marker_to_ros(header, shape) for shape in _shapes(message)])


def visibility_graph_to_ros(message: m.VisibilityGraphView) -> Any:
    """Build the marker array of a graph as records of the type store."""
    header = header_to_ros(message.stamp_ns, message.frame)
    return _MarkerArray([_marker_to_ros(header, shape) for shape in _graph_shapes(message)])


def _marker_to_ros(header: Any, shape: _Shape) -> Any:
    return _Marker(
        header,
        shape.namespace,
        shape.index,
        shape.kind,
        shape.action,
        pose_to_ros(shape.pose),
        _Vector3(*shape.scale),
        _Color(*shape.color, 1.0),
        _NO_LIFETIME,
        False,
        [_Point(*point) for point in shape.points.tolist()],
        [],
        "",
        _NO_TEXTURE,
        [],
        shape.text,
        "",
        _NO_MESH,
        False,
    )
