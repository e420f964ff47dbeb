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
from ambler.wire.carmen import CarmenLog, load_carmen

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


def told(log: CarmenLog) -> tuple[str, ...]:
    """Return the notes but those on the scanner, whose few beams are no known one's."""
    return tuple(note for note in log.notes if " beams " not in note)


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
    assert told(log) == ("left out: 3 RAWLASER lines, which carry no pose, beside 1 that do",)


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


DAMAGED = [
    ("FLASER 180 1.0 2.0", "announces 180"),
    ("FLASER x 1.0", "FLASER"),
    (FLASER.replace("2.0", "2..0"), "could not convert"),
    (FLASER.replace("0.4 0.1", "inf 0.1"), "not finite"),
    (FLASER + " 17", "needs 15 fields"),
    (FLASER.replace("1.0 2.0 ", "1.0 "), "no host"),
    (FLASER.replace("1.0 2.0 3.0 ", "1.0 ").replace("host", "7"), "most lines 2"),
    (FLASER + FLASER, "FLASER"),
    (FLASER.removesuffix(" host 0.5"), "ends 0 fields"),
    (FLASER.removesuffix("337284 host 0.5"), "ends 0 fields"),
    (FLASER.removesuffix(" 0.5"), "ends 1 fields"),
    (ROBOT[:-20], "ROBOTLASER1"),
    (ROBOT.replace("ROBOTLASER1", "ROBOTLASER7") + " 17", "ROBOTLASER7"),
    ("\x00\x01binary", "no CARMEN message"),
    ("0.1 0.2 12.5 host 0.5", "no CARMEN message"),
    (FLASER.replace("976052857.337284", "-5"), "impossible"),
    (FLASER.replace("976052857.337284", "nan"), "impossible"),
]


@pytest.mark.parametrize(("line", "reason"), DAMAGED)
def test_a_damaged_line_is_left_out_and_told(tmp_path: Path, line: str, reason: str) -> None:
    log = load_carmen(write(tmp_path, f"{FLASER}\n{ODOM}\n{line}\n{FLASER}\n{FLASER}\n".encode()))
    assert [laser.line for laser in log.lasers] == [1, 4, 5]
    (note,) = told(log)
    assert note.startswith("left out: a damaged line, line 3 (")
    assert reason in note
    assert "\n" not in note


@pytest.mark.parametrize(("line", "reason"), DAMAGED)
def test_many_damaged_lines_refuse_the_log_and_the_first_is_named(tmp_path: Path, line: str, reason: str) -> None:
    text = "\n".join([FLASER, ODOM, *[line] * 6, *[FLASER] * 20]) + "\n"
    with pytest.raises(BadInputError, match=r"line 3 .*the first of 6 damaged lines beside 21 laser lines") as caught:
        load_carmen(write(tmp_path, text.encode()))
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("good", "bad", "is_read"), [(6, 5, True), (6, 6, False), (5, 5, False), (900, 9, True), (900, 10, False)]
)
def test_how_much_damage_a_log_may_have(tmp_path: Path, good: int, bad: int, is_read: bool) -> None:
    path = write(tmp_path, "\n".join([*[FLASER] * good, *["FLASER 7 1.0"] * bad, ""]).encode())
    if is_read:
        log = load_carmen(path)
        assert len(log.lasers) == good
        assert f"{bad} damaged lines, the first line {good + 1} (FLASER)" in log.notes[0]
    else:
        with pytest.raises(BadInputError, match=rf"line {good + 1} \(FLASER\)"):
            load_carmen(path)


@pytest.mark.parametrize("damaged", ["ODOM 1 2 3", ODOM.replace("1.0", "nan"), ODOM.replace("1.0 2.0 ", "1.0 ")])
def test_odometry_need_be_right_only_where_it_is_used(tmp_path: Path, damaged: str) -> None:
    log = load_carmen(write(tmp_path, "\n".join([FLASER, *[damaged] * 20, ""]).encode()))
    assert (len(log.lasers), log.odometry, told(log)) == (1, (), ())
    log = load_carmen(write(tmp_path, "\n".join([ODOM, damaged, ODOM, RAW, RAW, ""]).encode()))
    assert [line.line for line in log.odometry] == [1, 3]
    assert "line 2 (ODOM)" in log.notes[0]
    with pytest.raises(BadInputError, match=r"line 2 \(ODOM\)"):
        load_carmen(write(tmp_path, "\n".join([ODOM, *[damaged] * 6, *[ODOM] * 9, *[RAW] * 9, ""]).encode()))


def test_readings_that_are_no_ranges_are_unknown_and_told(tmp_path: Path) -> None:
    old = FLASER.replace("1.0 2.0 3.0 81.83", "nan -1 -inf inf")
    none = FLASER.replace("1.0 2.0 3.0 81.83", "nan -1 -inf nan")
    new = RAW.replace("1.0 2.0 3.0", "-0.5 2.0 NaN")
    (line,) = load_carmen(write(tmp_path, f"{old}\n".encode())).lasers
    assert np.isnan(line.ranges).tolist() == [True, True, True, False]
    assert line.ranges[3] == np.inf
    log = load_carmen(write(tmp_path, f"{new}\n{RAW}\n".encode()))
    assert np.isnan(log.lasers[0].ranges).tolist() == [True, False, True]
    assert any("negative or no number: 2;" in note for note in log.notes)
    with pytest.raises(BadInputError, match="all readings are negative or no number"):
        load_carmen(write(tmp_path, f"{none}\n{none}\n".encode()))


