"""Bags and the Wean log become the same scans, odometry and mount, whatever the container; what cannot be used is one clear error."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ambler.cli.main import main
from ambler.core import messages as m
from ambler.core.base_motion import STILL, steady_sweep
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.recordings import scan_recording
from ambler.recordings.log_scans import DEAD_ODOMETRY
from ambler.recordings.scan_recording import Choices, ScanRecording
from ambler.recordings.sweep import Sweep
from ambler.slam2d.lag_search import find_lag
from ambler.slam2d.offline import run_offline
from ambler.slam2d.sweep_search import find_sweep
from ambler.wire.ros_messages import encode, ros_type_of
from ambler.wire.ros_types import STORE
from tests.public_data import public

open_recording = partial(scan_recording.open_recording, find_sweep=find_sweep, find_lag=find_lag)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
Recorded = list[tuple[str, m.Message, int]]

BEAMS = 360
SCAN_TIME = 0.1
MOUNT = SE2(0.2, -0.05, math.pi / 2)
WALLS = ((-4.0, 5.0), (-3.0, 2.5))  # a room in the map frame: x and y of its walls


def pose_at(seconds: float) -> SE2:
    """Goes 0.4 m/s straight ahead while looking left and right at up to 1.6 rad/s, so that wrong beam times cannot look right."""
    return SE2(0.4 * seconds, 0.0, 0.8 * math.sin(2.0 * seconds))


def beam_range(pose: SE2, angle: float) -> float:
    dx, dy = math.cos(pose.yaw + angle), math.sin(pose.yaw + angle)
    (x0, x1), (y0, y1) = WALLS
    to_x = ((x1 if dx > 0 else x0) - pose.x) / dx if abs(dx) > 1e-12 else math.inf
    to_y = ((y1 if dy > 0 else y0) - pose.y) / dy if abs(dy) > 1e-12 else math.inf
    return min(to_x, to_y)


def scan_at(seconds: float, mount: SE2 = MOUNT, *, backward: bool = False, frame: str = "laser") -> m.LaserScan:
    """A scan whose beams are taken one after another, in the order of their angles or against it."""
    step, dt = 2 * math.pi / BEAMS, SCAN_TIME / BEAMS
    ranges = np.empty(BEAMS, np.float32)
    for i in range(BEAMS):
        late = (BEAMS - 1 - i if backward else i) * dt
        ranges[i] = beam_range(pose_at(seconds + late) @ mount, -math.pi + i * step)
    stamp_ns = round(seconds * 1e9)
    return m.LaserScan(stamp_ns, frame, -math.pi, step, dt, SCAN_TIME, 0.1, 20.0, ranges, np.zeros(0, np.float32))


def odometry_at(seconds: float) -> m.Odometry:
    zeros = np.zeros((6, 6))
    none = (0.0, 0.0, 0.0)
    pose = SE3.from_se2(SE2(10.0, 0.0, 1.0) @ pose_at(seconds))
    return m.Odometry(round(seconds * 1e9), "odom", "base_link", pose, none, none, zeros, zeros.copy())


def drive(seconds: float = 3.0, *, with_mount: bool = True, slash: str = "", **scan: Any) -> Recorded:
    out: Recorded = []
    edge = m.TransformStamped(0, slash + "base_link", slash + "laser", SE3.from_se2(MOUNT, 0.3))
    if with_mount:
        out.append(("/tf_static", m.Transforms(0, (edge,)), 1))
    for k in range(round(seconds / 0.05)):
        t = 1.0 + 0.05 * k
        log_ns = round(t * 1e9)
        out.append(("/odom", odometry_at(t), log_ns + 30_000_000))
        if k % 2 == 0:
            out.append(("/scan", scan_at(t, frame=slash + "laser", **scan), log_ns + 100_000_000))
    return sorted(out, key=lambda entry: entry[2])


def write_ros2(folder: Path, recorded: Recorded, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
    with Writer2(folder, version=9, storage_plugin=storage) as writer:
        connections: dict[str, Any] = {}
        for topic, message, log_ns in recorded:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, ros_type_of(type(message)), typestore=STORE)
            writer.write(connections[topic], log_ns, encode(message))
    return folder


def write_sqlite(folder: Path, recorded: Recorded) -> Path:
    return write_ros2(folder, recorded, StoragePlugin.SQLITE3)


def write_ros1(folder: Path, recorded: Recorded) -> Path:
    path = folder.with_suffix(".bag")
    with Writer1(path) as writer:
        connections: dict[str, Any] = {}
        for topic, message, log_ns in recorded:
            ros_type = ros_type_of(type(message))
            record = STORE.deserialize_cdr(encode(message), ros_type)
            for stamped in [record, *getattr(record, "transforms", [])]:
                if hasattr(stamped, "header"):
                    time = ROS1.types["builtin_interfaces/msg/Time"](
                        stamped.header.stamp.sec, stamped.header.stamp.nanosec
                    )
                    stamped.header = ROS1.types["std_msgs/msg/Header"](0, time, stamped.header.frame_id)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, ros_type, typestore=ROS1)
            writer.write(connections[topic], log_ns, ROS1.serialize_ros1(record, ros_type))
    return path


def median_error(recording: ScanRecording) -> float:
    """Median distance between the estimated and the true pose, both relative to the first scan."""
    poses = run_offline(recording.scans).poses
    first = pose_at(recording.stamps[0])
    true = [first.inverse() @ pose_at(t) for t in recording.stamps]
    start = SE2.from_array(poses[0])
    errors = [(start.inverse() @ SE2.from_array(p)).distance_to(t) for p, t in zip(poses, true, strict=True)]
    return float(np.median(errors))


@pytest.mark.parametrize("write", [write_ros2, write_sqlite, write_ros1])
def test_every_kind_of_bag_maps_to_the_true_trajectory(write: Callable[[Path, Recorded], Path], tmp_path: Path) -> None:
    slash = "/" if write is write_ros1 else ""
    recording = open_recording(write(tmp_path / "bag", drive(slash=slash)))
    assert len(recording.stamps) == 30
    assert any("90.0 deg in 'base_link'" in note for note in recording.notes)
    assert any("beams in time: forward" in note for note in recording.notes)
    assert median_error(recording) < 0.02


def test_beams_that_run_against_their_promise_are_found_and_turned(tmp_path: Path) -> None:
    bag = write_ros2(tmp_path / "bag", drive(backward=True))
    plain = open_recording(bag, Choices(sweep=Sweep.FORWARD))
    assert find_sweep(tuple(plain.scans))[0] is Sweep.BACKWARD
    found = open_recording(bag)
    assert any("beams in time: backward" in note for note in found.notes)
    assert run_offline(found.scans).points_on_walls_ratio > run_offline(plain.scans).points_on_walls_ratio + 0.004
    assert median_error(found) < 0.02


@pytest.mark.parametrize("backward", [False, True])
def test_scans_that_are_stamped_late_are_found_and_their_odometry_is_moved(backward: bool, tmp_path: Path) -> None:
    """As on a TurtleBot 4, whose scans turn backward and are stamped when their last beam has come."""
    late_ns = 150_000_000
    recorded = [
        (topic, replace(x, stamp_ns=x.stamp_ns + late_ns) if isinstance(x, m.LaserScan) else x, ns)
        for topic, x, ns in drive(8.0, backward=backward)
    ]
    bag = write_ros2(tmp_path / "bag", recorded)
    found, left = open_recording(bag), open_recording(bag, Choices(lag=0.0))
    (note,) = [note for note in found.notes if note.startswith("lag: scans are stamped 0.1")]
    assert float(note.split()[4]) == pytest.approx(0.15, abs=0.011)
    assert any(f"beams in time: {'backward' if backward else 'forward'}" in note for note in found.notes)
    assert any("lag: scans are taken as stamped 0.00 s later" in note for note in left.notes)
    assert not any(note.startswith("lag:") for note in open_recording(write_ros2(tmp_path / "own", drive(8.0))).notes)
    told = open_recording(bag, Choices(lag=float(note.split()[4])))
    for mine, theirs in zip(found.scans, told.scans, strict=True):
        assert mine.odometry == theirs.odometry


def test_without_odometry_the_scans_alone_do(tmp_path: Path) -> None:
    recording = open_recording(write_ros2(tmp_path / "bag", drive()), Choices(odom_topic="none"))
    assert all(scan.odometry == () for scan in recording.scans)
    assert median_error(recording) < 0.1


def test_odometry_that_never_changes_while_the_robot_moves_counts_as_none(tmp_path: Path) -> None:
    """A driver without wheels still publishes: zeros. The same scans without that topic are mapped alike, with the order of the beams asked of them."""
    recorded = with_odometry(lambda _, message: replace(message, pose=SE3()), drive(backward=True))
    dead = open_recording(write_ros2(tmp_path / "dead", recorded))
    none = open_recording(tmp_path / "dead", Choices(odom_topic="none"))
    assert DEAD_ODOMETRY in dead.notes
    assert DEAD_ODOMETRY not in none.notes
    assert any("beams in time: backward" in note for note in dead.notes)
    assert np.array_equal(run_offline(dead.scans).poses, run_offline(none.scans).poses)
    assert DEAD_ODOMETRY not in open_recording(write_ros2(tmp_path / "alive", drive())).notes


def test_transforms_stand_in_for_a_missing_odometry_topic(tmp_path: Path) -> None:
    recorded: Recorded = []
    for topic, message, log_ns in drive():
        if isinstance(message, m.Odometry):
            edge = m.TransformStamped(message.stamp_ns, "odom", "base_link", message.pose)
            recorded.append(("/tf", m.Transforms(message.stamp_ns, (edge,)), log_ns))
        else:
            recorded.append((topic, message, log_ns))
    recording = open_recording(write_ros2(tmp_path / "bag", recorded))
    assert any("transforms odom -> base_link, 60 poses" in note for note in recording.notes)
    assert median_error(recording) < 0.02


def test_a_missing_mount_is_told_and_can_be_given(tmp_path: Path) -> None:
    bag = write_ros2(tmp_path / "bag", drive(with_mount=False))
    assert any("--mount" in note for note in open_recording(bag).notes)
    assert median_error(open_recording(bag, Choices(base_from_laser=MOUNT))) < 0.02


def edge_at(parent: str, child: str, seconds: float, pose: SE3 | None = None, topic: str = "/tf") -> Recorded:
    ns = round(seconds * 1e9)
    return [(topic, m.Transforms(ns, (m.TransformStamped(ns, parent, child, pose or SE3()),)), ns)]


def with_odometry(change: Callable[[int, m.Odometry], m.Odometry], recorded: Recorded | None = None) -> Recorded:
    """Return a drive in which the odometry's messages are changed, by their number."""
    out: Recorded = []
    number = 0
    for topic, message, log_ns in recorded or drive():
        if isinstance(message, m.Odometry):
            out.append((topic, change(number, message), log_ns))
            number += 1
        else:
            out.append((topic, message, log_ns))
    return out


