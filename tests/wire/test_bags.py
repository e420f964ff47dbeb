"""Bags of all kinds give the same messages; damaged, empty, truncated and foreign files are named, never a traceback."""

from __future__ import annotations

import math
import shutil
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.wire.bags import open_bag
from ambler.wire.ros_messages import encode, ros_type_of
from ambler.wire.ros_types import STORE
from tests.public_data import public

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
COUNT = 15


def scan_at(stamp_ns: int) -> m.LaserScan:
    ranges = np.linspace(1.0, 5.0, 30).astype(np.float32)
    ranges[3], ranges[4] = np.inf, np.nan
    return m.LaserScan(stamp_ns, "laser", -1.0, 0.05, 0.001, 0.1, 0.1, 20.0, ranges, np.zeros(0, np.float32))


def odometry_at(stamp_ns: int) -> m.Odometry:
    pose = SE3.from_se2(SE2(stamp_ns * 1e-9, 0.5, 0.3))
    return m.Odometry(
        stamp_ns, "odom", "base", pose, (1.0, 0.0, 0.0), (0.0, 0.0, 0.2), np.eye(6), np.diag(np.arange(6.0))
    )


def recorded() -> list[tuple[str, m.Message, int]]:
    out: list[tuple[str, m.Message, int]] = []
    edge = m.TransformStamped(5, "base", "laser", SE3((0.1, 0.2, 0.3), (0.0, 0.0, 0.0, 1.0)))
    out.append(("/tf_static", m.Transforms(5, (edge,)), 1_000_000_000))
    for k in range(COUNT):
        stamp_ns = 1_000_000_000 + k * 100_000_000
        out.append(("/scan", scan_at(stamp_ns), stamp_ns + 1_000_000))
        out.append(("/odom", odometry_at(stamp_ns), stamp_ns + 2_000_000))
        out.append(("/imu", m.Imu(stamp_ns, "imu", (0.1, 0.2, 0.3), (0.0, 0.0, 9.81)), stamp_ns + 3_000_000))
    points = np.arange(12, dtype=np.float32).reshape(4, 3)
    cloud = m.PointCloud(7, "lidar", points, points[:, 0].copy(), points[:, 1].copy(), np.arange(4, dtype=np.uint16))
    out.append(("/points", cloud, 1_000_000_000 + COUNT * 100_000_000))
    return out


def write_ros2(folder: Path, storage: StoragePlugin) -> Path:
    with Writer2(folder, version=9, storage_plugin=storage) as writer:
        connections = {}
        for topic, message, log_ns in recorded():
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, ros_type_of(type(message)), typestore=STORE)
            writer.write(connections[topic], log_ns, encode(message))
        string = STORE.types["std_msgs/msg/String"]("hello")
        extra = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=STORE)
        writer.write(extra, 1_500_000_000, STORE.serialize_cdr(string, "std_msgs/msg/String"))
    return folder


def write_ros1(path: Path, packing: Writer1.CompressionFormat | None = None) -> Path:
    header = ROS1.types["std_msgs/msg/Header"]
    time = ROS1.types["builtin_interfaces/msg/Time"]
    writer = Writer1(path)
    if packing is not None:
        writer.set_compression(packing)
    with writer:
        connections = {}
        for topic, message, log_ns in recorded():
            ros_type = ros_type_of(type(message))
            record = STORE.deserialize_cdr(encode(message), ros_type)
            parts = record.transforms if ros_type.endswith("TFMessage") else [record]
            for part in parts:
                stamp = part.header.stamp
                part.header = header(0, time(stamp.sec, stamp.nanosec), part.header.frame_id)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, ros_type, typestore=ROS1)
            writer.write(connections[topic], log_ns, bytes(ROS1.serialize_ros1(record, ros_type)))
    return path


MAKERS: dict[str, Callable[[Path], Path]] = {
    "db3 folder": lambda p: write_ros2(p / "bag", StoragePlugin.SQLITE3),
    "mcap folder": lambda p: write_ros2(p / "bag", StoragePlugin.MCAP),
    "db3 file": lambda p: write_ros2(p / "bag", StoragePlugin.SQLITE3) / "bag.db3",
    "mcap file": lambda p: write_ros2(p / "bag", StoragePlugin.MCAP) / "bag.mcap",
    "ros1 file": lambda p: write_ros1(p / "a.bag"),
}


def make(kind: str, folder: Path) -> Path:
    path = MAKERS[kind](folder)
    assert path.exists()
    return path


