"""Clouds of every driver's columns, with the inertial measurements and the odometry that belong to them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.recordings.cloud_recording import CloudChoices, open_cloud_recording
from ambler.recordings.cloud_scan import CloudScan, ScanJoiner, returns_in_order
from ambler.wire.cloud_columns import point_times, times_within
from ambler.wire.ros_messages import encode, ros_type_of
from ambler.wire.ros_sensors import cloud_from_ros
from ambler.wire.ros_types import STORE, record_class

START_NS = 1_700_000_000_123_456_789
SWEEP_NS = 100_000_000
LIDAR_FROM_IMU = SE3((0.01, -0.02, 0.03))
BASE_FROM_LIDAR = SE3((0.4, 0.0, 0.6), (0.7071067811865476, 0.0, 0.0, 0.7071067811865476))
FORMATS = {"u1": 2, "u2": 4, "u4": 6, "f4": 7, "f8": 8}


def cloud2(columns: dict[str, np.ndarray], stamp_ns: int = START_NS, *, padding: int = 5) -> Any:
    """A PointCloud2 record of any columns, with unused bytes between the points, as drivers leave them."""
    offsets = np.concatenate(([0], np.cumsum([c.itemsize for c in columns.values()])))
    formats = [c.dtype.str for c in columns.values()]
    layout = np.dtype({"names": list(columns), "formats": formats, "offsets": offsets[:-1].tolist(), "itemsize": int(offsets[-1]) + padding})  # fmt: skip
    packed = np.zeros(len(next(iter(columns.values()))), layout)
    for name, values in columns.items():
        packed[name] = values
    kinds = [FORMATS[c.dtype.str[1:]] for c in columns.values()]
    fields = [
        record_class("sensor_msgs/msg/PointField")(n, int(o), k, 1)
        for n, o, k in zip(columns, offsets, kinds, strict=False)
    ]
    time = record_class("builtin_interfaces/msg/Time")(stamp_ns // 10**9, stamp_ns % 10**9)
    header = record_class("std_msgs/msg/Header")(time, "lidar")
    size = layout.itemsize * len(packed)
    return record_class("sensor_msgs/msg/PointCloud2")(
        header, 1, len(packed), fields, False, layout.itemsize, size, packed.view(np.uint8), True
    )


LATE = np.linspace(0.0, 0.0999, 40)
XYZ = {axis: np.linspace(1.0, 2.0, 40).astype(np.float32) for axis in "xyz"}
TIMES = {
    "velodyne": ("time", LATE.astype(np.float32)),
    "ouster": ("t", np.rint(LATE * 1e9).astype(np.uint32)),
    "hesai": ("timestamp", START_NS * 1e-9 + LATE),
    "livox": ("timestamp", (START_NS + np.rint(LATE * 1e9)).astype(np.float64)),
    "livox_custom": ("offset_time", np.rint(LATE * 1e9).astype(np.uint32)),
    "seconds_in_doubles": ("timestamp", LATE),
}


@pytest.mark.parametrize("driver", TIMES)
def test_the_times_of_points_are_read_whatever_their_unit(driver: str) -> None:
    name, values = TIMES[driver]
    cloud = cloud_from_ros(cloud2({**XYZ, name: values}))
    assert cloud.time.dtype == np.float32
    np.testing.assert_allclose(cloud.time, LATE, atol=5e-7)


SWEEP = np.linspace(0.0, 0.0999, 400)
UNITS = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("kind", ["f4", "f8", "u4", "epoch", "boot"])
def test_the_unit_of_times_is_that_in_which_they_are_of_a_sweep_or_near_the_stamp(unit: str, kind: str) -> None:
    """After the stamp, or of its clock: since the epoch, or since the robot was switched on."""
    if kind == "u4" and unit == "s":
        return  # whole seconds tell nothing
    stamp_ns = 1_000_000_000_000 if kind == "boot" else START_NS
    told = (SWEEP if kind in ("f4", "f8", "u4") else stamp_ns * 1e-9 + SWEEP) * UNITS[unit]
    packed = np.zeros(400, [("time", kind if kind in ("f4", "f8", "u4") else "f8")])
    packed["time"] = told
    late = point_times(packed, stamp_ns)
    np.testing.assert_allclose(late, SWEEP, atol=1e-3 if (kind, unit) == ("u4", "ms") else 2e-6)


def test_times_of_no_sweep_are_refused_by_name_and_those_of_an_instant_are_not() -> None:
    """Times since the epoch in single precision say nothing; points that were taken at once do."""
    coarse = np.zeros(400, [("timestamp", "f4")])
    coarse["timestamp"] = 1.7e9
    coarse["timestamp"][200:] += 128.0
    with pytest.raises(BadInputError, match="the column 'timestamp' tells times from"):
        point_times(coarse, START_NS)
    packed = np.zeros(400, [("timestamp", "f8")])
    packed["timestamp"] = START_NS * 1e-9 + SWEEP
    packed["timestamp"][::2] = 0.0
    np.testing.assert_allclose(point_times(packed, START_NS)[1::2], SWEEP[1::2], atol=1e-6)
    packed["timestamp"] = START_NS * 1e-9
    assert np.abs(point_times(packed, START_NS)).max() < 1e-6
    assert point_times(packed, 5_000_000_000).tolist() == [0.0] * 400
    few = np.zeros(5, [("t", "u4")])
    few["t"] = [100_000, 110_000, 120_000, 130_000, 140_000]
    assert point_times(few, START_NS)[0] == pytest.approx(1e-4), "a few of the first returns of an Ouster"


@pytest.mark.parametrize("span_ns", [780_000, 1_560_000, 10_000_000, 100_000_000, 1_500_000_000])
def test_whole_nanoseconds_of_packets_are_no_microseconds(span_ns: int) -> None:
    """0 to 1 560 000: in µs it would be a sweep of a second and a half. After the stamp, and of another clock."""
    for begin in (0, 400 * 10**9):
        packed = np.zeros(400, [("t", "i8")])
        packed["t"] = begin + np.rint(np.linspace(0.0, span_ns, 400))
        np.testing.assert_allclose(point_times(packed, START_NS), np.linspace(0.0, 1e-9 * span_ns, 400), atol=2e-7)


@pytest.mark.parametrize("spacing", [390e-6, 1.56e-3, 0.1, 1.0])
@pytest.mark.parametrize(("unit", "kind"), [("ns", "u4"), ("us", "u4"), ("us", "f4"), ("ms", "f4"), ("s", "f4")])
def test_the_spacing_of_clouds_tells_the_unit_where_numbers_do_not(spacing: float, unit: str, kind: str) -> None:
    """A packet of 0.39 ms in ns may be one of 0.39 s in µs, one of 1.56 ms one of 1.56 s in ms."""
    late = np.linspace(0.0, 0.999 * spacing, 400)
    packed = np.zeros(400, [("t", kind)])
    packed["t"] = np.rint(late * UNITS[unit]) if kind == "u4" else late * UNITS[unit]
    seconds = times_within(point_times(packed, START_NS), spacing)
    assert seconds.dtype == np.float32
    np.testing.assert_allclose(seconds, late, atol=2e-6)


def test_a_recording_of_packets_has_the_times_that_their_spacing_bears_out(tmp_path: Path) -> None:
    step_ns = 390_000
    columns = {**{axis: np.ones(400, np.float32) for axis in "xyz"}, "t": np.linspace(0.0, step_ns, 400).astype("u4")}
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/points", ros_type_of(m.PointCloud), typestore=STORE)
        for k in range(60):
            record = cloud2(columns, START_NS + k * step_ns)
            writer.write(topic, START_NS + k * step_ns, STORE.serialize_cdr(record, ros_type_of(m.PointCloud)))
    recording = open_cloud_recording(tmp_path / "bag")
    assert "the first 0.000 s long" in recording.notes[0]
    (scan,) = recording.scans()
    assert scan.end_ns - START_NS == pytest.approx(60 * step_ns, abs=1000)


def test_clouds_of_several_lidars_on_one_topic_keep_their_times() -> None:
    late = LATE.astype(np.float32)
    for spacing in (None, 0.0, 0.1 / 6, 0.1):
        assert times_within(late, spacing) is late
    instant = np.zeros(0, np.float32)
    assert times_within(instant, 1.0) is instant


OTHER_CLOCKS = {"GPS": 37.0, "behind GPS": -18.0, "years": -3e8, "since boot": 500.0 - START_NS * 1e-9}


@pytest.mark.parametrize("clock", OTHER_CLOCKS)
@pytest.mark.parametrize("unit", UNITS)
def test_times_of_another_clock_than_the_stamp_tell_how_points_follow_one_another(clock: str, unit: str) -> None:
    """A LiDAR that nobody set, under stamps of the computer: taken as told, its points were of another time than all measurements."""
    told = (START_NS * 1e-9 + OTHER_CLOCKS[clock] + SWEEP) * UNITS[unit]
    for kind in ("f8",) if unit == "s" else ("f8", "i8"):
        packed = np.zeros(401, [("timestamp", kind)])
        packed["timestamp"][1:] = told  # the first one is no point
        late = point_times(packed, START_NS)[1:]
        np.testing.assert_allclose(late, SWEEP, atol=1.1e-3 if (kind, unit) == ("i8", "ms") else 2e-6)
    packed = np.zeros(400, [("timestamp", "f8")])
    packed["timestamp"] = START_NS * 1e-9 + SWEEP
    np.testing.assert_allclose(point_times(packed, 5_000_000_000), SWEEP, atol=2e-6)


@pytest.mark.parametrize("name", ["time_stamp", "point_time_offset", "time_offset_ns"])
def test_times_go_by_many_names(name: str) -> None:
    cloud = cloud_from_ros(cloud2({**XYZ, name: np.rint(LATE * 1e9).astype(np.uint32)}))
    np.testing.assert_allclose(cloud.time, LATE, atol=5e-7)


@pytest.mark.parametrize("step", [0, 40 * 17])
def test_rows_follow_one_another_where_their_step_is_not_told_rightly(step: int) -> None:
    record = cloud2(XYZ)
    record.height, record.width, record.row_step = 4, 10, step
    np.testing.assert_array_equal(cloud_from_ros(record).points[:, 0], XYZ["x"])


def test_a_recording_without_times_of_points_is_told(tmp_path: Path) -> None:
    """And of what is no point the time does not count."""
    path = write(tmp_path / "bag")
    assert "no times of its points" not in open_cloud_recording(path).notes[0]
    zero, nowhere = np.zeros(40, np.float32), np.full((1, 3), np.nan, np.float32)
    points = np.concatenate([cloud_at(0, 1.0).points[1:], nowhere])
    for last, text in ((0.0, "no times of its points"), (-1.7e9, "the first 0.000 s long")):
        time = zero.copy()
        time[-1] = last
        cloud = m.PointCloud(START_NS, "lidar", points, zero, time, np.zeros(40, np.uint16))
        folder = tmp_path / f"bag{last:g}"
        with Writer2(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topic = writer.add_connection("/points", ros_type_of(m.PointCloud), typestore=STORE)
            writer.write(topic, START_NS, encode(cloud))
        assert text in open_cloud_recording(folder).notes[0]


@pytest.mark.parametrize(("frame", "pose"), [("", None), ("/", None), ("one", SE3())])
def test_two_frames_without_a_name_are_not_one(frame: str, pose: SE3 | None, tmp_path: Path) -> None:
    """LiDAR and IMU had been taken to be in one place, and nobody was asked for the mount."""
    sent = (
        ("/points", replace(cloud_at(START_NS, 1.0), frame=frame)),
        ("/imu", m.Imu(START_NS, frame, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))),
    )
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, message in sent:
            connection = writer.add_connection(topic, ros_type_of(type(message)), typestore=STORE)
            writer.write(connection, START_NS, encode(message))
    assert open_cloud_recording(tmp_path / "bag").lidar_from_imu == pose


def test_a_stamp_at_the_end_of_the_sweep_gives_times_before_it() -> None:
    cloud = cloud_from_ros(cloud2({**XYZ, "timestamp": START_NS * 1e-9 + LATE}, START_NS + SWEEP_NS))
    np.testing.assert_allclose(cloud.time, LATE - 0.1, atol=5e-7)
    assert cloud_from_ros(cloud2(XYZ)).time.tolist() == [0.0] * 40


def test_rings_and_intensities_go_by_several_names() -> None:
    line, bright = np.arange(40, dtype=np.uint8), np.arange(40, dtype=np.uint16)
    cloud = cloud_from_ros(cloud2({**XYZ, "reflectivity": bright, "line": line}))
    np.testing.assert_array_equal(cloud.ring, line)
    np.testing.assert_array_equal(cloud.intensity, bright)


def test_what_did_not_return_is_left_out_and_the_rest_ordered() -> None:
    points = np.array([[1, 0, 0], [np.nan, 0, 0], [0, 0, 0], [2, 0, 0], [np.inf, 1, 1], [3, 0, 0]], np.float32)
    time = np.array([0.05, 0.01, 0.02, 0.0, 0.03, 0.05], np.float32)
    ring = np.arange(6, dtype=np.uint16)
    out = returns_in_order(m.PointCloud(9, "lidar", points, time * 10, time, ring))
    np.testing.assert_array_equal(out.points[:, 0], [2.0, 1.0, 3.0])
    np.testing.assert_array_equal(out.ring, [3, 0, 5])
    np.testing.assert_array_equal(out.intensity, np.array([0.0, 0.5, 0.5], np.float32))
    assert out.stamp_ns == 9


def cloud_at(stamp_ns: int, first: float) -> m.PointCloud:
    points = np.full((40, 3), first, np.float32)
    return m.PointCloud(
        stamp_ns, "lidar", points, points[:, 0].copy(), LATE.astype(np.float32), np.zeros(40, np.uint16)
    )


def write(
    folder: Path,
    *,
    imus: tuple[str, ...] = ("/imu",),
    storage: StoragePlugin = StoragePlugin.MCAP,
    idle: tuple[str, ...] = (),
    idle_ns: int = 0,
) -> Path:
    """Ten clouds, logged when they are complete; 200 Hz of inertial measurements, logged 20 ms late; 50 Hz of odometry. Topics of `idle` have no clock and bear
    one stamp."""
    zero, none = np.zeros((6, 6)), (0.0, 0.0, 0.0)
    edges = (
        m.TransformStamped(0, "lidar", "imu", LIDAR_FROM_IMU),
        m.TransformStamped(0, "base_link", "lidar", BASE_FROM_LIDAR),
    )
    out: list[tuple[int, str, m.Message]] = [(0, "/tf_static", m.Transforms(0, edges))]
    for k in range(10):
        stamp_ns = START_NS + k * SWEEP_NS
        out.append((stamp_ns + SWEEP_NS, "/points", cloud_at(stamp_ns, float(k + 1))))
    out.append((START_NS + 5 * SWEEP_NS + 1, "/points", cloud_at(START_NS + 3 * SWEEP_NS, 99.0)))
    for k in range(210):
        stamp_ns = START_NS - 25_000_000 + k * 5_000_000
        out += [(stamp_ns + 20_000_000, topic, m.Imu(stamp_ns, "imu", none, (0.0, 0.0, float(k)))) for topic in imus]
        if k % 4 == 0:
            pose = m.Odometry(stamp_ns, "odom", "base_link", SE3(), none, none, zero, zero.copy())
            out.append((stamp_ns + 1, "/odom", pose))
    with Writer2(folder, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for log_ns, topic, message in sorted(out, key=lambda entry: entry[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, ros_type_of(type(message)), typestore=STORE)
            if topic in idle and not isinstance(message, m.Transforms):
                message = replace(message, stamp_ns=idle_ns)
            writer.write(connections[topic], max(START_NS - 10**9, log_ns), encode(message))
    return folder


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_each_cloud_comes_with_all_measurements_up_to_its_end_and_one_more(
    storage: StoragePlugin, tmp_path: Path
) -> None:
    recording = open_cloud_recording(write(tmp_path / "bag", storage=storage))
    scans = list(recording.scans())
    assert [scan.cloud.points[0, 0] for scan in scans] == list(range(1, 11)), "the cloud of an old stamp is left out"
    for scan in scans[:-1]:
        assert scan.end_ns == pytest.approx(scan.cloud.stamp_ns + 99_900_000, abs=100)
        for stream, period in ((scan.imu, 5_000_000), (scan.odometry, 20_000_000)):
            assert stream[-1].stamp_ns >= scan.end_ns > stream[-2].stamp_ns
            assert stream[-1].stamp_ns - scan.end_ns < period
    told = [sample.linear_acceleration[2] for scan in scans for sample in scan.imu]
    assert told == sorted(set(told)), "each once, in order"
    assert told[: len(scans[0].imu)] == [float(k) for k in range(26)], "also what was measured before the first cloud"
    assert [scan.cloud.stamp_ns for scan in recording.scans()] == [scan.cloud.stamp_ns for scan in scans], "again"


@pytest.mark.parametrize("idle_ns", [0, 7_000_000_000])
def test_messages_of_drivers_without_a_clock_are_of_the_time_at_which_they_were_recorded(
    idle_ns: int, tmp_path: Path
) -> None:
    """A cloud is recorded when its last point has been taken; only those without a clock are touched."""
    stamped = list(open_cloud_recording(write(tmp_path / "stamped")).scans())
    for name, idle in {"all": ("/points", "/imu", "/odom"), "clouds": ("/points",), "imu": ("/imu",)}.items():
        recording = open_cloud_recording(write(tmp_path / name, idle=idle, idle_ns=idle_ns))
        scans = list(recording.scans())
        told = [note for note in recording.notes if "the times at which they were recorded" in note]
        assert [note.split(":")[0] for note in told] == sorted(idle)
        assert sum(scan.left_out for scan in scans) == ("/points" not in idle)  # the cloud of an old stamp
        shift_ns = SWEEP_NS - 99_900_000 if "/points" in idle else 0
        kept = [scan for scan in scans if scan.cloud.points[0, 0] != 99.0]
        for scan, usual in zip(kept, stamped, strict=True):
            assert scan.cloud.stamp_ns == pytest.approx(usual.cloud.stamp_ns + shift_ns, abs=100)
        late_ns = 20_000_000 if "/imu" in idle else 0
        first = scans[0].imu[0].stamp_ns
        assert first == START_NS - 25_000_000 + late_ns


KINDS = ("cloud", "imu", "odometry")


@pytest.mark.parametrize(("begin_ns", "left_out"), [(START_NS, 2), (0, 0)])
def test_messages_before_a_driver_has_a_clock_are_left_out(begin_ns: int, left_out: int) -> None:
    """They bear a stamp of zero; where time begins there, the first of them is one like all."""
    joiner, scans = ScanJoiner(waits_for_imu=False, waits_for_odometry=False), list[CloudScan]()
    for k, stamp_ns in enumerate([0, *([0] if left_out else []), *(begin_ns + (j + 1) * SWEEP_NS for j in range(8))]):
        joiner.add(cloud_at(stamp_ns, 1.0 + k))
        scans += joiner.ready()
    scans += joiner.rest()
    assert [scan.cloud.points[0, 0] for scan in scans] == list(range(1 + left_out, 11 if left_out else 10))
    assert sum(scan.left_out for scan in scans) == left_out


@pytest.mark.parametrize("kind", KINDS)
def test_one_stamp_that_jumps_ahead_does_not_leave_out_what_follows(kind: str) -> None:
    """Nor does a gap leave anything out; what is left out is counted with the next cloud."""

    none, zero = (0.0, 0.0, 0.0), np.zeros((6, 6))

    def given(*wrong: int) -> list[CloudScan]:
        joiner, out = ScanJoiner(), []
        for k in range(20):
            right_ns = START_NS + k * SWEEP_NS + (30_000_000_000 if k >= 12 else 0)
            ns = {name: right_ns + (10_000_000_000 if k in wrong and name == kind else 0) for name in KINDS}
            joiner.add(cloud_at(ns["cloud"], float(k)))
            joiner.add(m.Imu(ns["imu"], "imu", none, none))
            joiner.add(m.Odometry(ns["odometry"], "odom", "base_link", SE3(), none, none, zero, zero))
            out += joiner.ready()
        return [*out, *joiner.rest()]

    def counts(scans: list[CloudScan]) -> dict[str, int]:
        return {
            "cloud": len(scans),
            "imu": sum(len(s.imu) for s in scans),
            "odometry": sum(len(s.odometry) for s in scans),
        }

    whole = given()
    assert counts(whole) == dict.fromkeys(KINDS, 20)
    assert sum(s.left_out for s in whole) == 0
    for wrong in (0, 5):
        lone = given(wrong)
        assert counts(lone) == {name: 20 - (name == kind) for name in KINDS}
        assert sum(s.left_out for s in lone) == 1


def test_clouds_wait_for_measurements_far_behind_up_to_a_limit_of_memory() -> None:
    """Two hundred small ones, twenty seconds, wait; where they are too much they come without, and are told to."""
    clouds = [cloud_at(START_NS + k * SWEEP_NS, 1.0) for k in range(200)]
    for held_mb, overdue in ((300.0, 0), (0.3, 41)):
        joiner, scans = ScanJoiner(waits_for_odometry=False, held_mb=held_mb), list[CloudScan]()
        for cloud in clouds:
            joiner.add(cloud)
            scans += joiner.ready()
        assert len(scans) == overdue
        assert all(scan.is_overdue and not scan.imu for scan in scans)
        for k in range(4100):
            joiner.add(of_kind("imu", START_NS + k * 5_000_000))
        scans += [*joiner.ready(), *joiner.rest()]
        assert [scan.cloud.stamp_ns for scan in scans] == [cloud.stamp_ns for cloud in clouds]
        assert not any(scan.is_overdue for scan in scans[overdue:])
        assert all(scan.imu[-1].stamp_ns >= scan.end_ns for scan in scans[overdue:])


def test_a_robot_waits_for_few_clouds() -> None:
    joiner, sizes = ScanJoiner(held_most=10), []
    for k in range(14):
        joiner.add(cloud_at(START_NS + k * SWEEP_NS, 1.0))
        sizes.append(len(list(joiner.ready())))
    assert sizes == [0] * 10 + [1] * 4


NONE, ZERO = (0.0, 0.0, 0.0), np.zeros((6, 6))


def of_kind(kind: str, stamp_ns: int) -> m.Message:
    return {
        "cloud": cloud_at(stamp_ns, 1.0),
        "imu": m.Imu(stamp_ns, "imu", NONE, NONE),
        "odometry": m.Odometry(stamp_ns, "odom", "base_link", SE3(), NONE, NONE, ZERO, ZERO.copy()),
    }[kind]


def walked(kind: str, steps: list[float]) -> ScanJoiner:
    """A joiner that was given messages of these times (s), those of `kind`."""
    joiner = ScanJoiner()
    for step in steps:
        joiner.add(of_kind(kind, START_NS + round(step * 1e9)))
    return joiner


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("back", [2.5, 3600.0])
def test_a_clock_that_goes_back_is_told(kind: str, back: float) -> None:
    steps = [0.1 * k for k in range(50)]
    after = [4.9 + 0.1 * (k + 1) - back for k in range(10)]
    text = walked(kind, [*steps, *(s + 0.013 for s in after)]).went_back
    assert f"went back by {back - 0.1:.1f} s after {1e-9 * START_NS + 4.9:.3f} s" in text
    assert text.startswith("the clock of the " + {"imu": "inertial measurements", "cloud": "clouds"}.get(kind, kind))
    assert walked(kind, [*steps, *(s + 0.013 for s in after[:9])]).went_back == ""


ODD = {
    "a stretch that came before": [0.1 * k for k in range(30)],
    "one wrong stamp a second": [s for k in range(50, 150) for s in ([0.1 * k] if k % 10 else [0.1 * k, -3600.0 + k])],
    "one old stamp after the other": [-5.0 - 0.1 * k for k in range(40)],
    "a little out of order": [4.05 + 0.01 * k for k in range(50)],
    "no clock": [-1e-9 * START_NS] * 40,
}


@pytest.mark.parametrize("odd", ODD)
def test_what_comes_in_disorder_is_no_clock_that_goes_back(odd: str) -> None:
    assert walked("cloud", [*(0.1 * k for k in range(50)), *ODD[odd]]).went_back == ""


@pytest.mark.parametrize("back_ns", [0, 3600 * 10**9])
def test_a_recording_whose_clock_goes_back_ends_there_with_the_reason(back_ns: int, tmp_path: Path) -> None:
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {k: writer.add_connection(f"/{k}", ros_type_of(type(of_kind(k, 1))), typestore=STORE) for k in KINDS}
        for k in range(120):
            log_ns = START_NS + k * SWEEP_NS
            for kind in KINDS:
                stamp_ns = log_ns - (back_ns if k >= 60 else 0)
                writer.write(topics[kind], log_ns, encode(of_kind(kind, stamp_ns)))
    scans, recording = list[CloudScan](), open_cloud_recording(tmp_path / "bag")
    if back_ns == 0:
        assert len(list(recording.scans())) == 120
        return
    with pytest.raises(
        BadInputError, match=r"bag: the clock of the clouds went back by 3599\.9 s after 1700000006\.023 s"
    ):
        scans.extend(recording.scans())
    assert [scan.cloud.stamp_ns for scan in scans] == [START_NS + k * SWEEP_NS for k in range(60)]


def test_mounts_and_choices_are_told(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", imus=("/imu", "/imu_rear"))
    with pytest.raises(BadInputError, match="--imu-topic"):
        open_cloud_recording(path)
    recording = open_cloud_recording(path, CloudChoices(imu_topic="/imu_rear"))
    assert recording.lidar_from_imu == LIDAR_FROM_IMU
    assert recording.base_from_lidar is not None
    np.testing.assert_allclose(recording.base_from_lidar.matrix(), BASE_FROM_LIDAR.matrix(), atol=1e-12)
    assert "/points in frame 'lidar', the first 0.100 s long" in recording.notes[0]
    bare = open_cloud_recording(path, CloudChoices(imu_topic="none", odom_topic="none"))
    assert (bare.imu_topic, bare.odom_topic, bare.lidar_from_imu) == (None, None, None)
    assert all(scan.imu == scan.odometry == () for scan in bare.scans())
    with pytest.raises(BadInputError, match="no PointCloud there"):
        open_cloud_recording(path, CloudChoices(cloud_topic="/cloud"))