@pytest.mark.parametrize(
    ("edges", "told"),
    [
        ([("base_link", "base_link")], "left out: 1 transforms base_link -> base_link"),
        ([("/laser", "/laser"), ("/laser", "laser")], "left out: 2 transforms laser -> laser"),
        ([("map", "odom"), ("odom", "map"), ("odom", "base_link")], "left out: 1 transforms odom -> map"),
        ([("laser", "base_link")], "left out: 1 transforms laser -> base_link"),
    ],
    ids=["itself", "with a slash", "two frames", "under the scanner"],
)
def test_frames_that_hang_under_themselves_are_left_out(
    edges: list[tuple[str, str]], told: str, tmp_path: Path
) -> None:
    recorded = drive()
    for k, (parent, child) in enumerate(edges):
        recorded += edge_at(parent, child, 1.1 + 0.01 * k)
    recording = open_recording(write_ros2(tmp_path / "bag", sorted(recorded, key=lambda entry: entry[2])))
    assert any(note.startswith(told) for note in recording.notes)
    assert any("90.0 deg in 'base_link'" in note for note in recording.notes)
    assert median_error(recording) < 0.02


@pytest.mark.parametrize(
    "wrong",
    [
        SE3((math.nan, 0.0, 0.0)),
        SE3((0.0, math.inf, 0.0)),
        SE3(rotation=(math.nan, 0.0, 0.0, 0.0)),
        SE3(rotation=(0.0, 0.0, 0.0, 0.0)),
    ],
    ids=["nan", "inf", "nan rotation", "no rotation"],
)
def test_odometry_that_is_no_pose_is_left_out_and_counted(wrong: SE3, tmp_path: Path) -> None:
    recorded = with_odometry(lambda k, o: replace(o, pose=wrong) if k in (0, 20, 21) else o)
    recording = open_recording(write_ros2(tmp_path / "bag", recorded))
    assert any(note.startswith("left out: 3 of 60 messages of /odom that are no pose") for note in recording.notes)
    assert sum(len(scan.odometry) for scan in recording.scans) == 57
    assert median_error(recording) < 0.02


