"""Recordings: read back exactly, readable by other people's readers, deterministic, and useful after a crash."""

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader

from ambler.bridges.recorder import Recorder
from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.core.grid import GridSpec
from ambler.core.se3 import SE3
from ambler.runtime import topics
from ambler.wire.mcap_file import McapRecorder
from ambler.wire.mcap_reader import is_finished, read_recording, recover_recording
from ambler.wire.ros_messages import encode
from ambler.wire.ros_types import STORE

SECONDS = 5


def traffic(seconds=SECONDS):
    """Yield (topic, message, time_ns) of a small robot: scan and map, odometry and transforms, gate, truth."""
    rng = np.random.default_rng(3)
    tree = m.Transforms(0, (m.TransformStamped(0, "base", "scan", SE3((0.2, 0.0, 0.3))),))
    yield topics.STATIC_TRANSFORMS, tree, 1_000
    yield topics.GATE_STATUS, m.GateStatus(0, m.GateState.ARMED, "", "navigation"), 1_000
    for k in range(seconds * 20):
        now = k * 50_000_000
        pose = SE3((0.01 * k, 0.0, 0.0))
        zero = (0.0, 0.0, 0.0)
        yield topics.ODOMETRY, m.Odometry(now, "odom", "base", pose, zero, zero, np.eye(6), np.eye(6)), now + 1_000
        yield (
            topics.TRANSFORMS,
            m.Transforms(now, (m.TransformStamped(now, "odom", "base", pose),)),
            now + 1_000,
        )
        if k % 2 == 0:
            ranges = rng.uniform(0.1, 9.0, 60).astype(np.float32)
            none = np.empty(0, np.float32)
            yield topics.SCAN, m.LaserScan(now, "scan", -1.0, 0.03, 0.0, 0.1, 0.1, 10.0, ranges, none), now + 2_000
        if k % 20 == 0:
            data = rng.integers(-1, 101, (30, 40)).astype(np.int8)
            yield topics.MAP, m.OccupancyGrid(now, "map", GridSpec(0.05, 40, 30, -1.0, -1.0), data), now + 3_000
            yield topics.TRUE_MAP, m.OccupancyGrid(now, "map", GridSpec(0.05, 40, 30, -1.0, -1.0), data), now + 3_000


def record(folder, seconds=SECONDS):
    recorder = Recorder(folder)
    for item in traffic(seconds):
        recorder.on_message(*item)
    recorder.close()
    return folder


def test_a_recording_gives_back_every_message_in_order_bit_by_bit(tmp_path):
    sent = list(traffic())
    got = list(read_recording(record(tmp_path / "run")))
    assert len(got) == len(sent)
    for (topic, message, time_ns), recorded in zip(sent, got, strict=True):
        assert recorded.topic == topic.ros_name
        assert recorded.log_time_ns == time_ns
        assert recorded.data == encode(message)
        assert recorded.is_latched == (topic.delivery == "latched")
        assert encode(recorded.decode_as(topic.type)) == recorded.data
    only = list(read_recording(tmp_path / "run", ["/scan", "/map"]))
    assert {r.topic for r in only} == {"/scan", "/map"}
    assert len(only) == SECONDS * 11


