"""Messages of the bus to CDR and back: exact for everything a robot measures or is told, and equal to rosbags' own bytes."""

import math
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se3 import SE3
from ambler.wire import ros_grids, ros_markers, ros_paths
from ambler.wire.ros_messages import (
    codec_of,
    decode,
    decode_any,
    encode,
    message_class_of,
    message_definition,
    ros_type_of,
)
from ambler.wire.ros_types import STORE, record_class, type_hash

float64s = st.floats(allow_nan=False, allow_infinity=True)
float32s = st.floats(-(2.0**99), 2.0**99, width=32)  # no overflow of angle_max
stamps = st.integers(-(2**31) * 10**9, (2**31) * 10**9 - 1)
words = st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"), max_size=12)
vectors = st.tuples(float64s, float64s, float64s)
poses = st.builds(SE3, vectors, st.tuples(float64s, float64s, float64s, float64s))


def arrays(dtype, shape, **kwargs):
    return hnp.arrays(dtype, shape, **kwargs)


def any_float32(count):
    return arrays(np.float32, count, elements=st.floats(width=32))


specs = st.builds(
    GridSpec,
    st.sampled_from([0.01, 0.02, 0.025, 0.05, 0.1, 0.2, 1.0]),
    st.integers(1, 9),
    st.integers(1, 9),
    st.floats(-100, 100),
    st.floats(-100, 100),
)


@st.composite
def clouds(draw):
    n = draw(st.integers(0, 30))
    return m.PointCloud(
        draw(stamps),
        draw(words),
        draw(any_float32((n, 3))),
        draw(any_float32(n)),
        draw(any_float32(n)),
        draw(arrays(np.uint16, n)),
    )


@st.composite
def glass_walls(draw):
    n = draw(st.integers(0, 9))
    ends = arrays(np.float32, (n, 4), elements=st.floats(-1e6, 1e6, width=32))
    confidence = arrays(np.float32, n, elements=st.floats(0.0, 1.0, width=32))
    return m.GlassWalls(draw(stamps), draw(words), draw(ends), draw(confidence))


@st.composite
def ground_levels(draw):
    n = draw(st.integers(0, 4))
    ends = draw(arrays(np.uint32, (n, 2), elements=st.integers(0, 9))).astype(np.float64)
    poses = draw(arrays(np.float64, (n, 3), elements=float64s))
    passages = np.column_stack((ends, poses))
    return m.GroundLevels(draw(stamps), draw(words), draw(st.integers(0, 9)), draw(st.integers(0, 9)), passages)


@st.composite
def camera_infos(draw):
    frame, size, number = draw(words), st.integers(1, 4000), st.floats(-1e4, 1e4)
    distortion = draw(st.sampled_from([5, 8]).flatmap(lambda n: st.tuples(*[number] * n)))
    model = CameraModel(frame, draw(size), draw(size), *(draw(number) for _ in range(4)), distortion)
    return m.CameraInfo(draw(stamps), frame, model)


@st.composite
def grids(draw):
    spec = draw(specs)
    data = draw(arrays(np.int8, spec.shape, elements=st.integers(-1, 100)))
    return m.OccupancyGrid(draw(stamps), draw(words), spec, data)