@pytest.mark.parametrize("end", ["", " host"])
def test_logs_without_the_logger_s_stamp_have_the_stamps_of_their_lines(tmp_path: Path, end: str) -> None:
    lines = [line.rsplit(" ", 2)[0] + end for line in (FLASER, FLASER.replace("1.0", "1.5"), ROBOT, ODD, ODOM)]
    log = load_carmen(write(tmp_path, ("\n".join(lines) + "\n").encode()))
    assert [line.stamp for line in log.lasers] == [976052857.337284, 976052857.337284, 100.25, 12.5]
    assert [line.stamp for line in log.odometry] == [12.25]
    whole = load_carmen(write(tmp_path, f"{FLASER}\n".encode())).lasers[0]
    assert log.lasers[0].ranges.tolist() == whole.ranges.tolist()
    assert (log.lasers[0].odom_from_base, told(log)) == (whole.odom_from_base, ())
    lost = lines[0].replace("2.0 ", "")
    log = load_carmen(write(tmp_path, ("\n".join([*lines, lost]) + "\n").encode()))
    assert "line 6 (FLASER)" in log.notes[0]


def test_a_last_stamp_that_may_have_lost_digits_does_not_count(tmp_path: Path) -> None:
    line = FLASER.rsplit(" ", 2)[0]
    log = load_carmen(write(tmp_path, f"{line}\n{line}\n{line[:-8]}".encode()))
    assert (len(log.lasers), log.cut_line) == (2, 3)


def test_messages_of_other_kinds_are_left_out_and_named(tmp_path: Path) -> None:
    text = f"{FLASER}\nodom_message 1 2\nSYNC tag\n{FLASER}\n" + "Imu 1 2 3\n" * 50 + "NMEA-GGA x\n"
    log = load_carmen(write(tmp_path, text.encode()))
    assert len(log.lasers) == 2
    assert told(log) == ("left out: 53 lines of other messages (odom_message, SYNC, Imu, ...), the first in line 2",)


def test_how_lines_are_set_does_not_matter(tmp_path: Path) -> None:
    odd = "\r\n".join(
        [
            "",
            "  ",
            "# comment",
            " # another",
            FLASER.replace(" ", "\t") + "  ",
            "PARAM",
            "PARAM a",
            "PARAM b \xff\xfe odd",
            ROBOT,
            "",
        ]
    )
    log = load_carmen(write(tmp_path, odd.encode("latin-1")))
    assert (len(log.lasers), told(log), log.cut_line) == (2, (), None)


@pytest.mark.parametrize(
    "data", [b"\x89PNG\r\n\x1a\n\x00\x00" * 50, b"1.0 2.0 3.0\n" * 5000, "caf\u00e9: 1\n".encode() * 3]
)
def test_what_is_no_log_is_refused_by_its_first_line(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(BadInputError, match="line 1 ") as caught:
        load_carmen(write(tmp_path, data))
    assert "no CARMEN" in str(caught.value)
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
    assert_usable(log)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damage_costs_no_line_but_those_that_it_hits(tmp_path: Path, data: st.DataObject) -> None:
    """Bytes are overwritten, lost or joined anywhere: all lines beside are read as before, and what is left out is told."""
    lines = [FLASER.replace("81.83", f"{10.0 + k:.2f}") for k in range(30)]
    whole = load_carmen(write(tmp_path, ("\n".join(lines) + "\n").encode()))
    blob = bytearray("\n".join(lines).encode())
    width = len(blob) // len(lines) + 1
    hit: set[int] = set()
    for _ in range(data.draw(st.integers(1, 3))):
        start, size = data.draw(st.integers(0, len(blob) - 1)), data.draw(st.integers(1, 60))
        for at in range(start, min(start + size, len(blob))):
            blob[at] = data.draw(st.sampled_from(b"0 .-nx\xff")) if at == start else ord(" ")
            hit |= {at // width, (at + 1) // width}
    log = load_carmen(write(tmp_path, bytes(blob) + b"\n"))
    assert_usable(log)
    for k, line in enumerate(whole.lasers):
        if k not in hit:
            assert any(
                line.ranges.tolist() == other.ranges.tolist() and line.stamp == other.stamp for other in log.lasers
            ), f"line {k + 1}"
    if len(log.lasers) < len(whole.lasers):
        assert any(note.startswith("left out") for note in log.notes)


def assert_usable(log: CarmenLog) -> None:
    """Poses and stamps are finite, and ranges not negative."""
    for line in log.lasers:
        assert len(line.ranges) > 0
        assert not (line.ranges < 0.0).any()
        assert math.isfinite(line.stamp)
        assert math.isfinite(line.angle_min + line.angle_increment)
        assert line.odom_from_base is not None
        assert math.isfinite(line.odom_from_base.x + line.odom_from_base.yaw)
