"""The CARMEN reader: fields of every laser line, compression by content, damage named by line or byte; fuzz."""

import bz2
import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ambler.core.errors import BadInputError
from ambler.wire.carmen import load_carmen

FLASER = "FLASER 4 1.0 2.0 3.0 81.83 0.5 0.1 0.2 0.4 0.1 0.2 976052857.337284 host 0.5"
ODD = "FLASER 3 1.0 2.0 3.0 0 0 0 0 0 0 12.5 host 0.5"
ROBOT = "ROBOTLASER1 0 -1.5 3.0 0.5 30.0 0.01 0 3 1.0 2.0 3.0 1 7 0.1 0.2 0.3 0.0 0.2 0.3 0.5 0.1 0 0 0 100.25 host 1.0"
RAW = "RAWLASER1 0 -1.5 3.0 0.5 30.0 0.01 0 3 1.0 2.0 3.0 1 7 100.25 host 1.0"
ODOM = "ODOM 1.0 2.0 9.0 0.1 0.2 0.3 12.25 host 0.25"
LOG = f"# a comment\nPARAM robot_frontlaser_offset 0.08 host 0\n{FLASER}\n{ODOM}\n{ODD}\n{ROBOT}\nSYNC tag\n"


def write(folder: Path, data: bytes) -> Path:
    """Write a log file."""
    path = folder / "some.log"
    path.write_bytes(data)
    return path


def test_fields(tmp_path: Path) -> None:
    log = load_carmen(write(tmp_path, LOG.encode()))
    first, odd, robot = log.lasers
    assert f"{first.stamp:.6f}" == "976052857.337284"
    assert first.ranges.tolist() == pytest.approx([1.0, 2.0, 3.0, 81.83])
    assert (first.angle_min, first.angle_increment) == pytest.approx((-math.pi / 2, math.pi / 4))
    assert first.odom_from_laser is not None
    assert first.odom_from_base is not None
    assert (first.odom_from_laser.x, first.odom_from_base.x) == (0.5, 0.4)
    assert odd.angle_increment == pytest.approx(math.pi / 2)
    assert (robot.angle_min, robot.angle_increment, robot.max_range, robot.stamp) == (-1.5, 0.5, 30.0, 100.25)
    assert robot.odom_from_laser is not None
    assert robot.odom_from_laser.x == 0.1
    assert log.odometry[0].odom_from_base.yaw == pytest.approx(9.0 - 2 * math.pi)
    assert log.parameters == {"robot_frontlaser_offset": "0.08"}
    assert [line.line for line in log.lasers] == [3, 5, 6]


@pytest.mark.parametrize("name", ["ROBOTLASER0", "ROBOTLASER2", "ROBOTLASER3", "ROBOTLASER12"])
def test_robot_lasers_of_any_number_are_read(tmp_path: Path, name: str) -> None:
    (line,) = load_carmen(write(tmp_path, ROBOT.replace("ROBOTLASER1", name).encode())).lasers
    assert (line.name, line.max_range) == (name, 30.0)


def test_raw_lasers_are_read_without_poses(tmp_path: Path) -> None:
    log = load_carmen(write(tmp_path, f"{ODOM}\n{RAW}\n{ODOM}\n".encode()))
    (line,) = log.lasers
    assert line.ranges.tolist() == [1.0, 2.0, 3.0]
    assert (line.angle_min, line.angle_increment, line.max_range, line.stamp) == (-1.5, 0.5, 30.0, 100.25)
    assert line.odom_from_laser is None
    assert line.odom_from_base is None
    assert len(log.odometry) == 2


def test_raw_lasers_are_left_out_beside_lines_that_carry_poses(tmp_path: Path) -> None:
    log = load_carmen(write(tmp_path, f"{RAW}\n{FLASER}\nRAWLASER1 some other form\n{RAW}\n".encode()))
    assert [line.name for line in log.lasers] == ["FLASER"]
    assert any("3 RAWLASER lines" in note for note in log.notes)


def test_damage_in_a_log_of_raw_lasers_names_the_line(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="line 2"):
        load_carmen(write(tmp_path, f"{ODOM}\nRAWLASER1 0 -1.5\n{ODOM}\n".encode()))