def test_every_message_of_tf_puts_the_robot_on_the_map(tmp_path):
    """A viewer that jumps restores the last message of /tf only; SLAM and odometry each write their own edge."""
    recorder = Recorder(tmp_path / "run")
    for k in range(10):
        writer, parent, child = ("slam", "map", "odom") if k % 5 == 0 else ("odometry", "odom", "base")
        edge = m.TransformStamped(k, parent, child, SE3((float(k), 0.0, 0.0)))
        recorder.on_message(topics.TRANSFORMS, m.Transforms(k, (edge,)), k, writer)
    recorder.close()
    recorded = list(read_recording(tmp_path / "run"))
    assert [r.writer for r in recorded] == ["slam", *["odometry"] * 4] * 2
    edges = [{e.child: e.stamp_ns for e in r.decode_as(m.Transforms).transforms} for r in recorded]
    assert edges[1:] == [{"odom": 5 * (k // 5), "base": k if k % 5 else k - 1} for k in range(1, 10)]


def test_the_same_messages_give_the_same_bytes(tmp_path):
    a, b = record(tmp_path / "a"), record(tmp_path / "b")
    for name in ("recording_0.mcap", "metadata.yaml"):
        assert (a / name).read_bytes() == (b / name).read_bytes()


def read_elsewhere(folder, topic):
    """Return the messages of a topic as mcap-ros2-support decodes them from the schemas in the file."""
    with (folder / "recording_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [decoded.decoded_message for decoded in reader.iter_decoded_messages([topic])]


def test_mcap_ros2_support_reads_it(tmp_path):
    folder = record(tmp_path / "run")
    scans = read_elsewhere(folder, "/scan")
    wanted = [message for topic, message, _ in traffic() if topic is topics.SCAN]
    assert len(scans) == len(wanted)
    for decoded, message in zip(scans, wanted, strict=True):
        assert decoded.header.frame_id == "scan"
        assert np.array_equal(np.array(decoded.ranges, np.float32), message.ranges)
    gates = read_elsewhere(folder, "/gate_status")
    assert [(g.state, g.source) for g in gates] == [(1, "navigation")]


def test_rosbags_reads_the_folder_with_its_qos(tmp_path):
    folder = record(tmp_path / "run")
    with Reader(folder) as reader:
        assert reader.message_count == len(list(traffic()))
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
        assert durability["/map"] == durability["/tf_static"] == "TRANSIENT_LOCAL"
        assert durability["/scan"] == "VOLATILE"
        maps = [c for c in reader.connections if c.topic == "/ground_truth/map"]
        grids = [STORE.deserialize_cdr(raw, c.msgtype) for c, _, raw in reader.messages(maps)]
    wanted = [message for topic, message, _ in traffic() if topic is topics.TRUE_MAP]
    assert [g.data.tobytes() for g in grids] == [w.data.tobytes() for w in wanted]
    information = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["duration"]["nanoseconds"] == 4_950_001_000 - 1_000


def test_a_crash_loses_at_most_the_last_second(tmp_path):
    recorder = Recorder(tmp_path / "run")
    sent = list(traffic())
    for item in sent:
        recorder.on_message(*item)
    recorder.flush()
    file = tmp_path / "run" / "recording_0.mcap"  # the process dies here: nothing is closed
    assert not is_finished(file)
    got = list(read_recording(tmp_path / "run"))
    assert [(r.topic, r.log_time_ns) for r in got] == [(t.ros_name, ns) for t, _, ns in sent[: len(got)]]
    flushed = [k for k, item in enumerate(sent) if item[2] <= sent[-1][2] - 1_000_000_000]
    assert 0 < len(got) < len(sent)
    assert len(got) >= len(flushed)
    count = recover_recording(tmp_path / "run", tmp_path / "recovered")
    assert count == len(got)
    with Reader(tmp_path / "recovered") as reader:
        assert reader.message_count == count
    assert [r.data for r in read_recording(tmp_path / "recovered")] == [r.data for r in got]
    recorder.close()


@pytest.mark.parametrize("share", [0.02, 0.3, 0.5, 0.77, 0.95, 0.999])
def test_a_file_cut_anywhere_gives_what_lies_before_the_cut(tmp_path, share):
    whole = record(tmp_path / "run") / "recording_0.mcap"
    everything = list(read_recording(whole))
    raw = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(raw[: int(share * len(raw))])
    got = list(read_recording(cut))
    assert got == everything[: len(got)]
    if share >= 0.5:
        assert len(got) >= len(everything) // 4


def test_damage_inside_a_finished_file_is_named_and_never_read_as_something_else(tmp_path):
    file = record(tmp_path / "run", 1) / "recording_0.mcap"
    whole, raw = list(read_recording(file)), file.read_bytes()
    named = 0
    for position in range(0, len(raw), 149):
        damaged = bytearray(raw)
        damaged[position] ^= 0xFF
        file.write_bytes(damaged)
        try:
            assert list(read_recording(file)) == whole  # the byte did not matter: an index, a library name
        except BadInputError as error:
            named += str(error).startswith(str(file))
    assert named > len(raw) // 149 // 3


def test_wrong_paths_get_one_clear_line(tmp_path):
    with pytest.raises(BadInputError, match="holds no recording"):
        list(read_recording(tmp_path))
    (tmp_path / "photo.mcap").write_bytes(b"not at all")
    with pytest.raises(BadInputError, match="is no MCAP file"):
        list(read_recording(tmp_path / "photo.mcap"))
    record(tmp_path / "run", 1)
    with pytest.raises(BadInputError, match="already holds a recording"):
        Recorder(tmp_path / "run")
    (tmp_path / "run" / "recording_0.mcap").unlink()
    with pytest.raises(BadInputError, match=r"recording_0\.mcap is missing"):
        list(read_recording(tmp_path / "run"))


def test_long_recordings_continue_in_a_new_file(tmp_path):
    recorder = McapRecorder(tmp_path / "run", file_bytes=20_000)
    sent = list(traffic())
    for topic, message, time_ns in sent:
        recorder.write(topic.ros_name, message, time_ns)
    recorder.close()
    assert len(list((tmp_path / "run").glob("*.mcap"))) > 2
    assert [r.data for r in read_recording(tmp_path / "run")] == [encode(message) for _, message, _ in sent]
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == len(sent)
    with pytest.raises(BadInputError, match="closed"):
        recorder.write("/scan", sent[0][1], 0)


def test_writers_of_one_topic_are_told_apart(tmp_path):
    recorder = Recorder(tmp_path / "run")
    for k in range(6):
        tree = m.Transforms(k, (m.TransformStamped(k, "odom", "base", SE3()),))
        recorder.on_message(topics.TRANSFORMS, tree, k, "base" if k % 2 else "slam2d")
    recorder.close()
    assert [r.writer for r in read_recording(tmp_path / "run")] == ["slam2d", "base"] * 3
    with Reader(tmp_path / "run") as reader:
        assert [(time_ns, c.topic) for c, time_ns, _ in reader.messages()] == [(k, "/tf") for k in range(6)]


def test_a_topic_keeps_its_type(tmp_path):
    recorder = McapRecorder(tmp_path / "run")
    recorder.write("/x", m.VelocityCommand(0), 0)
    with pytest.raises(BadInputError, match="/x is recorded as geometry_msgs/msg/TwistStamped"):
        recorder.write("/x", m.PointStamped(0, "map", (0.0, 0.0, 0.0)), 1)
    recorder.close()