def test_odometry_without_any_pose_leaves_the_scans(tmp_path: Path) -> None:
    recorded = with_odometry(lambda _, o: replace(o, pose=SE3(rotation=(0.0, 0.0, 0.0, 0.0))))
    recording = open_recording(write_ros2(tmp_path / "bag", recorded))
    assert any("left out: 60 of 60" in note for note in recording.notes)
    assert median_error(recording) < 0.1


def test_a_rotation_that_is_not_of_length_one_is_made_so(tmp_path: Path) -> None:
    def longer(_: int, o: m.Odometry) -> m.Odometry:
        w, x, y, z = o.pose.rotation
        return replace(o, pose=SE3(o.pose.translation, (3 * w, 3 * x, 3 * y, 3 * z)))

    plain = open_recording(write_ros2(tmp_path / "plain", drive()))
    long = open_recording(write_ros2(tmp_path / "long", with_odometry(longer)))
    for a, b in zip(plain.scans, long.scans, strict=True):
        assert [p.as_array() for _, p in b.odometry] == [pytest.approx(p.as_array()) for _, p in a.odometry]


def test_transforms_that_are_no_pose_are_left_out(tmp_path: Path) -> None:
    wrong = SE3(rotation=(0.0, 0.0, 0.0, 0.0))
    recorded = edge_at("base_link", "laser", 0.0, wrong, "/tf_static") + drive(with_mount=False)
    notes = open_recording(write_ros2(tmp_path / "bag", recorded)).notes
    assert any(note.startswith("left out: 1 transforms that are no pose") for note in notes)
    assert any("mount: unknown" in note for note in notes)


