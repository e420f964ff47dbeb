"""The live view from a viewer's side: a real WebSocket client subscribes, publishes a goal, is refused, is slow."""

import json
import queue
import socket
import time

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore
from websockets.exceptions import InvalidHandshake, InvalidStatus
from websockets.sync.client import connect

from ambler.bridges.foxglove import FoxgloveBridge
from ambler.bridges.foxglove_front import FoxgloveFront
from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se3 import SE3
from ambler.runtime import topics
from ambler.runtime.names import named
from ambler.wire.ros_messages import decode, encode, message_definition

from .viewer import TIMEOUT, Viewer

GOAL = m.PoseStamped(99, "map", SE3((1.5, -2.0, 0.0), (0.0, 0.0, 0.0, 1.0)))


@pytest.fixture
def goals():
    return queue.Queue()


@pytest.fixture
def bridge(goals):
    bridge = FoxgloveBridge(port=0, on_client_message=lambda topic, message: goals.put((topic, message)))
    yield bridge
    bridge.close()


def occupancy(stamp_ns=5):
    data = np.arange(-1, 99, dtype=np.int8).reshape(10, 10)
    return m.OccupancyGrid(stamp_ns, "map", GridSpec(0.05, 10, 10, -1.0, 2.0), data)


def edge(child, x, stamp_ns=7):
    return m.TransformStamped(stamp_ns, "odom", child, SE3((x, 0.0, 0.0)))


def test_a_viewer_is_introduced_with_what_the_3d_panel_needs(bridge):
    with Viewer(bridge.port) as viewer:
        viewer.wait_for(lambda: "/map" in viewer.channels)
        assert viewer.info["metadata"]["ROS_DISTRO"] == "humble"  # whose definitions viewers load
        assert {"clientPublish", "time"} <= set(viewer.info["capabilities"])
        assert {"cdr", "json"} <= set(viewer.info["supportedEncodings"])
        assert set(viewer.channels) == {topic.ros_name for topic in topics.all_topics() if not topic.is_bulk}
        tf = viewer.channels["/tf"]
        assert (tf["encoding"], tf["schemaName"], tf["schemaEncoding"]) == ("cdr", "tf2_msgs/msg/TFMessage", "ros2msg")
        assert tf["schema"] == message_definition("tf2_msgs/msg/TFMessage")  # the same in Jazzy


def test_a_browser_gets_maps_compressed_and_scans_as_they_are(bridge):
    spec = GridSpec(0.05, 400, 400, -1.0, 2.0)
    grid = m.OccupancyGrid(5, "map", spec, np.full(spec.shape, -1, np.int8))
    bridge.on_message(topics.MAP, grid, 1_000)
    with Viewer(bridge.port, compression="deflate") as viewer:
        assert "permessage-deflate" in viewer.socket.response.headers["Sec-WebSocket-Extensions"]
        viewer.subscribe("/map")
        assert viewer.next_data("/map") == (1_000, encode(grid))
        viewer.subscribe("/odom")
        assert send_until_received(bridge, viewer, topics.ODOMETRY, odometry(7)) == encode(odometry(7))


def test_a_new_viewer_is_told_the_newest_status_of_every_node(bridge):
    for k, (node, code) in enumerate([("slam", "STARTS"), ("explorer", "SEARCHES"), ("slam", "MAPS")]):
        bridge.on_message(topics.STATUS, m.Status(k, node, code, ""), k, writer=node)
    for _ in range(2):
        with Viewer(bridge.port) as viewer:
            viewer.subscribe("/status")
            told = [decode(m.Status, viewer.next_data("/status")[1]).code for _ in range(2)]
            assert told == ["SEARCHES", "MAPS"]


def test_fixed_transforms_are_said_again_to_viewers_that_stay_subscribed(bridge):
    """A viewer that gets another layout forgets them and does not subscribe again."""
    bridge.on_message(topics.STATIC_TRANSFORMS, m.Transforms(7, (edge("lidar", 1.0),)), 1_000)
    with Viewer(bridge.port) as viewer:
        viewer.subscribe("/tf_static")
        begin = time.monotonic()
        for _ in range(3):
            tree = decode(m.Transforms, viewer.next_data("/tf_static")[1])
            assert [e.child for e in tree.transforms] == ["lidar"]
        assert time.monotonic() - begin < 4.0