@pytest.mark.parametrize("kind", MAKERS)
def test_every_kind_gives_the_recorded_messages(kind: str, tmp_path: Path) -> None:
    with open_bag(make(kind, tmp_path)) as bag:
        got = list(bag.messages())
        names = {t.name: t for t in bag.topics()}
        assert bag.start_ns == 1_000_000_000
    expected = sorted(recorded(), key=lambda r: r[2])
    assert [(g.topic, g.log_ns) for g in got] == [(topic, log_ns) for topic, _, log_ns in expected]
    for (_, message, _), reading in zip(expected, got, strict=True):
        assert encode(reading.message) == encode(message)
    assert names["/scan"].count == COUNT
    assert names["/scan"].message_class is m.LaserScan
    if kind != "ros1 file":
        assert names["/chatter"].message_class is None


@pytest.mark.parametrize("kind", ["db3 folder", "mcap file", "ros1 file"])
def test_topics_and_types_choose(kind: str, tmp_path: Path) -> None:
    with open_bag(make(kind, tmp_path)) as bag:
        assert {g.topic for g in bag.messages(["/odom", "/imu"])} == {"/odom", "/imu"}
        assert {type(g.message) for g in bag.messages(types=[m.Transforms])} == {m.Transforms}
        assert list(bag.messages(["/odom"], [m.LaserScan])) == []
        with pytest.raises(BadInputError, match="no topic '/laser', only"):
            bag.messages(["/laser"])
        if kind != "ros1 file":
            with pytest.raises(BadInputError, match="'/chatter' is std_msgs/msg/String, which Ambler does not read"):
                bag.messages(["/chatter"])


def test_a_bag_that_was_not_closed_is_completed_from_its_write_ahead_log(tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "bag", StoragePlugin.SQLITE3)
    connection = sqlite3.connect(folder / "bag.db3")
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA wal_autocheckpoint=0")
    data = connection.execute("SELECT topic_id, data FROM messages WHERE topic_id = 2 LIMIT 1").fetchone()
    for k in range(5):
        row = (data[0], 9_000_000_000 + k, data[1])
        connection.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    connection.commit()
    crashed = tmp_path / "crashed"
    shutil.copytree(folder, crashed)
    connection.close()
    assert (crashed / "bag.db3-wal").stat().st_size > 0
    crashed.chmod(0o555)
    before = sorted((f.name, f.stat().st_size) for f in crashed.iterdir())
    for path in (crashed, crashed / "bag.db3"):
        with open_bag(path) as bag:
            late = [g for g in bag.messages() if g.log_ns >= 9_000_000_000]
        assert len(late) == 5
        assert {g.topic for g in late} == {"/scan"}
    assert sorted((f.name, f.stat().st_size) for f in crashed.iterdir()) == before
    crashed.chmod(0o755)


@pytest.mark.parametrize("is_folder", [True, False], ids=["folder", "file"])
def test_an_mcap_bag_without_its_end_is_read_up_to_the_cut(is_folder: bool, tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "bag", StoragePlugin.MCAP)
    file = folder / "bag.mcap"
    _check_cut(folder, file, file.read_bytes()[:-60], folder if is_folder else file)
    with open_bag(file) as bag:
        assert "/chatter" in {t.name for t in bag.topics()}, "types that are not ours are kept"
    _refuse_head(file, 40)


@pytest.mark.parametrize("packing", [None, Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4])
def test_a_ros1_bag_without_its_index_is_read_up_to_the_cut(
    packing: Writer1.CompressionFormat | None, tmp_path: Path
) -> None:
    """As `rosbag record` leaves it in a crash; such a file must be reindexed before anything else reads it."""
    file = tmp_path / "a.bag"
    write_ros1(file, packing)
    data = file.read_bytes()
    at = struct.unpack("<Q", data[data.index(b"index_pos=") + 10 :][:8])[0]
    _check_cut(file, file, data[: at + 7], file)
    never_closed = data[:at].replace(b"index_pos=" + struct.pack("<Q", at), b"index_pos=" + bytes(8))
    _check_cut(None, file, never_closed, file)
    _refuse_head(file, 5000)


def test_of_a_ros1_bag_that_was_cut_in_a_chunk_whole_messages_are_read(tmp_path: Path) -> None:
    file = write_ros1(tmp_path / "a.bag")
    with open_bag(file) as bag:
        everything = [(g.topic, g.log_ns) for g in bag.messages()]
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    with open_bag(file) as bag:
        got = [(g.topic, g.log_ns) for g in bag.messages()]
        assert bag.notes == (f"{file} is cut off: read up to the cut",)
    assert 0.3 * len(everything) < len(got) < 0.7 * len(everything)
    assert set(got) < set(everything)