@pytest.mark.parametrize("base", ["base_link", "base_footprint", "chassis"])
def test_odometry_that_names_no_child_is_that_of_the_base(base: str, tmp_path: Path) -> None:
    recorded = with_odometry(lambda _, o: replace(o, child=""), drive(with_mount=False))
    recorded += edge_at(base, "laser", 0.0, SE3.from_se2(MOUNT, 0.3), "/tf_static")
    if base == "chassis":
        recorded += edge_at("odom", "chassis", 1.0)
    recording = open_recording(write_ros2(tmp_path / "bag", sorted(recorded, key=lambda entry: entry[2])))
    assert any("60 poses that name no frame" in note for note in recording.notes)
    assert any(f"90.0 deg in '{base}'" in note for note in recording.notes)
    assert median_error(recording) < 0.02


@pytest.mark.parametrize("stamp_ns", [0, 17])
def test_scans_of_one_stamp_take_the_time_of_their_recording(stamp_ns: int, tmp_path: Path) -> None:
    recorded: Recorded = [
        (topic, replace(x, stamp_ns=stamp_ns), ns - 100_000_000) if isinstance(x, m.LaserScan) else (topic, x, ns)
        for topic, x, ns in drive()
    ]
    recording = open_recording(write_ros2(tmp_path / "bag", sorted(recorded, key=lambda entry: entry[2])))
    assert any(note.startswith("/scan: all 30 messages bear the stamp") for note in recording.notes)
    assert recording.stamps == pytest.approx(1.0 + 0.1 * np.arange(30))
    assert median_error(recording) < 0.02