def test_viewers_get_ranges_as_they_know_them(bridge):
    """Humble's Range has no variance; the bytes must be those of the definition that was announced."""
    echo = m.Range(5, "sonar", 0.5, 0.02, 4.0, 1.25)
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Viewer(bridge.port) as viewer:
        viewer.subscribe("/ultrasonic")
        data = send_until_received(bridge, viewer, topics.RANGES, echo)
    record = store.deserialize_cdr(data, "sensor_msgs/msg/Range")
    assert (record.header.frame_id, record.range) == ("sonar", 1.25)
    assert len(data) == len(encode(echo)) - 4


def test_latched_topics_come_on_every_subscription_and_others_as_they_happen(bridge):
    bridge.on_message(topics.MAP, occupancy(), 1_000)
    bridge.on_message(topics.STATIC_TRANSFORMS, m.Transforms(7, (edge("a", 1.0),)), 1_000)
    bridge.on_message(topics.STATIC_TRANSFORMS, m.Transforms(7, (edge("b", 2.0),)), 1_000)
    for _ in range(2):
        with Viewer(bridge.port) as viewer:
            viewer.subscribe("/map")
            assert viewer.next_data("/map") == (1_000, encode(occupancy()))
            viewer.subscribe("/tf_static")
            tree = decode(m.Transforms, viewer.next_data("/tf_static")[1])
            assert [e.child for e in tree.transforms] == ["a", "b"]
            assert viewer.times
            viewer.subscribe("/cmd_vel")
            bridge.on_message(topics.STATUS, m.Status(1, "nobody", "WATCHES", "this"), 1_500)
            command = m.VelocityCommand(3, 0.5, 0.0, -0.1)
            received = send_until_received(bridge, viewer, topics.VELOCITY_COMMAND, command)
            assert received == encode(command)
    assert bridge.counts()["/status"].sent == 0


def send_until_received(bridge, viewer, topic, message):
    """Publish again and again, as a robot does, until the subscription has taken effect; return the payload."""
    deadline = time.monotonic() + TIMEOUT
    while time.monotonic() < deadline:
        bridge.on_message(topic, message, 2_000)
        try:
            frame = viewer.receive(timeout=0.05)
        except TimeoutError:
            continue
        if frame is not None and frame[0] == topic.ros_name:
            return frame[2]
    raise AssertionError(f"nothing came on {topic.ros_name}")


@pytest.mark.parametrize("schema", ["geometry_msgs/PoseStamped", "geometry_msgs/msg/PoseStamped"])
def test_a_clicked_goal_reaches_the_robot_as_cdr(bridge, goals, schema):
    bridge.on_message(topics.ODOMETRY, odometry(), 123_000)
    with Viewer(bridge.port) as viewer:
        viewer.publish("/goal_pose", "cdr", schema, encode(GOAL))
        topic, goal = goals.get(timeout=TIMEOUT)
    assert topic is topics.GOAL
    assert (goal.frame, goal.pose) == (GOAL.frame, GOAL.pose)
    assert goal.stamp_ns == 123_000  # the robot's time, not the browser's


def test_a_clicked_goal_reaches_the_robot_as_json(bridge, goals):
    fields = {
        "header": {"stamp": {"sec": 1, "nsec": 2}, "frame_id": "/map"},
        "pose": {"position": {"x": 3, "y": 4.5, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0.6, "w": 0.8}},
    }
    with Viewer(bridge.port) as viewer:
        viewer.publish("/goal_pose", "json", "geometry_msgs/PoseStamped", json.dumps(fields).encode())
        _, goal = goals.get(timeout=TIMEOUT)
    assert (goal.frame, goal.pose) == ("map", SE3((3.0, 4.5, 0.0), (0.8, 0.0, 0.0, 0.6)))