covariances = arrays(np.float64, (6, 6), elements=float64s)
picture_shapes = st.tuples(st.integers(1, 9), st.integers(1, 9))
MESSAGES = {
    m.LaserScan: st.builds(
        m.LaserScan, stamps, words, *[float32s] * 6, any_float32(st.integers(0, 50)), any_float32(st.integers(0, 50))
    ),
    m.Range: st.builds(m.Range, stamps, words, *[float32s] * 4),
    m.JudgedEcho: st.builds(m.JudgedEcho, stamps, words, words, poses, *[float64s] * 3, st.booleans()),
    m.GlassWalls: glass_walls(),
    m.PointCloud: clouds(),
    m.Image: st.builds(
        m.Image, stamps, words, st.one_of(arrays(np.uint8, picture_shapes), arrays(np.uint16, picture_shapes))
    ),
    m.CameraInfo: camera_infos(),
    m.BatteryState: st.builds(m.BatteryState, stamps, words, *[float32s] * 3, st.sampled_from(m.PowerSupply)),
    m.Imu: st.builds(m.Imu, stamps, words, vectors, vectors),
    m.Odometry: st.builds(m.Odometry, stamps, words, words, poses, vectors, vectors, covariances, covariances),
    m.VelocityCommand: st.builds(m.VelocityCommand, stamps, float64s, float64s, float64s),
    m.OccupancyGrid: grids(),
    m.PoseStamped: st.builds(m.PoseStamped, stamps, words, poses),
    m.PointStamped: st.builds(m.PointStamped, stamps, words, vectors),
    m.Polygon: st.builds(m.Polygon, stamps, words, any_float32(st.tuples(st.integers(0, 9), st.just(3)))),
    m.GroundLevels: ground_levels(),
    m.SlamHealth: st.builds(
        m.SlamHealth,
        stamps,
        float64s,
        float64s,
        float64s,
        arrays(np.float64, (3, 3), elements=float64s),
        *[st.integers(0, 2**32 - 1)] * 3,
    ),
    m.Contact: st.builds(m.Contact, stamps, words, words, vectors, float64s, float64s),
    m.GateStatus: st.builds(m.GateStatus, stamps, st.sampled_from(m.GateState), words, words),
    m.OutsideCall: st.builds(
        m.OutsideCall, stamps, st.sampled_from(m.OutsideKind), words, st.integers(0, 2**32 - 1), st.binary(max_size=40)
    ),
    m.Number: st.builds(m.Number, st.just(0), float32s),
    m.Code: st.builds(m.Code, st.just(0), st.integers(-128, 127)),
    m.Text: st.builds(m.Text, st.just(0), words),
    m.Status: st.builds(m.Status, stamps, words, words, words, words),
}