@pytest.mark.parametrize("is_folder", [True, False], ids=["folder", "file"])
def test_a_sqlite_bag_that_lost_its_end_is_read_as_far_as_it_goes(is_folder: bool, tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "bag", StoragePlugin.SQLITE3)
    file = folder / "bag.db3"
    with open_bag(folder) as bag:
        everything = [(g.topic, g.log_ns) for g in bag.messages()]
        assert bag.notes == ()
    data = file.read_bytes()
    file.write_bytes(data[: len(data) * 4 // 5])
    before = sorted((f.name, f.stat().st_size) for f in folder.iterdir())
    with open_bag(folder if is_folder else file) as bag:
        got = [(g.topic, g.log_ns) for g in bag.messages()]
        assert bag.notes == (f"{file} is cut off: read up to the cut",)
    assert 0.2 * len(everything) < len(got) < 0.9 * len(everything)
    assert set(got) < set(everything)
    assert sorted((f.name, f.stat().st_size) for f in folder.iterdir()) == before
    _refuse_head(file, 5000)


def test_a_copy_that_cannot_be_written_is_told_and_not_taken_for_the_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk: fewer messages than there are must not pass for all that lie before the cut."""
    file = write_ros1(tmp_path / "a.bag")
    file.write_bytes(file.read_bytes()[:-2000])
    written: list[int] = []

    def write(self: Writer1, connection: object, timestamp: int, data: bytes) -> None:
        written.append(timestamp)
        if len(written) > 5:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer1, "write", write)
    with pytest.raises(BadInputError, match="No space left"):
        open_bag(file)


def _check_cut(whole: Path | None, file: Path, cut: bytes, opened: Path) -> None:
    """Cut a file so that only its end is missing: everything is read (of `whole` before, if that can be), and nothing is written beside it."""
    expected = [(topic, log_ns) for topic, _, log_ns in sorted(recorded(), key=lambda r: r[2])]
    if whole is not None:
        with open_bag(whole) as bag:
            expected = [(g.topic, g.log_ns) for g in bag.messages()]
            assert bag.notes == ()
    file.write_bytes(cut)
    before = sorted((f.name, f.stat().st_size) for f in file.parent.iterdir())
    with open_bag(opened) as bag:
        got = [(g.topic, g.log_ns) for g in bag.messages()]
        assert bag.notes == (f"{file} is cut off: read up to the cut",)
    assert got == expected
    assert sorted((f.name, f.stat().st_size) for f in file.parent.iterdir()) == before


def _refuse_head(file: Path, size: int) -> None:
    file.write_bytes(file.read_bytes()[:size])
    with pytest.raises(BadInputError, match="is cut off before its first message"):
        open_bag(file)


def test_split_recordings_in_one_folder_without_metadata(tmp_path: Path) -> None:
    first = write_ros2(tmp_path / "one", StoragePlugin.MCAP) / "one.mcap"
    second = write_ros2(tmp_path / "two", StoragePlugin.MCAP) / "two.mcap"
    folder = tmp_path / "both"
    folder.mkdir()
    shutil.copy(first, folder)
    shutil.copy(second, folder)
    with open_bag(folder) as bag:
        logs = [g.log_ns for g in bag.messages(types=[m.LaserScan])]
    assert len(logs) == 2 * COUNT
    assert logs == sorted(logs)


@pytest.mark.parametrize("kind", ["db3 folder", "mcap file", "ros1 file"])
def test_damage_anywhere_is_a_named_error_or_harmless(kind: str, tmp_path: Path) -> None:
    """Cut and flip bytes all over the file: reading ends with a BadInputError or with messages, never with anything else."""
    original = make(kind, tmp_path)
    target = next(f for f in original.iterdir() if f.name.startswith("bag.")) if original.is_dir() else original
    content = target.read_bytes()
    rng = np.random.default_rng(5)
    errors = 0
    for trial in range(14):
        damaged = bytearray(content)
        if trial % 2:
            del damaged[int(rng.integers(1, len(content))) :]
        else:
            begin = int(rng.integers(0, len(content) - 64)) if trial % 4 else int(rng.integers(0, 400))
            damaged[begin : begin + 16] = rng.integers(0, 256, 16).astype(np.uint8).tobytes()
        target.write_bytes(damaged)
        try:
            with open_bag(original) as bag:
                for _ in bag.messages():
                    pass
        except BadInputError as error:
            errors += 1
            text = str(error)
            assert str(original) in text or str(target) in text
            assert "\n" not in text
    assert errors > 1


def test_wrong_files_are_named(tmp_path: Path) -> None:
    def refuse(path: Path, pattern: str) -> None:
        with pytest.raises(BadInputError, match=pattern):
            open_bag(path)

    refuse(tmp_path / "none.bag", "no such file or folder")
    (tmp_path / "empty.bag").touch()
    refuse(tmp_path / "empty.bag", "is empty")
    (tmp_path / "text.mcap").write_text("not a bag at all")
    refuse(tmp_path / "text.mcap", "is no ROS 1 bag, MCAP file or SQLite bag")
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V1.2\nxxxx")
    refuse(tmp_path / "old.bag", "version 1.2 are not supported")
    (tmp_path / "folder").mkdir()
    refuse(tmp_path / "folder", "no bag in this folder")
    renamed = tmp_path / "renamed.bag"
    shutil.copy(make("mcap file", tmp_path), renamed)
    refuse(renamed, "is a MCAP file by its content; rename it to end in .mcap")
    database = sqlite3.connect(tmp_path / "other.db3")
    database.execute("CREATE TABLE songs (name TEXT)")
    database.close()
    refuse(tmp_path / "other.db3", "missing tables")
    with Writer2(tmp_path / "silent", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=STORE)
    refuse(tmp_path / "silent", "holds no messages")
    (tmp_path / "silent" / "silent.mcap").unlink()
    refuse(tmp_path / "silent", "missing|no bag")


def test_of_several_echoes_the_first_is_a_scan_s_range(tmp_path: Path) -> None:
    """As in the bags of Hokuyo scanners that record up to three echoes of a beam."""
    echo, header = ROS1.types["sensor_msgs/msg/LaserEcho"], ROS1.types["std_msgs/msg/Header"]
    stamp = ROS1.types["builtin_interfaces/msg/Time"](1432647019, 5)
    beams = [np.array(echoes, np.float32) for echoes in ([2.5], [3.0, 7.0, 9.0], [], [4.5, 4.6])]
    kind = "sensor_msgs/msg/MultiEchoLaserScan"
    numbers = (-1.0, 1.0, 0.5, 0.001, 0.025, 0.1, 30.0)
    scan = ROS1.types[kind](
        header(0, stamp, "laser"), *numbers, [echo(b) for b in beams], [echo(b * 10.0) for b in beams]
    )
    with Writer1(tmp_path / "echoes.bag") as writer:
        to = writer.add_connection("/horizontal_laser_2d", kind, typestore=ROS1)
        writer.write(to, 1432647019 * 10**9, bytes(ROS1.serialize_ros1(scan, kind)))
    with open_bag(tmp_path / "echoes.bag") as bag:
        got = next(bag.messages(types=[m.LaserScan])).message
    assert isinstance(got, m.LaserScan)
    assert (got.stamp_ns, got.frame, got.range_max) == (1432647019 * 10**9 + 5, "laser", 30.0)
    np.testing.assert_array_equal(got.ranges, np.array([2.5, 3.0, np.inf, 4.5], np.float32))
    np.testing.assert_array_equal(got.intensities, np.array([25.0, 30.0, 0.0, 45.0], np.float32))
    assert (got.angle_min, got.angle_increment) == (-1.0, 0.5)


def test_the_turtlebot4_recording_on_its_read_only_disk() -> None:
    with open_bag(public("turtlebot4/macfirst_floor_take_2")) as bag:
        counts = {t.name: t.count for t in bag.topics()}
        scans = [g.message for g in bag.messages(types=[m.LaserScan])]
        assert (counts["/scan"], counts["/odom"], len(scans)) == (357, 920, 357)
        assert (bag.end_ns - bag.start_ns) * 1e-9 == pytest.approx(46.2, abs=0.1)
        static = next(bag.messages(["/tf_static"])).message
    assert isinstance(static, m.Transforms)
    mount = next(t for t in static.transforms if t.child == "rplidar_link")
    assert mount.parent == "base_link"
    assert mount.parent_from_child.to_se2().yaw == pytest.approx(math.pi / 2, abs=1e-6)
    assert {len(s.ranges) for s in scans if isinstance(s, m.LaserScan)} == {720}


def test_the_husky_recording_of_ros_1() -> None:
    with open_bag(public("ros1/husky_imu_odom_gps.bag")) as bag:
        counts = {t.name: t.count for t in bag.topics()}
        first = next(bag.messages(types=[m.Imu])).message
    assert counts["/imu/data"] == 11865
    assert counts["/husky_velocity_controller/odom"] == 3952
    assert isinstance(first, m.Imu)
    assert math.hypot(*first.linear_acceleration) == pytest.approx(9.8, abs=0.5)