def test_where_the_robot_is_can_be_set_in_both_encodings(bridge, goals):
    """The covariance that a viewer makes up is left out; the pose arrives on the topic of set poses."""
    orientation = {"x": 0, "y": 0, "z": 0.6, "w": 0.8}
    fields = {
        "header": {"stamp": {"sec": 1, "nsec": 2}, "frame_id": "map"},
        "pose": {"pose": {"position": {"x": 3, "y": 4.5, "z": 0}, "orientation": orientation}, "covariance": [0] * 36},
    }
    schema, expected = "geometry_msgs/PoseWithCovarianceStamped", SE3((3.0, 4.5, 0.0), (0.8, 0.0, 0.0, 0.6))
    cdr = encode(m.PoseStamped(5, "map", expected)) + bytes(36 * 8)
    with Viewer(bridge.port) as viewer:
        for encoding, payload in (("json", json.dumps(fields).encode()), ("cdr", cdr)):
            viewer.publish("/initialpose", encoding, schema, payload)
            topic, pose = goals.get(timeout=TIMEOUT)
            assert topic is topics.SET_POSE
            assert (pose.frame, pose.pose) == ("map", expected)
        viewer.publish("/initialpose", "cdr", "geometry_msgs/PoseStamped", encode(GOAL))
        viewer.wait_for(lambda: viewer.warnings)
        assert "PoseWithCovarianceStamped" in viewer.warnings[0]
    assert goals.empty()


