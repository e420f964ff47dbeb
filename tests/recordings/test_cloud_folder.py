"""Folders of clouds as recordings: times, inertial measurements, KITTI's layout, and what is refused."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.recordings.cloud_folder import open_cloud_folder
from ambler.wire.cloud_files import write_cloud

POINTS = np.ones((10, 3), np.float32)


def folder_of(path: Path, names: list[str], times: list[float] | None = None) -> Path:
    path.mkdir(parents=True, exist_ok=True)
    for name in names:
        write_cloud(path / name, POINTS)
    if times is not None:
        (path / "times.txt").write_text("\n".join(str(t) for t in times))
    return path


def test_numbers_in_names_count_as_numbers_and_imu_comes_with_its_cloud(tmp_path: Path) -> None:
    path = folder_of(tmp_path, ["full10.pcd", "full2.pcd", "full1.pcd"], [1.0, 1.1, 1.2])
    rows = [f"{0.9 + 0.02 * k:.2f} 0 0 9.8 0.1 0.2 0.3" for k in range(30)]
    (tmp_path / "imu.txt").write_text("\n".join(rows))
    recording = open_cloud_folder(path)
    assert [f.name for f in recording.files] == ["full1.pcd", "full2.pcd", "full10.pcd"]
    scans = list(recording.scans())
    assert [s.cloud.stamp_ns for s in scans] == [1_000_000_000, 1_100_000_000, 1_200_000_000]
    assert scans[0].imu[0].angular_velocity == (0.1, 0.2, 0.3)
    assert scans[0].imu[0].linear_acceleration == (0.0, 0.0, 9.8)
    stamps = [i.stamp_ns for s in scans for i in s.imu]
    assert stamps == sorted(set(stamps))
    for scan in scans:
        assert scan.imu[-1].stamp_ns >= scan.end_ns > scan.imu[0].stamp_ns - 100_000_000


def test_a_header_names_the_columns(tmp_path: Path) -> None:
    folder_of(tmp_path, ["1.pcd"], [1.0])
    (tmp_path / "imu.csv").write_text("t,ax,ay,az,wx,wy,wz\n0.99,1,2,3,4,5,6\n1.01,1,2,3,4,5,6\n")
    sample = open_cloud_folder(tmp_path).imu[0]
    assert sample.angular_velocity == (4.0, 5.0, 6.0)


def test_kitti_s_folders_and_times_in_names(tmp_path: Path) -> None:
    velodyne = tmp_path / "kitti" / "velodyne"
    velodyne.mkdir(parents=True)
    for k in range(2):
        np.ones((5, 4), "<f4").tofile(velodyne / f"{k:06d}.bin")
    (tmp_path / "kitti" / "times.txt").write_text("0.0\n1.035e-01\n")
    assert open_cloud_folder(tmp_path / "kitti").stamps_ns == (0, 103_500_000)
    named = folder_of(tmp_path / "named", ["1630577758.569490.pcd", "1630577759.068947.pcd"])
    assert open_cloud_folder(named).stamps_ns == (1630577758_569490000, 1630577759_068947000)


@pytest.mark.parametrize(
    ("names", "times", "text"),
    [
        ([], None, "neither a bag nor clouds"),
        (["a.pcd", "b.pcd"], None, "no times"),
        (["a.pcd", "b.pcd"], [1.0], "1 times for 2 clouds"),
        (["a.pcd", "b.pcd", "c.pcd"], [1.0, 3.0, 2.0], "backwards or stands still from b.pcd to c.pcd"),
        (["a.pcd"], [float("nan")], "not finite"),
    ],
)
def test_what_is_missing_is_named(tmp_path: Path, names: list[str], times: list[float] | None, text: str) -> None:
    folder_of(tmp_path, names, times)
    with pytest.raises(BadInputError, match=text):
        open_cloud_folder(tmp_path)


@pytest.mark.parametrize("rows", ["1 2 3\n", "1 2 3 4 5 6 x\n", ""])
def test_bad_inertial_files_are_named(tmp_path: Path, rows: str) -> None:
    folder_of(tmp_path, ["a.pcd"], [1.0])
    (tmp_path / "imu.txt").write_text(rows)
    with pytest.raises(BadInputError, match=r"imu.txt: rows must have seven numbers"):
        open_cloud_folder(tmp_path)


def test_dates_and_nanoseconds_are_times_and_numbers_of_files_are_none(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, ["0000000000.pcd", "0000000001.pcd"])
    with pytest.raises(BadInputError, match="no times for the clouds"):
        open_cloud_folder(folder)
    (folder / "timestamps.txt").write_text("2011-09-26 13:02:25.594360375\n2011-09-26 13:02:25.697866039\n")
    (folder / "imu.csv").write_text(
        "#timestamp [ns],w,w,w,a,a,a\n1317042145594360375,0,0,0.1,0,0,9.8\n1317042145599360375,0,0,0.1,0,0,9.8\n"
    )
    found = open_cloud_folder(folder)
    assert found.stamps_ns == (1317042145594360375, 1317042145697866039)
    assert found.imu[0].stamp_ns == 1317042145594360375
    assert found.imu[0].linear_acceleration == (0.0, 0.0, 9.8)


STAMPS = tuple(1583836591_182590976 + 100_000_000 * k for k in range(3))
SAID = {
    "ns": "{ns}",
    "us": "{us}",
    "number and seconds": "{k} {s}.{rest:09d}",
    "seconds and nanoseconds": "{s},{rest}",
    "ns and file": "{ns},{k}.pcd",
}


@pytest.mark.parametrize("form", SAID)
def test_lists_of_times_go_by_many_forms(form: str, tmp_path: Path) -> None:
    """Nanoseconds had overflowed, and the number of a cloud before its time was taken for its second."""
    folder = folder_of(tmp_path, ["0.pcd", "1.pcd", "2.pcd"])
    lines = [
        SAID[form].format(k=k, ns=ns, us=ns // 1000, s=ns // 10**9, rest=ns % 10**9) for k, ns in enumerate(STAMPS)
    ]
    (folder / "times.txt").write_text("\n".join(["timestamp,file", *lines]))
    exact = 1000 if form == "us" else 1
    assert open_cloud_folder(folder).stamps_ns == tuple(ns // exact * exact for ns in STAMPS)


def test_seconds_and_nanoseconds_in_names_are_times(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, [f"cloud_{ns // 10**9}_{ns % 10**9}.pcd" for ns in STAMPS])
    assert open_cloud_folder(folder).stamps_ns == STAMPS


@pytest.mark.parametrize(
    ("unit", "begin", "spacing"),
    [
        *((unit, begin, 0.1) for unit in (1, 1000, 10**6, 10**9) for begin in (0.0, 5000.0, 1.7e9)),
        (1, 0.0, 10.0),
        (1, 1.7e9, 60.0),
        (1000, 0.0, 0.05),
        (10**9, 0.0, 0.5),
    ],
)
def test_the_unit_of_a_list_is_told_by_how_clouds_follow_each_other(
    unit: int, begin: float, spacing: float, tmp_path: Path
) -> None:
    """Whole nanoseconds from 0 on had been taken for seconds or milliseconds."""
    count = 30
    names = [f"{k:03d}.pcd" for k in range(count)]
    told = [Decimal(str(begin)) + Decimal(str(spacing)) * k for k in range(count)]
    folder_of(tmp_path, names)
    (tmp_path / "times.txt").write_text("\n".join(format((t * unit).normalize(), "f") for t in told))
    assert open_cloud_folder(tmp_path).stamps_ns == tuple(int(t * 10**9) for t in told)


@pytest.mark.parametrize("unit", [1, 1000, 10**6, 10**9])
@pytest.mark.parametrize("begin", [0.0, 1.7e9])
def test_the_unit_of_inertial_times_is_told_by_how_they_follow_each_other(
    unit: int, begin: float, tmp_path: Path
) -> None:
    folder_of(tmp_path, ["0.pcd", "1.pcd"], [begin, begin + 0.1])
    told = [Decimal(str(begin)) + Decimal("0.005") * k for k in range(40)]
    rows = (f"{format((t * unit).normalize(), 'f')} 0 0 0.1 0 0 9.8" for t in told)
    (tmp_path / "imu.txt").write_text("\n".join(rows))
    assert [i.stamp_ns for i in open_cloud_folder(tmp_path).imu] == [int(t * 10**9) for t in told]


def kitti_drive(path: Path, rate: float) -> Path:
    """Write a raw drive of three scans, each of eight points all around, with inertial measurements at a rate (Hz)."""
    scans, oxts = path / "velodyne_points", path / "oxts"
    (scans / "data").mkdir(parents=True)
    (oxts / "data").mkdir(parents=True)
    azimuth = np.radians([179.0, 90.0, 0.0, -90.0, -179.0])
    points = np.stack((5.0 * np.cos(azimuth), 5.0 * np.sin(azimuth), 0.0 * azimuth, 0.3 + 0.0 * azimuth), axis=1)

    def dates(seconds: np.ndarray) -> str:
        return "\n".join(f"2011-09-26 13:02:{25.0 + t:012.9f}" for t in seconds) + "\n"

    middle = 0.05 + 0.1 * np.arange(3)
    for name, late in (("timestamps", 0.0), ("timestamps_start", -0.05), ("timestamps_end", 0.05)):
        (scans / f"{name}.txt").write_text(dates(middle + late))
    for k in range(3):
        points.astype("<f4").tofile(scans / "data" / f"{k:010d}.bin")
    times = np.arange(0.0, 0.3, 1.0 / rate)
    (oxts / "timestamps.txt").write_text(dates(times))
    for k in range(len(times)):
        row = np.zeros(30)
        row[11:14], row[17:20] = (0.1, 0.2, 9.8), (0.01, 0.02, 0.03)
        row[14:17], row[20:23] = 7.0, 7.0  # the same in the vehicle's level frame
        (oxts / "data" / f"{k:010d}.txt").write_text(" ".join(str(v) for v in row))
    (path.parent / "calib_imu_to_velo.txt").write_text(
        "calib_time: 25-May-2012 16:47:16\nR: 0 1 0 -1 0 0 0 0 1\nT: -8.086759e-01 3.195559e-01 -7.997231e-01\n"
    )
    return path


def test_a_kitti_drive_has_its_inertial_measurements_its_mount_and_its_sweeps(tmp_path: Path) -> None:
    recording = open_cloud_folder(kitti_drive(tmp_path / "drive_0001", 100.0))
    assert len(recording.imu) == 30
    assert recording.imu[0].linear_acceleration == (0.1, 0.2, 9.8)
    assert recording.imu[0].angular_velocity == (0.01, 0.02, 0.03)
    mount = recording.lidar_from_imu
    assert mount is not None
    np.testing.assert_allclose(
        mount.transform(np.array([[1.0, 2.0, 3.0]]))[0], [2.0 - 0.8086759, -1.0 + 0.3195559, 3.0 - 0.7997231]
    )
    scans = list(recording.scans())
    assert np.diff([s.cloud.stamp_ns for s in scans]).tolist() == [100_000_000] * 2
    assert scans[0].cloud.stamp_ns == recording.imu[0].stamp_ns
    for scan in scans:  # clockwise from behind
        np.testing.assert_allclose(scan.cloud.time, [0.1 * f for f in (1 / 360, 0.25, 0.5, 0.75, 359 / 360)], atol=1e-6)
        np.testing.assert_allclose(scan.cloud.points[1:3], [[0.0, 5.0, 0.0], [5.0, 0.0, 0.0]], atol=1e-5)


def test_a_kitti_drive_that_is_not_synchronized_has_its_points_as_text(tmp_path: Path) -> None:
    drive = kitti_drive(tmp_path / "drive_0001", 100.0)
    expected = [s.cloud for s in open_cloud_folder(drive).scans()]
    for file in (drive / "velodyne_points" / "data").iterdir():
        np.savetxt(file.with_suffix(".txt"), np.fromfile(file, "<f4").reshape(-1, 4), "%.6f")
        file.unlink()
    for cloud, as_text in zip(expected, open_cloud_folder(drive).scans(), strict=True):
        np.testing.assert_allclose(as_text.cloud.points, cloud.points, atol=1e-5)
        np.testing.assert_allclose(as_text.cloud.intensity, cloud.intensity, atol=1e-5)
        np.testing.assert_allclose(as_text.cloud.time, cloud.time, atol=1e-6)
        assert as_text.cloud.stamp_ns == cloud.stamp_ns


def test_text_beside_clouds_is_no_cloud(tmp_path: Path) -> None:
    folder_of(tmp_path, ["000000.pcd"], [0.0])
    (tmp_path / "000000.txt").write_text("1 2 3 4\n")
    assert [f.name for f in open_cloud_folder(tmp_path).files] == ["000000.pcd"]


def test_a_synchronized_kitti_drive_is_one_without_inertial_measurements(tmp_path: Path) -> None:
    recording = open_cloud_folder(kitti_drive(tmp_path / "drive_0001", 10.0))
    assert recording.imu_topic is None
    assert "0.1 s apart" in recording.notes[1]


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("oxts/timestamps.txt", "2011-09-26 13:02:25.0\n", "1 times for 30 measurements"),
        ("oxts/data/0000000003.txt", "1 2 3", "not 3"),
        ("oxts/data/0000000003.txt", "a b c", "is no measurement"),
        ("../calib_imu_to_velo.txt", "R: 1 0 0 0 1 0 0 0 2\nT: 0 0 0\n", "no rotation"),
        ("../calib_imu_to_velo.txt", "T: 0 0 0\n", "no rotation R"),
        ("velodyne_points/timestamps_end.txt", "2011-09-26 13:02:20.0\n" * 3, "must end after they begin"),
    ],
)
def test_a_broken_kitti_drive_says_what_is_wrong(name: str, text: str, why: str, tmp_path: Path) -> None:
    drive = kitti_drive(tmp_path / "drive_0001", 100.0)
    (drive / name).write_text(text)
    with pytest.raises(BadInputError, match=why):
        open_cloud_folder(drive)
