"""Clouds that come in small parts become scans, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from ambler.core.messages import PointCloud
from ambler.recordings.cloud_folder import CloudFolder, open_cloud_folder
from ambler.recordings.cloud_parts import PartJoiner, mean_spacing
from ambler.recordings.cloud_recording import open_cloud_recording
from ambler.recordings.cloud_scan import CloudScan, ScanJoiner
from ambler.wire.ros_messages import encode, ros_type_of
from ambler.wire.ros_types import STORE

START_NS = 1_700_000_000_123_456_789
SECOND = 10**9


def part(begin_ns: int, seconds: float, points: int = 20, *, stamp_ns: int | None = None) -> PointCloud:
    """A cloud whose points tell in x when they were taken, s after the start."""
    stamp_ns = begin_ns if stamp_ns is None else stamp_ns
    late = np.linspace(0.0, seconds, points)
    taken = late + 1e-9 * (begin_ns - START_NS)
    xyz = np.column_stack([taken + 1.0, np.ones((points, 2))]).astype(np.float32)
    time = (late + 1e-9 * (begin_ns - stamp_ns)).astype(np.float32)
    return PointCloud(stamp_ns, "lidar", xyz, xyz[:, 0].copy(), time, np.arange(points, dtype=np.uint16))


def parts(hz: int, seconds: float = 1.0) -> list[PointCloud]:
    step = SECOND // hz
    return [part(START_NS + k * step, 0.999 / hz) for k in range(round(hz * seconds))]


def joined(clouds: list[PointCloud], spacing: float | None = None) -> list[PointCloud]:
    joiner = PartJoiner(spacing)
    return [scan for cloud in clouds for scan in joiner.add(cloud)] + joiner.end()


def assert_times(cloud: PointCloud) -> None:
    """Check that every point still bears the time at which it was taken, and that they are in order."""
    taken = cloud.time + 1e-9 * (cloud.stamp_ns - START_NS)
    np.testing.assert_allclose(taken, cloud.points[:, 0] - 1.0, atol=2e-6)
    assert (np.diff(cloud.time) >= 0.0).all()


@pytest.mark.parametrize("hz", [30, 50, 100, 640, 1000])
def test_parts_become_scans_of_fifty_to_a_hundred_milliseconds(hz: int) -> None:
    scans = joined(parts(hz), 1.0 / hz)
    for scan in scans[:-1]:
        assert 0.045 <= np.ptp(scan.time) <= 0.1
        assert_times(scan)
    assert sum(len(scan.points) for scan in scans) == hz * 20, "each point once"
    np.testing.assert_array_equal(np.concatenate([s.ring for s in scans]), np.concatenate([p.ring for p in parts(hz)]))


@pytest.mark.parametrize("hz", [5, 10, 20])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.999])
def test_ordinary_clouds_go_through_at_once_and_unchanged(hz: int, share: float) -> None:
    """Also those without times, and those of a LiDAR that sees all at once: nobody waits for the next."""
    clouds = [part(START_NS + k * SECOND // hz, share / hz) for k in range(40)]
    for spacing in (None, 1.0 / hz):
        joiner = PartJoiner(spacing)
        for cloud in clouds:
            assert [id(out) for out in joiner.add(cloud)] == [id(cloud)]


def test_a_dozen_spacings_show_that_clouds_are_parts() -> None:
    """A robot is told by nobody how often its clouds come."""
    sizes = [len(scan.points) // 20 for scan in joined(parts(100))]
    assert sizes == [1] * 12 + [5] * 17 + [3]


@pytest.mark.parametrize("step", [0.06, 1.0, -0.06])
def test_parts_are_not_joined_over_what_is_missing_or_told_twice(step: float) -> None:
    """A stretch of 60 ms without points, or one that begins before the last has ended."""
    before = parts(100, 0.23)
    clouds = [*before, *(part(START_NS + round((0.23 + step + 0.01 * k) * SECOND), 0.00999, stamp_ns=START_NS + round((0.23 + 0.01 * k) * SECOND)) for k in range(20))]  # fmt: skip
    scans = joined(clouds, 0.01)
    assert all(np.ptp(scan.time) <= 0.1 for scan in scans)
    assert [len(scan.points) // 20 for scan in scans][4:6] == [3, 5]


def test_parts_of_two_frames_are_not_one_scan() -> None:
    one, other = parts(100)[:2]
    assert len(joined([one, PointCloud(other.stamp_ns, "rear", other.points, other.intensity, other.time, other.ring)], 0.01)) == 2  # fmt: skip


def test_a_stamp_at_the_end_of_the_part_is_one_like_all() -> None:
    clouds = [part(START_NS + k * 10_000_000, 0.00999, stamp_ns=START_NS + (k + 1) * 10_000_000) for k in range(20)]
    for scan in joined(clouds, 0.01):
        assert_times(scan)
        assert np.ptp(scan.time) == pytest.approx(0.05, abs=1e-3)


def test_what_comes_now_and_then_less_often_is_in_parts_all_the_same() -> None:
    stamps_ns = [10_000_000 * k + (0 if k < 7 else 5 * SECOND) for k in range(13)]
    assert mean_spacing(stamps_ns) == pytest.approx((11 * 0.01 + 0.1) / 12)
    assert mean_spacing([5]) is None
    assert mean_spacing([5, 5]) is None


def test_a_robot_does_not_keep_the_parts_before_an_outage() -> None:
    from ambler.core.messages import Imu

    joiner, scans = ScanJoiner(waits_for_odometry=False, has_outages=True, spacing=0.01), list[CloudScan]()
    for cloud in parts(100, 0.12):
        joiner.add(cloud)
    for k in range(120):
        joiner.add(Imu(START_NS + k * SECOND // 10, "imu", (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)))
        scans += joiner.ready()
    assert [len(scan.cloud.points) // 20 for scan in scans][:3] == [5, 5, 2]


def test_a_recording_of_parts_is_one_of_scans_and_says_so(tmp_path: Path) -> None:
    with Writer2(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/points", ros_type_of(PointCloud), typestore=STORE)
        for cloud in parts(100):
            writer.write(topic, cloud.stamp_ns + 10_000_000, encode(cloud))
    recording = open_cloud_recording(tmp_path / "bag")
    assert recording.notes[1] == "clouds come in parts, 100 in a second: each 5 are joined into a scan"
    scans = list(recording.scans())
    assert len(scans) == recording.clouds == 20
    for scan in scans:
        assert_times(scan.cloud)
        assert scan.end_ns - scan.cloud.stamp_ns == pytest.approx(5e7, abs=1e5)


def test_a_folder_of_parts_is_one_of_scans_and_says_so(tmp_path: Path) -> None:
    for k in range(40):
        np.tile(np.array([1.0 + k, 1.0, 1.0, 0.5], np.float32), (20, 1)).tofile(tmp_path / f"{k}.bin")
    (tmp_path / "times.txt").write_text("".join(f"{1000 + 0.01 * k:.6f}\n" for k in range(40)))
    folder: CloudFolder = open_cloud_folder(tmp_path)
    assert folder.notes[1] == "clouds come in parts, 100 in a second: each 5 are joined into a scan"
    scans = list(folder.scans())
    assert folder.clouds == 8
    assert len(scans) in (7, 8)
    assert [x for scan in scans for x in scan.cloud.points[::20, 0]] == [1.0 + k for k in range(40)]
