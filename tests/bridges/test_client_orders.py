"""Orders of viewers: what they mean as CDR and JSON, and what is refused."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from ambler.bridges.client_orders import order_from_client
from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.runtime import topics
from ambler.runtime.names import PROFILES, named
from ambler.wire.ros_messages import encode, ros_type_of

SQUARE = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]], np.float32)
POINT, NUMBER, CODE = "geometry_msgs/PointStamped", "std_msgs/Float32", "std_msgs/msg/Int8"
HEADER = {"frame_id": "map", "stamp": {"sec": 0, "nsec": 0}}


def cloud(points: Any, frame: str = "map") -> m.PointCloud:
    n = len(points)
    zeros = np.zeros(n, np.float32)
    return m.PointCloud(1, frame, np.array(points, np.float32), zeros, zeros, np.zeros(n, np.uint16))


@pytest.mark.parametrize(
    "message",
    [
        m.PointStamped(1, "map", (1.5, -2.0, 0.0)),
        m.Polygon(1, "/map", SQUARE),
        m.Polygon(1, "", SQUARE[:0]),
        cloud([[1.0, 2.0, 0.3]]),
        m.Number(1, 0.25),
        m.Code(1, 2),
    ],
    ids=lambda message: type(message).__name__,
)
def test_cdr_is_read_and_stamped_anew(message: Any) -> None:

    read: Any = order_from_client(type(message), "cdr", ros_type_of(type(message)), encode(message), 77)
    assert read.stamp_ns == 77
    assert getattr(read, "frame", "map") == "map"
    for name in ("value", "point"):
        assert getattr(read, name, None) == getattr(message, name, None)
    np.testing.assert_array_equal(getattr(read, "points", 0), getattr(message, "points", 0))


def read_json(kind: type[m.Message], schema: str, fields: Any) -> Any:
    return order_from_client(kind, "json", schema, json.dumps(fields).encode(), 5)


def test_json_is_read() -> None:
    assert read_json(m.PointStamped, POINT, {"header": HEADER, "point": {"x": 1, "y": 2, "z": 3}}).point == (1, 2, 3)
    corners = [{"x": float(x), "y": float(y)} for x, y, _ in SQUARE.tolist()]
    fields = {"header": HEADER, "polygon": {"points": corners}}
    np.testing.assert_array_equal(read_json(m.Polygon, "geometry_msgs/PolygonStamped", fields).points, SQUARE)
    assert read_json(m.Number, NUMBER, {"data": 0.5}).value == 0.5
    assert read_json(m.Code, CODE, {"data": 1}).value == 1


@pytest.mark.parametrize(
    ("kind", "schema", "fields", "why"),
    [
        (m.Number, NUMBER, {"data": float("nan")}, "no speed"),
        (m.Number, NUMBER, {"data": -1.0}, "no speed"),
        (m.Number, CODE, {"data": 1.0}, "must be"),
        (m.Number, NUMBER, {}, "no JSON"),
        (m.Code, CODE, {"data": 3}, "0, 1 or 2"),
        (m.PointStamped, POINT, {"header": {"frame_id": "odom"}, "point": {"x": 1, "y": 2}}, "frame map"),
        (m.PointStamped, POINT, {"header": HEADER, "point": {"x": float("inf"), "y": 2}}, "finite"),
        (m.PointStamped, POINT, {"header": HEADER, "point": {"x": 1, "y": -1.1e5}}, "100 km"),
        (m.Polygon, "geometry_msgs/PolygonStamped", {"header": HEADER, "polygon": {"points": [{"x": 1, "y": 2}]}}, "corners"),
        (m.PointCloud, "sensor_msgs/PointCloud2", {"header": HEADER}, "must not be encoded"),
    ],
)  # fmt: skip
def test_nonsense_is_refused_with_a_reason(kind: type[m.Message], schema: str, fields: Any, why: str) -> None:
    with pytest.raises(BadInputError, match=why):
        read_json(kind, schema, fields)


def test_damaged_bytes_are_refused() -> None:
    with pytest.raises(BadInputError):
        order_from_client(m.Polygon, "cdr", "geometry_msgs/PolygonStamped", b"\x00\x01\x00\x00abc", 0)


def test_the_profile_of_the_original_renames_outputs_and_keeps_every_name_apart() -> None:
    shown = [named(topic, "original") for topic in topics.all_topics() if not topic.is_bulk]
    names = [topic.ros_name for topic in shown]
    assert len(set(names)) == len(names)
    assert named(topics.ODOMETRY, "original").ros_name == "/state_estimation"
    assert named(topics.IMU.of("rear"), "original").ros_name == "/imu/data/rear"
    assert named(topics.ODOMETRY, "own") == topics.ODOMETRY
    for name in PROFILES["original"]:
        assert topics.topic_named(name).ros_name != PROFILES["original"][name]
    wanted = "/way_point /goal_point /goal_pose /navigation_boundary /added_obstacles /map_clearing /cloud_clearing /speed /stop"
    assert set(wanted.split()) <= {topic.ros_name for topic in topics.order_topics()}