def test_messages_before_a_driver_has_a_clock_are_left_out(tmp_path: Path) -> None:
    """They bear a stamp of zero, and 50 years do not lie between them and the next."""
    late_ns = 1_700_000_000 * 10**9

    def at(x: Any, ns: int) -> Any:
        return replace(x, stamp_ns=ns) if hasattr(x, "stamp_ns") else x

    recorded: Recorded = [
        (topic, at(x, 0 if ns < 1_250_000_000 else x.stamp_ns + late_ns), ns + late_ns) for topic, x, ns in drive()
    ]
    assert len(recorded) > len([r for r in recorded if r[1].stamp_ns != 0]) > 0
    recording = open_recording(write_ros2(tmp_path / "bag", recorded))
    whole = open_recording(write_ros2(tmp_path / "whole", drive()))
    of_whole = [1.7e9 + s for s in whole.stamps][-len(recording.stamps) :]
    assert recording.stamps == pytest.approx(of_whole, rel=0.0, abs=1e-6)
    assert 0 < len(whole.stamps) - len(recording.stamps) < 10
    assert any("messages of /scan that bear no stamp" in note for note in recording.notes)
    assert any("messages of /odom that bear no stamp" in note for note in recording.notes)


def test_odometry_of_one_stamp_takes_the_time_of_its_recording(tmp_path: Path) -> None:
    recorded = with_odometry(lambda _, o: replace(o, stamp_ns=0))
    recording = open_recording(write_ros2(tmp_path / "bag", recorded))
    assert any(note.startswith("/odom: all 60 messages bear the stamp 0 s") for note in recording.notes)
    told = [stamp for scan in recording.scans for stamp, _ in scan.odometry]
    assert told[0] == 1_030_000_000


@pytest.mark.parametrize(("reach", "told"), [(0.0, True), (-1.0, True), (math.nan, True), (math.inf, False)])
def test_scans_that_tell_no_range_keep_their_returns(reach: float, told: bool, tmp_path: Path) -> None:
    recorded: Recorded = [
        (topic, replace(x, range_max=reach) if isinstance(x, m.LaserScan) else x, ns) for topic, x, ns in drive()
    ]
    recording = open_recording(write_ros2(tmp_path / "bag", recorded))
    assert any(note.startswith("range_max:") for note in recording.notes) == told
    for scan in recording.scans:
        assert len(scan.to_planar(steady_sweep(STILL, scan.duration)).points) == BEAMS


def test_a_code_for_no_return_is_found_in_scans_that_tell_no_range(tmp_path: Path) -> None:
    recorded: Recorded = []
    for topic, x, ns in drive():
        if isinstance(x, m.LaserScan):
            x = replace(x, range_max=0.0, ranges=np.where(x.ranges < 4.0, x.ranges, np.float32(4.095)))
        recorded.append((topic, x, ns))
    recording = open_recording(write_ros2(tmp_path / "bag", recorded))
    for scan in recording.scans:
        points = scan.to_planar(steady_sweep(STILL, scan.duration)).points
        assert len(points) == np.count_nonzero(scan.ranges < 4.0)


def test_scans_without_angles_are_left_out_and_counted(tmp_path: Path) -> None:
    def without(share: int) -> Recorded:
        wrong, out = ({"angle_increment": 0.0}, {"angle_increment": math.nan}, {"angle_min": math.inf}), []
        for k, (topic, x, ns) in enumerate(drive()):
            is_wrong = isinstance(x, m.LaserScan) and k % share == 0
            out.append((topic, replace(x, **wrong[k % 3]) if is_wrong else x, ns))
        return out

    recorded = without(4)
    scans = sum(isinstance(x, m.LaserScan) for _, x, _ in recorded)
    recording = open_recording(write_ros2(tmp_path / "bag", recorded))
    left = len(list(recording.scans))
    assert 0 < left < scans
    assert f"left out: {scans - left} scans without beams, or that do not tell their angles" in recording.notes
    with pytest.raises(BadInputError, match=rf"none of the {scans} scans of /scan tells the angles"):
        open_recording(write_ros2(tmp_path / "none", without(1)))


