"""The Wean Hall log and map: units, order, the laser's place, and files that are none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ambler.core.errors import BadInputError
from ambler.core.messages import LaserScan, Odometry
from ambler.wire.wean import read_wean_log, read_wean_map
from tests.public_data import public


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_log_in_centimetres_becomes_metres_in_file_order(tmp_path: Path) -> None:
    ranges = ["100"] * 90 + ["8183"] * 45 + ["8191"] * 45
    text = f"O 100 -200 0.5 0.25\nL 110 -200 {math.pi / 2} 110 -175 {math.pi / 2} {' '.join(ranges)} 0.5\n"
    log = read_wean_log(write(tmp_path / "a.log", text))
    first, own, scan = log.messages
    assert isinstance(first, Odometry)
    assert isinstance(own, Odometry)
    assert isinstance(scan, LaserScan)
    assert first.pose.to_se2().as_array() == pytest.approx([1.0, -2.0, 0.5])
    assert (first.stamp_ns, own.stamp_ns, scan.stamp_ns) == (250_000_000, 500_000_000, 500_000_000)
    assert log.base_from_laser.as_array() == pytest.approx([0.25, 0.0, 0.0])
    assert scan.angle_min == pytest.approx(-math.pi / 2)
    assert scan.ranges[:90].tolist() == [1.0] * 90
    assert np.isinf(scan.ranges[90:]).all()
    assert math.isnan(first.linear[0])  # the log tells no velocity


def test_a_map_of_free_probabilities_becomes_occupancy(tmp_path: Path) -> None:
    head = "robot_specifications->resolution    10\n\nglobal_map[0]: 3 2\n"
    loaded = read_wean_map(write(tmp_path / "m.dat", head + "-1 0.25 1\n0 0.5 -1\n"))
    assert loaded.spec.shape == (3, 2)
    assert loaded.spec.resolution == pytest.approx(0.1)
    np.testing.assert_array_equal(loaded.p_occupied, np.array([[np.nan, 1.0], [0.75, 0.5], [0.0, np.nan]], np.float32))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("O 1 2 3\n", "a.log:1: is neither"),
        ("O 1 2 3 4\nL 1 2 3\n", "a.log:2: is neither"),
        ("O 1 2 x 4\n", "a.log:1: a field is not a number"),
        ("O 1 2 3 4\n", "holds no laser line"),
        ("", "holds no laser line"),
    ],
)
def test_files_that_are_no_log_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        read_wean_log(write(tmp_path / "a.log", text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello\n", "global_map"),
        ("a->resolution 10\nglobal_map[0]: 2 2\n1 1\n", "1 map lines, not 2"),
        ("a->resolution 10\nglobal_map[0]: 2 2\n1 1\n1 1 1\n", "map line 2 has 3 values, not 2"),
        ("a->resolution 10\nglobal_map[0]: 2 2\n1 1\n1 b\n", "map line 2: a value is not a number"),
        ("a->resolution ten\nglobal_map[0]: 2 2\n", "a header line is not as it should be"),
    ],
)
def test_files_that_are_no_map_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        read_wean_map(write(tmp_path / "m.dat", text))


def test_missing_and_binary_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="No such file"):
        read_wean_log(tmp_path / "none.log")
    (tmp_path / "b.log").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadInputError, match="not a text file"):
        read_wean_log(tmp_path / "b.log")


def test_the_recorded_log_and_map_have_their_known_size() -> None:
    log, world = read_wean_log(public("cmu_wean/robotdata1.log")), read_wean_map(public("cmu_wean/wean.dat"))
    scans = [message for message in log.messages if isinstance(message, LaserScan)]
    assert len(scans) == 713
    assert len(log.messages) == 713 + 1505 + 713
    assert (np.diff([message.stamp_ns for message in log.messages]) >= 0).all()
    assert log.base_from_laser.as_array() == pytest.approx([0.25, 0.0, 0.0], abs=1e-4)
    assert sum(int(np.isinf(s.ranges).sum()) for s in scans) == 693
    assert world.spec.shape == (800, 800)
    known = world.p_occupied[~np.isnan(world.p_occupied)]
    assert 0.1 < np.mean(known > 0.5) < 0.2
