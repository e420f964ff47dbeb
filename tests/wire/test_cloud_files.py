"""Clouds in PCD, PLY and BIN files: round trips, the variants of others, and one clear error for what is broken."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.wire.cloud_files import read_cloud, write_cloud

POINTS = np.random.default_rng(0).normal(0.0, 10.0, (50, 3)).astype(np.float32)
BRIGHT = np.linspace(0.0, 1.0, 50).astype(np.float32)


def xyz(path: Path) -> np.ndarray:
    table = read_cloud(path)
    return np.stack([table[a] for a in "xyz"], axis=1)


@pytest.mark.parametrize("name", ["cloud.pcd", "cloud.ply"])
def test_what_is_written_is_read(tmp_path: Path, name: str) -> None:
    write_cloud(tmp_path / name, POINTS, BRIGHT)
    np.testing.assert_array_equal(xyz(tmp_path / name), POINTS)
    np.testing.assert_array_equal(read_cloud(tmp_path / name)["intensity"], BRIGHT)
    packed = tmp_path / (name + ".gz")
    packed.write_bytes(gzip.compress((tmp_path / name).read_bytes()))
    np.testing.assert_array_equal(xyz(packed), POINTS)


def test_kitti_s_layout_is_read(tmp_path: Path) -> None:
    file = tmp_path / "000000.bin"
    np.column_stack([POINTS, BRIGHT]).astype("<f4").tofile(file)
    np.testing.assert_array_equal(xyz(file), POINTS)


def test_text_is_read(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(str(v) for v in p) for p in POINTS.tolist())
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 50\nHEIGHT 1\nPOINTS 50\nDATA ascii\n"
    (tmp_path / "a.pcd").write_text(head + rows)
    head = (
        "ply\nformat ascii 1.0\nelement vertex 50\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    (tmp_path / "a.ply").write_text(head + rows)
    for name in ("a.pcd", "a.ply"):
        np.testing.assert_allclose(xyz(tmp_path / name), POINTS, rtol=1e-6)


def test_compressed_points_are_read(tmp_path: Path) -> None:
    body = np.concatenate([POINTS[:, j] for j in range(3)]).astype("<f4").tobytes()
    literals = b"".join(bytes([len(c) - 1]) + c for c in (body[i : i + 32] for i in range(0, len(body), 32)))
    head = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 50\nHEIGHT 1\nPOINTS 50\nDATA binary_compressed\n"
    (tmp_path / "c.pcd").write_bytes(head.encode() + struct.pack("<II", len(literals), len(body)) + literals)
    np.testing.assert_array_equal(xyz(tmp_path / "c.pcd"), POINTS)
    zeros = np.zeros((50, 3), np.float32)
    run = bytes([0, 0]) + bytes([0xE0, 255, 0]) + bytes([0xE0, 255, 0]) + bytes([0xE0, 600 - 1 - 2 * 264 - 9, 0])
    (tmp_path / "r.pcd").write_bytes(head.encode() + struct.pack("<II", len(run), 600) + run)
    np.testing.assert_array_equal(xyz(tmp_path / "r.pcd"), zeros)


@pytest.mark.parametrize("name", ["cloud.pcd", "cloud.ply"])
@pytest.mark.parametrize("keep", [0, 20, 150, -7])
def test_a_file_that_is_cut_off_is_named(tmp_path: Path, name: str, keep: int) -> None:
    write_cloud(tmp_path / name, POINTS)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[:keep])
    with pytest.raises(BadInputError, match=f"{name}: is no cloud, or cut off"):
        read_cloud(tmp_path / name)


def test_what_is_no_cloud_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"x" * 17)
    (tmp_path / "a.pcd.gz").write_bytes(b"no gzip at all")
    (tmp_path / "a.xyz").write_text("1 2 3")
    head = "FIELDS u v w\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 0\nHEIGHT 1\nPOINTS 0\nDATA binary\n"
    (tmp_path / "b.pcd").write_text(head)
    for name, text in {"a.bin": "no multiple", "a.pcd.gz": "gzip", "a.xyz": "only", "b.pcd": "no column x", "c.ply": "No such"}.items():  # fmt: skip
        with pytest.raises(BadInputError, match=text):
            read_cloud(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "head"),
    [
        (
            "a.pcd",
            "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 0\nHEIGHT 1\nPOINTS 0\nDATA ascii\n",
        ),
        (
            "a.ply",
            "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        ),
    ],
)
def test_an_empty_text_cloud_has_no_points(tmp_path: Path, name: str, head: str) -> None:
    (tmp_path / name).write_text(head)
    assert xyz(tmp_path / name).shape == (0, 3)


@pytest.mark.parametrize("columns", [4, 5, 6])
def test_a_bin_may_tell_rings_and_times_behind_the_reflectance(columns: int, tmp_path: Path) -> None:
    """120 rows of any of them have a length that is a multiple of the others' too."""
    rng = np.random.default_rng(columns)
    table = np.column_stack((rng.normal(size=(120, 4)), np.arange(120) % 32, np.linspace(0.0, 0.1, 120))).astype("<f4")
    table[:, :columns].tofile(tmp_path / "a.bin")
    read = read_cloud(tmp_path / "a.bin")
    assert read.dtype.names == ("x", "y", "z", "intensity", "ring", "time")[:columns]
    for k, name in enumerate(read.dtype.names):
        np.testing.assert_array_equal(read[name], table[:, k])


def test_a_bin_of_whole_numbers_stays_one_of_four_columns(tmp_path: Path) -> None:
    np.ones((30, 4), "<f4").tofile(tmp_path / "a.bin")
    assert len(read_cloud(tmp_path / "a.bin")) == 30


def test_a_line_of_text_is_a_point(tmp_path: Path) -> None:
    (tmp_path / "1.txt").write_text("1.5 2 -3 0.25\n4 5 6 0\n")
    table = read_cloud(tmp_path / "1.txt")
    assert [tuple(row) for row in table.tolist()] == [(1.5, 2.0, -3.0, 0.25), (4.0, 5.0, 6.0, 0.0)]
    (tmp_path / "2.txt").write_text("")
    assert len(read_cloud(tmp_path / "2.txt")) == 0


@pytest.mark.parametrize(
    ("text", "why"), [("1 2 3\n", "3 numbers in a line"), ("1 2 3 4\n1 2\n", "columns"), ("a b c d", "convert")]
)
def test_text_that_is_no_cloud_is_named(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "1.txt").write_text(text)
    with pytest.raises(BadInputError, match=why):
        read_cloud(tmp_path / "1.txt")