def test_an_upside_down_scanner_keeps_its_handedness(tmp_path: Path) -> None:
    turned = SE3.from_rpy((0.2, 0.0, 0.3), math.pi, 0.0, 0.0)
    edge = m.TransformStamped(0, "base_link", "laser", turned)
    scan = m.LaserScan(1, "laser", 0.5, 0.1, 0.0, 0.1, 0.1, 20.0, np.array([2.0], np.float32), np.zeros(0, np.float32))
    bag = write_ros2(tmp_path / "bag", [("/tf_static", m.Transforms(0, (edge,)), 1), ("/scan", scan, 2)])
    (item,) = open_recording(bag).scans
    point = item.to_planar(steady_sweep(STILL, item.duration)).points[0]
    assert point == pytest.approx([0.2 + 2 * math.cos(0.5), -2 * math.sin(0.5)], abs=1e-6)


def test_several_scan_topics_must_be_chosen_from(tmp_path: Path) -> None:
    recorded = [("/rear" if t == "/scan" and k % 4 == 0 else t, x, n) for k, (t, x, n) in enumerate(drive())]
    bag = write_ros2(tmp_path / "bag", recorded)
    with pytest.raises(BadInputError, match=r"--scan-topic: /rear, /scan"):
        open_recording(bag)
    assert len(open_recording(bag, Choices("/rear")).stamps) > 0
    with pytest.raises(BadInputError, match=r"--scan-topic /front: no LaserScan there, only on /rear, /scan"):
        open_recording(bag, Choices("/front"))


def test_the_truth_of_a_simulation_is_no_choice(tmp_path: Path) -> None:
    recorded = drive()
    recorded += [("/ground_truth/pose", x, n) for t, x, n in recorded if t == "/odom"]
    bag = write_ros2(tmp_path / "bag", sorted(recorded, key=lambda entry: entry[2]))
    assert any(note.startswith("odometry: /odom,") for note in open_recording(bag).notes)
    chosen = open_recording(bag, Choices(odom_topic="/ground_truth/pose")).notes
    assert any(note.startswith("odometry: /ground_truth/pose,") for note in chosen)


def write_foreign(path: Path) -> Path:
    path.write_bytes(bytes(range(256)) * 8)
    return path


def write_truncated(path: Path) -> Path:
    bag = write_ros1(path, drive(0.5))
    bag.write_bytes(bag.read_bytes()[:5000])
    return bag


def write_scanless(path: Path) -> Path:
    return write_ros2(path, [x for x in drive(0.5) if x[0] != "/scan"])


def write_broken_scan(path: Path) -> Path:
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=STORE)
        writer.write(connection, 1, encode(scan_at(1.0))[:40])
    return path


@pytest.mark.parametrize(
    ("write", "named"),
    [
        (write_foreign, "line 1"),
        (write_truncated, "is cut off before its first message"),
        (write_scanless, "no topic with laser scans"),
        (write_broken_scan, "on /scan"),
    ],
)
def test_unusable_files_are_one_line_and_leave_nothing(
    write: Callable[[Path], Path], named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "in")
    assert main(["slam2d", str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert named in error
    assert "Traceback" not in error
    assert not (tmp_path / "out").exists()


def test_the_real_turtlebot_sweeps_backward_and_its_returns_lie_on_walls() -> None:
    recording = open_recording(public("turtlebot4/macfirst_floor_take_2"))
    assert any("beams in time: backward" in note for note in recording.notes)
    assert any("lag: scans are stamped 0.1" in note for note in recording.notes)
    assert run_offline(recording.scans).points_on_walls_ratio > 0.957


def test_the_real_wean_log_closes_its_loops() -> None:
    result = run_offline(open_recording(public("cmu_wean/robotdata1.log")).scans)
    assert result.loop_closures >= 1
    assert result.points_on_walls_ratio > 0.9
