"""Folders of clouds as recordings: times, inertial measurements, KITTI's layout, and what is refused."""

from __future__ import annotations

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