NOT_FINITE = m.PoseStamped(1, "map", SE3((float("inf"), 0.0, 0.0)))
NO_DIRECTION = m.PoseStamped(1, "map", SE3((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("encoding", "schema", "payload", "words"),
    [
        ("cdr", "geometry_msgs/PoseStamped", b"\x00\x01\x00\x00abc", "are no geometry_msgs/msg/PoseStamped"),
        ("cdr", "geometry_msgs/PoseStamped", encode(NOT_FINITE), "not finite"),
        ("cdr", "geometry_msgs/PoseStamped", encode(NO_DIRECTION), "no direction"),
        ("cdr", "std_msgs/String", encode(GOAL), "must be geometry_msgs/msg/PoseStamped"),
        ("json", "geometry_msgs/PoseStamped", b'{"pose": 3}', "is no JSON"),
    ],
    ids=["damaged", "not_finite", "no_direction", "wrong_type", "wrong_json"],
)
def test_bad_goals_are_refused_with_a_word_to_the_viewer(bridge, goals, encoding, schema, payload, words):
    with Viewer(bridge.port) as viewer:
        viewer.publish("/goal_pose", encoding, schema, payload)
        viewer.wait_for(lambda: viewer.warnings)
        assert words in viewer.warnings[0]
        viewer.publish("/cmd_vel", "cdr", "geometry_msgs/TwistStamped", encode(m.VelocityCommand(1, 9.0)))
        viewer.publish("/goal_pose", "cdr", "geometry_msgs/PoseStamped", encode(GOAL))
        topic, _ = goals.get(timeout=TIMEOUT)
    assert topic is topics.GOAL  # nothing else got through
    assert goals.empty()


def test_without_the_token_nobody_enters():
    bridge = FoxgloveBridge(port=0, token="secret")
    try:
        for path in ("/", "/?token=wrong", "/?token="):
            with pytest.raises(InvalidStatus, match="401"):
                Viewer(bridge.port, path=path)
        for entry in ({"path": "/?token=secret"}, {"headers": {"Authorization": "Bearer secret"}}):
            with Viewer(bridge.port, **entry) as viewer:
                viewer.wait_for(lambda: bool(viewer.info))
    finally:
        bridge.close()


def test_other_protocols_are_refused(bridge):
    address, old = f"ws://127.0.0.1:{bridge.port}", ["foxglove.websocket.v1"]
    with pytest.raises(InvalidHandshake), connect(address, subprotocols=old):
        pass


def test_a_busy_port_is_one_clear_error_and_a_closed_bridge_frees_it(bridge):
    port = bridge.port
    with pytest.raises(BadInputError, match=rf"cannot listen on 127\.0\.0\.1:{port}: .*--port, or --no-view"):
        FoxgloveBridge(port=port)
    bridge.close()
    bridge.close()
    again = FoxgloveBridge(port=port)
    with Viewer(port) as viewer:
        viewer.wait_for(lambda: bool(viewer.info))
    again.close()


@pytest.mark.parametrize("port", [-1, 65536, 99999])
def test_a_port_that_is_none_is_one_clear_error(port):
    with pytest.raises(BadInputError, match=f"--port {port}: a port is a number from 0"):
        FoxgloveBridge(port=port)


def test_an_address_of_another_machine_is_one_clear_error_that_names_the_way_out():
    with pytest.raises(BadInputError, match=r"cannot listen on 192\.0\.2\.1:0: .*--no-view"):
        FoxgloveBridge(port=0, host="192.0.2.1")


def test_a_fault_while_the_view_starts_reaches_who_makes_it(monkeypatch):
    async def fail(front):
        raise RuntimeError("no such thing")

    monkeypatch.setattr(FoxgloveFront, "start", fail)
    with pytest.raises(RuntimeError, match="no such thing"):
        FoxgloveBridge(port=0)


def odometry(stamp_ns=0):
    zero = (0.0, 0.0, 0.0)
    return m.Odometry(stamp_ns, "odom", "base", SE3(), zero, zero, np.zeros((6, 6)), np.zeros((6, 6)))


def cloud(stamp_ns, count=20_000):
    column = np.zeros(count, np.float32)
    return m.PointCloud(stamp_ns, "lidar", np.zeros((count, 3), np.float32), column, column, np.zeros(count, np.uint16))


def narrow_socket(port):
    """Return a connected socket that takes in little before its reader reads."""
    narrow = socket.socket()
    narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
    narrow.connect(("127.0.0.1", port))
    return narrow


def test_a_slow_viewer_gets_the_newest_frame_and_delays_nobody():
    """50 clouds of 440 KB pass while one viewer does not read: it later finds what was under way, then the last one."""
    bridge = FoxgloveBridge(port=0, rates_hz={"/points": 1e9})
    try:
        with Viewer(bridge.port) as fast, Viewer(bridge.port, sock=narrow_socket(bridge.port)) as slow:
            for viewer in (fast, slow):
                viewer.subscribe("/points")
                send_until_received(bridge, viewer, topics.CLOUD, cloud(0, 1))
            slowest = 0.0
            for k in range(1, 51):
                start = time.monotonic()
                bridge.on_message(topics.CLOUD, cloud(k), k)
                slowest = max(slowest, time.monotonic() - start)
                while fast.next_data("/points")[0] != k:
                    pass
            seen = [slow.next_data("/points")[0]]
            while seen[-1] != 50:
                seen.append(slow.next_data("/points")[0])
        assert slowest < 1.0
        assert seen == sorted(seen)
        assert len(seen) < 12
    finally:
        bridge.close()


def test_a_viewer_that_leaves_in_the_middle_harms_nobody(bridge):
    bridge.on_message(topics.MAP, occupancy(), 1_000)
    for _ in range(3):
        rude = Viewer(bridge.port)
        rude.subscribe("/map")
        rude.socket.socket.close()
    with Viewer(bridge.port) as viewer:
        viewer.subscribe("/map")
        assert viewer.next_data("/map")[0] == 1_000
        viewer.socket.send("this is no JSON")
        viewer.socket.send(b"")
        viewer.subscribe("/gate_status")
        bridge.on_message(topics.GATE_STATUS, m.GateStatus(1, m.GateState.ARMED, "", "x"), 2_000)
        assert viewer.next_data("/gate_status")[0] == 2_000


def test_orders_reach_the_robot_and_nonsense_is_told_to_the_viewer(bridge, goals):
    bridge.on_message(topics.ODOMETRY, odometry(), 123_000)
    corners = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0]], np.float32)
    with Viewer(bridge.port) as viewer:
        viewer.publish("/speed", "json", "std_msgs/Float32", b'{"data": -3}')
        viewer.publish(
            "/navigation_boundary", "cdr", "geometry_msgs/PolygonStamped", encode(m.Polygon(1, "map", corners))
        )
        topic, polygon = goals.get(timeout=TIMEOUT)
        viewer.publish("/stop", "json", "std_msgs/Int8", b'{"data": 2}')
        assert goals.get(timeout=TIMEOUT)[1].value == 2
    assert topic is topics.BOUNDARY
    assert polygon.stamp_ns == 123_000
    np.testing.assert_array_equal(polygon.points, corners)
    assert goals.empty()


def test_a_viewer_of_the_original_deployment_finds_its_names():
    bridge = FoxgloveBridge(port=0, names="original")
    try:
        with Viewer(bridge.port) as viewer:
            viewer.wait_for(lambda: "/state_estimation" in viewer.channels)
            assert "/odom" not in viewer.channels
            assert {"/cmd_vel", "/way_point", "/registered_scan", "/terrain_map"} <= set(viewer.channels)
            viewer.subscribe("/state_estimation")
            renamed = named(topics.ODOMETRY, "original")
            assert send_until_received(bridge, viewer, renamed, odometry(7)) == encode(odometry(7))
    finally:
        bridge.close()
