"""A recording becomes a table whose numbers are those of the messages."""

from pathlib import Path

import numpy as np
import pytest

from ambler.core import messages as m
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.wire.csv_files import read_columns, recording_to_csv
from ambler.wire.mcap_file import McapRecorder


def record(folder: Path) -> Path:
    recorder = McapRecorder(folder)
    for k in range(3):
        pose = SE3.from_se2(SE2(0.1 * k, -2.0, 0.3))
        covariance = np.arange(36.0).reshape(6, 6) * k
        recorder.write(
            "/odom", m.Odometry(k * 10**9 + 7, "odom", "base", pose, (k, 0, 0), (0, 0, k), covariance, covariance), k
        )
        scalars = (0.0, 0.1, 0.0, 0.1, 0.1, 9.0)
        ranges = np.ones(3 + k, np.float32)
        recorder.write("/scan", m.LaserScan(k, "laser", *scalars, ranges, np.empty(0, np.float32)), k)
    recorder.close()
    return folder


def test_every_number_of_a_message_is_a_column(tmp_path: Path) -> None:
    recording = record(tmp_path / "recording")
    assert recording_to_csv(recording, "/odom", m.Odometry, tmp_path / "odom.csv") == 3
    columns = read_columns(tmp_path / "odom.csv")
    np.testing.assert_array_equal(columns["stamp_ns"], [7, 10**9 + 7, 2 * 10**9 + 7])
    np.testing.assert_array_equal(columns["pose.translation.0"], [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(columns["pose_covariance.35"], [0.0, 35.0, 70.0])
    np.testing.assert_array_equal(columns["angular.2"], [0.0, 1.0, 2.0])
    assert "frame" not in columns  # words are no numbers


def test_what_fits_no_table_is_refused(tmp_path: Path) -> None:
    recording = record(tmp_path / "recording")
    with pytest.raises(BadInputError, match="different numbers"):
        recording_to_csv(recording, "/scan", m.LaserScan, tmp_path / "scan.csv")
    with pytest.raises(BadInputError, match="no message on /nothing"):
        recording_to_csv(recording, "/nothing", m.Odometry, tmp_path / "nothing.csv")