def assert_same(a, b):
    """Compare field by field, arrays bit by bit with their types."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        assert a.shape == b.shape
        assert a.tobytes() == b.tobytes()
        assert b.flags.aligned
        assert b.flags.c_contiguous
    elif is_dataclass(a):
        for f in fields(a):
            assert_same(getattr(a, f.name), getattr(b, f.name))
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


@pytest.mark.parametrize("message_class", MESSAGES, ids=lambda c: c.__name__)
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_every_exact_message_survives_the_wire(message_class, data):
    message = data.draw(MESSAGES[message_class])
    raw = encode(message)
    back = decode(message_class, raw)
    assert_same(message, back)
    assert encode(back) == raw


FAST = (m.Imu, m.Odometry, m.VelocityCommand, m.Transforms, m.Frontiers)
edges = st.lists(st.builds(m.TransformStamped, stamps, words, words, poses), max_size=5)

small = st.floats(-1e3, 1e3)
frontiers = st.builds(
    m.Frontiers,
    stamps,
    words,
    st.lists(
        st.builds(
            m.Frontier,
            arrays(np.float32, st.tuples(st.integers(0, 4), st.just(2)), elements=st.floats(-64, 64, width=32)),
            st.tuples(small, small),
            st.none() | st.tuples(small, small, small),
            st.floats(0, 99) | st.just(math.inf),
            st.sampled_from(m.FrontierState),
            words,
        ),
        max_size=3,
    ).map(tuple),
)


@pytest.mark.parametrize("message_class", FAST, ids=lambda c: c.__name__)
@settings(max_examples=50, deadline=None)
@given(data=st.data())
def test_bytes_packed_by_hand_equal_those_of_rosbags(message_class, data):
    trees = edges.map(lambda some: m.Transforms(0, tuple(some)))
    message = data.draw({**MESSAGES, m.Transforms: trees, m.Frontiers: frontiers}[message_class])
    codec = codec_of(message_class)
    assert codec.encode is not None
    assert encode(message) == bytes(STORE.serialize_cdr(codec.to_ros(message), codec.ros_type))


@settings(max_examples=40, deadline=None)
@given(edges)
def test_transforms_survive_and_take_their_newest_stamp(some):
    message = m.Transforms(max((e.stamp_ns for e in some), default=0), tuple(some))
    assert_same(message, decode(m.Transforms, encode(message)))


def test_a_scan_is_rounded_at_birth_so_that_a_replay_feeds_the_same():
    ranges = np.array([1.0, math.inf, math.nan, 0.25], np.float32)
    scan = m.LaserScan(7, "scan", -math.pi, 2 * math.pi / 1080, 1e-5, 0.1, 0.05, 30.0, ranges, np.empty(0, np.float32))
    assert scan.angle_increment == float(np.float32(2 * math.pi / 1080))
    assert_same(scan, decode(m.LaserScan, encode(scan)))


@settings(max_examples=50, deadline=None)
@given(stamps, words, arrays(np.float64, st.tuples(st.integers(0, 12), st.just(3)), elements=st.floats(-1e3, 1e3)))
def test_fast_path_bytes_equal_those_of_rosbags(stamp_ns, frame, rows):
    path = m.Path(stamp_ns, frame, rows)
    slow = bytes(STORE.serialize_cdr(ros_paths.path_to_ros(path), "nav_msgs/msg/Path"))
    assert encode(path) == slow
    back = decode(m.Path, slow)
    assert back.poses.shape == rows.shape
    assert np.array_equal(back.poses[:, :2], rows[:, :2])
    np.testing.assert_allclose(np.cos(back.poses[:, 2] - rows[:, 2]), 1.0, atol=1e-12)


def test_costs_fold_as_costmap_2d_publishes_them_and_folding_again_changes_nothing():
    spec = GridSpec(0.05, 256, 1, -1.0, 2.0)
    grid = m.CostGrid(3, "odom", spec, np.arange(256, dtype=np.uint8).reshape(1, 256))
    raw = encode(grid)
    occupancy = decode(m.OccupancyGrid, raw).data[0]
    assert occupancy[[0, 1, 252, 253, 254, 255]].tolist() == [0, 1, 98, 99, 100, -1]
    graded = occupancy[1:253].astype(int)
    expected = [int(1 + 97 * (c - 1) / 251) for c in range(1, 253)]
    assert graded.tolist() == expected
    back = decode(m.CostGrid, raw)
    assert back.data[0, [0, 253, 254, 255]].tolist() == [0, 253, 254, 255]
    assert np.max(np.abs(back.data.astype(int) - grid.data)) <= 3
    assert encode(back) == raw
    assert ros_grids._COST[101] == 255


def test_costs_lie_above_the_map_so_that_viewers_do_not_hide_them():
    spec = GridSpec(0.05, 2, 1, -1.0, 2.0)
    costs, occupancy = (
        m.CostGrid(3, "odom", spec, np.zeros((1, 2), np.uint8)),
        m.OccupancyGrid(3, "map", spec, np.zeros((1, 2), np.int8)),
    )
    low, high = (STORE.deserialize_cdr(encode(g), ros_type_of(type(g))).info.origin for g in (occupancy, costs))
    assert (low.position.z, high.position.z) == (0.0, 0.01)
    assert decode(m.CostGrid, encode(costs)).spec == spec


def test_frontiers_become_markers_with_their_reason():
    cells = np.array([[1.0, 2.0], [1.05, 2.0]], np.float32)
    target = m.Frontier(cells, (1.0, 2.0), (0.9, 2.0, 0.0), 3.25, m.FrontierState.TARGET)
    lost = m.Frontier(cells, (4.0, 5.0), None, math.inf, m.FrontierState.UNREACHABLE, "no path")
    dust = m.Frontier(cells[:1], (1.0, 2.0), None, math.inf, m.FrontierState.TOO_SMALL, "dust")
    message = m.Frontiers(5, "map", (target, lost, dust))
    record = STORE.deserialize_cdr(encode(message), ros_type_of(m.Frontiers))
    kinds = [(k.ns, k.id, k.action) for k in record.markers]
    cells_of_states = [("cells", 1, 0), ("cells", 2, 0), ("cells", 3, 0)]
    assert kinds == [("", 0, 3), *cells_of_states, ("goal", 0, 0), ("target", 0, 0), ("reason", 1, 0)]
    assert [(p.x, p.y) for p in record.markers[1].points] == [(float(x), float(y)) for x, y in cells]
    assert record.markers[5].text == "target, 3.2 m"
    assert record.markers[6].text == "unreachable, no path"
    assert record.markers[2].color.r > record.markers[1].color.r
    assert set(ros_markers._COLORS) == set(m.FrontierState)
    with pytest.raises(BadInputError, match="cannot be read back"):
        decode(m.Frontiers, encode(message))


def test_a_visibility_graph_is_lines_and_points_packed_as_rosbags_does():
    nodes = np.array([[0, 0, 0], [1, 2, 0.5], [3, 1, 0]], np.float32)
    edges = np.stack((nodes[:2], nodes[1:]), axis=1)
    contour = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0]], np.float32)
    kinds = np.array([0, 2, 0], np.uint8), np.array([0, 1], np.uint8)
    message = m.VisibilityGraphView(5, "map", nodes, kinds[0], edges, kinds[1], (contour,))
    codec = codec_of(m.VisibilityGraphView)
    raw = encode(message)
    assert raw == bytes(STORE.serialize_cdr(codec.to_ros(message), codec.ros_type))
    markers = STORE.deserialize_cdr(raw, codec.ros_type).markers
    names = [(k.ns, k.type, len(k.points)) for k in markers[1:]]
    assert names == [
        *(("contours", 5, 6), ("sight", 5, 2), ("along_contours", 5, 2)),
        *(("corners", 8, 2), ("driven", 8, 1)),
    ]
    assert [(p.x, p.y, p.z) for p in markers[2].points] == [(0.0, 0.0, 0.0), (1.0, 2.0, 0.5)]
    assert [(p.x, p.y) for p in markers[1].points] == [(0, 0), (1, 0), (1, 0), (1, 1), (1, 1), (0, 0)]


def test_clouds_of_other_drivers_are_read_by_field_name():
    field, cloud = record_class("sensor_msgs/msg/PointField"), record_class("sensor_msgs/msg/PointCloud2")
    header = record_class("std_msgs/msg/Header")(record_class("builtin_interfaces/msg/Time")(1, 5), "velodyne")
    layout = np.dtype({"names": ["z", "y", "x", "ring"], "formats": [">f8", ">f8", ">f8", "u1"], "itemsize": 32})
    points = np.zeros((2, 3), layout)
    for k, axis in enumerate("xyz"):
        points[axis] = np.arange(6).reshape(2, 3) * 10 + k
    points["ring"] = 4
    rows = np.zeros((2, 3 * 32 + 7), np.uint8)  # rows may be padded
    rows[:, :96] = points.view(np.uint8).reshape(2, 96)
    list_of_fields = [field("z", 0, 8, 1), field("y", 8, 8, 1), field("x", 16, 8, 1), field("ring", 24, 2, 1)]
    record = cloud(header, 2, 3, list_of_fields, True, 32, 103, rows.reshape(-1), True)
    back = decode(m.PointCloud, bytes(STORE.serialize_cdr(record, "sensor_msgs/msg/PointCloud2")))
    assert back.stamp_ns == 1_000_000_005
    assert np.array_equal(back.points, np.arange(6)[:, None] * 10.0 + np.arange(3))
    assert back.ring.tolist() == [4] * 6
    assert back.intensity.tolist() == [0.0] * 6


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(list(MESSAGES)), st.data())
def test_damaged_bytes_are_refused_or_read_but_never_crash(message_class, data):
    raw = bytearray(encode(data.draw(MESSAGES[message_class])))
    cut = data.draw(st.integers(0, len(raw)))
    for position in data.draw(st.lists(st.integers(4, max(4, len(raw) - 1)), max_size=4)):
        raw[min(position, len(raw) - 1)] ^= 0xFF
    try:
        decode(message_class, bytes(raw[:cut]))
    except BadInputError as error:
        text = str(error)
        assert ros_type_of(message_class) in text


def test_definitions_and_hashes_are_those_of_ros():
    assert type_hash("sensor_msgs/msg/LaserScan").startswith("RIHS01_64c19139")
    assert type_hash("sensor_msgs/msg/PointCloud2").startswith("RIHS01_9198cabf")
    assert type_hash("tf2_msgs/msg/TFMessage").startswith("RIHS01_e369d0f0")
    text = message_definition("geometry_msgs/msg/PoseStamped")
    assert "MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n" in text
    assert "float64 x\nfloat64 y\nfloat64 z\n" in text  # the Point keeps its plain fields


def test_the_gate_states_of_the_definition_are_those_of_the_code():
    record = record_class("ambler_msgs/msg/GateStatus")
    assert {state.name: getattr(record, state.name) for state in m.GateState} == {s.name: int(s) for s in m.GateState}


def test_every_message_class_has_a_type_and_grids_are_read_as_occupancy():
    for declared in vars(m).values():
        is_message = isinstance(declared, type) and issubclass(declared, m.Message)
        if is_message and declared not in (m.Message, m.TransformStamped):
            assert ros_type_of(declared) in STORE.types
    assert message_class_of("nav_msgs/msg/OccupancyGrid") is m.OccupancyGrid
    with pytest.raises(BadInputError, match="no message of Ambler"):
        decode_any("std_msgs/msg/Bool", b"")