def test_old_lines_take_range_and_angles_from_the_parameters_wherever_they_stand(tmp_path: Path) -> None:
    text = f"{FLASER}\nPARAM robot_front_laser_max 8.1 host 0\nPARAM laser_front_laser_fov 100 host 0\n{ROBOT}\n"
    old, robot = load_carmen(write(tmp_path, text.encode())).lasers
    assert old.max_range == 8.1
    assert old.angle_min == pytest.approx(-math.radians(50.0))
    assert old.angle_increment == pytest.approx(math.radians(25.0))
    assert robot.max_range == 30.0, "what a line says itself counts"


@pytest.mark.parametrize("compress", [bz2.compress, gzip.compress])
def test_compressed_files_are_known_by_their_content(tmp_path: Path, compress: object) -> None:
    assert callable(compress)
    assert len(load_carmen(write(tmp_path, compress(LOG.encode()))).lasers) == 3


@pytest.mark.parametrize("compress", [bz2.compress, gzip.compress])
def test_a_cut_compressed_file_names_the_byte(tmp_path: Path, compress: object) -> None:
    assert callable(compress)
    data = compress((LOG * 200).encode())
    with pytest.raises(BadInputError, match="byte"):
        load_carmen(write(tmp_path, data[: len(data) // 2]))


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("FLASER 180 1.0 2.0", "announces 180"),
        ("FLASER x 1.0", "FLASER"),
        (FLASER.replace("2.0", "2..0"), "could not convert"),
        (FLASER.replace(" 2.0 ", " nan "), "not a number"),
        (FLASER.replace("0.4 0.1", "inf 0.1"), "not finite"),
        (FLASER + " 17", "needs 15 fields"),
        (ROBOT[:-20], "ROBOTLASER1"),
        (ROBOT.replace("ROBOTLASER1", "ROBOTLASER7") + " 17", "ROBOTLASER7"),
        ("ODOM 1 2 3", "needs 10 fields"),
        ("\x00\x01binary", "no CARMEN message"),
        (FLASER.replace("976052857.337284", "-5"), "impossible"),
    ],
)
def test_damage_names_the_line(tmp_path: Path, line: str, reason: str) -> None:
    path = write(tmp_path, f"{FLASER}\n{ODOM}\n{line}\n{FLASER}\n".encode())
    with pytest.raises(BadInputError, match="line 3") as caught:
        load_carmen(path)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("last", [FLASER, ROBOT, ODOM], ids=lambda line: line.split()[0])
def test_a_last_line_that_is_cut_off_is_left_out(tmp_path: Path, last: str, share: float) -> None:
    path = write(tmp_path, (LOG + last[: int(share * len(last))]).encode())
    log = load_carmen(path)
    assert log.cut_line == len(LOG.splitlines()) + 1
    assert [line.line for line in log.lasers] == [3, 5, 6]
    assert load_carmen(write(tmp_path, (LOG + last).encode())).cut_line is None, "only the end of the line is missing"


@pytest.mark.parametrize("data", [b"", b"\n\n", b"# only comments\n", (ODOM + "\n").encode()])
def test_a_log_without_lasers_is_refused(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(BadInputError, match="no laser line"):
        load_carmen(write(tmp_path, data))


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="cannot be read"):
        load_carmen(tmp_path / "nothing.log")
    with pytest.raises(BadInputError, match="cannot be read"):
        load_carmen(tmp_path)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damage_is_read_or_refused_cleanly(tmp_path: Path, data: st.DataObject) -> None:
    """Truncated or garbled input never raises anything but BadInputError, and what is read is finite."""
    coded = data.draw(st.sampled_from([bytes, bz2.compress, gzip.compress]))
    blob = bytearray(coded((LOG * 3).encode()))
    for _ in range(data.draw(st.integers(0, 4))):
        blob[data.draw(st.integers(0, len(blob) - 1))] = data.draw(st.integers(0, 255))
    blob = blob[: data.draw(st.integers(0, len(blob)))]
    try:
        log = load_carmen(write(tmp_path, bytes(blob)))
    except BadInputError as error:
        assert "\n" not in str(error)  # noqa: PT017
        return
    for line in log.lasers:
        assert len(line.ranges) > 0
        assert not np.isnan(line.ranges).any()
        assert math.isfinite(line.stamp)
        assert math.isfinite(line.angle_min + line.angle_increment)
        assert line.odom_from_base is not None
        assert math.isfinite(line.odom_from_base.x + line.odom_from_base.yaw)
