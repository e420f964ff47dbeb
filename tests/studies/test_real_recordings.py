"""What is measured of real recordings, first on made ones whose answers are known, then on the published ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.lio.state import STANDARD_GRAVITY
from ambler.studies.real_recordings import measure_inertial, measure_pair
from ambler.wire.cloud_files import write_cloud
from ambler.wire.trajectory_files import write_tum_3d
from tests.public_data import public

RADIUS, RATE, BEGIN = 3.0, 0.4, 1000.0  # a level circle, metres and rad/s


def circle(folder: Path, *, rate_factor: float = 1.0, missing: bool = False) -> Path:
    """Write the measurements of an IMU that runs round a circle, looking along it, and its trajectory."""
    folder.mkdir(parents=True, exist_ok=True)
    times = BEGIN + np.arange(0.0, 20.0, 0.01)
    if missing:
        times = times[(times < BEGIN + 8.0) | (times > BEGIN + 9.0)]
    force = [0.0, RADIUS * RATE**2, STANDARD_GRAVITY]
    rows = np.column_stack([times, np.tile([*force, 0.0, 0.0, rate_factor * RATE], (len(times), 1))])
    np.savetxt(folder / "imu.txt", rows)
    stamps = BEGIN + 0.005 + np.arange(0.0, 19.9, 0.1)
    poses = []
    for t in (stamps - BEGIN).tolist():
        turn = RATE * t
        poses.append(SE3.from_rpy((RADIUS * np.sin(turn), RADIUS * (1.0 - np.cos(turn)), 0.0), 0.0, 0.0, turn))
    write_tum_3d(folder / "traj.txt", [round(t * 1e9) for t in stamps.tolist()], poses)
    return folder


def test_an_exact_imu_leads_where_it_went(tmp_path: Path) -> None:
    fields = measure_inertial(circle(tmp_path))
    assert fields["imu.after_1000_ms_runs"] > 30
    assert fields["imu.after_5000_ms_rotation_deg_95"] < 1e-3
    assert fields["imu.after_1000_ms_position_m_95"] < 0.002  # the speed is the chord's
    assert fields["imu.after_100_ms_position_m_95"] < 2e-4


def test_a_scale_of_the_gyroscope_is_seen(tmp_path: Path) -> None:
    fields = measure_inertial(circle(tmp_path, rate_factor=1.01))
    assert fields["imu.after_1000_ms_rotation_deg_median"] == pytest.approx(np.degrees(0.01 * RATE), rel=0.01)
    assert fields["imu.after_5000_ms_position_m_median"] > 0.02


def test_stretches_without_samples_are_left_out(tmp_path: Path) -> None:
    whole, holed = (measure_inertial(circle(tmp_path / str(m), missing=m)) for m in (False, True))
    assert holed["imu.after_100_ms_runs"] < whole["imu.after_100_ms_runs"] - 8
    assert holed["imu.after_1000_ms_rotation_deg_95"] < 1e-3


def room(rng: np.random.Generator) -> NDArray[np.float64]:
    points = rng.uniform(-1.0, 1.0, (30000, 3)) * [8.0, 5.0, 2.0]
    side = rng.integers(0, 5, len(points))
    for axis, sign, number in ((0, -8.0, 0), (0, 8.0, 1), (1, -5.0, 2), (1, 5.0, 3), (2, -2.0, 4)):
        points[side == number, axis] = sign
    box = rng.uniform(-1.0, 1.0, (4000, 3)) * [0.8, 0.5, 1.0] + [3.0, -2.0, -1.0]
    box[:2000, 0], box[2000:, 1] = 2.2, -1.5
    return np.vstack([points, box])


def test_clouds_are_laid_from_every_guess(tmp_path: Path) -> None:
    told = SE3.from_rpy((0.6, -0.3, 0.05), 0.01, -0.02, 0.12)
    target, source = (room(np.random.default_rng(k)) for k in (1, 2))
    write_cloud(tmp_path / "target.ply", target)
    write_cloud(tmp_path / "source.ply", told.inverse().transform(source))
    np.savetxt(tmp_path / "T_target_source.txt", told.matrix())
    fields, laid = measure_pair(tmp_path, 5)
    assert fields["pair.position_error_m"] < 0.02
    assert fields["pair.rotation_error_deg"] < 0.2
    assert fields["pair.starts_found"] == fields["pair.starts"] == 50
    np.testing.assert_allclose(laid.source, source, atol=0.06)
    np.savetxt(tmp_path / "T_target_source.txt", (told @ SE3.from_rpy((0.0, 0.4, 0.0), 0.0, 0.0, 0.0)).matrix())
    wrong, _ = measure_pair(tmp_path, 5)
    assert wrong["pair.position_error_m"] == pytest.approx(0.4, abs=0.03)
    assert wrong["pair.starts_found"] == 0


def test_files_that_are_none_get_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"imu\.txt: cannot be read"):
        measure_inertial(tmp_path)
    circle(tmp_path)
    (tmp_path / "imu.txt").write_text("1 2 3\n")
    with pytest.raises(BadInputError, match="7 columns are asked, there are 3"):
        measure_inertial(tmp_path)


def test_a_real_imu_leads_for_a_scan_to_a_millimetre() -> None:
    fields = measure_inertial(public("imu_deskew"))
    assert fields["imu.after_100_ms_runs"] > 2000
    assert fields["imu.after_100_ms_position_m_95"] < 1e-3
    assert fields["imu.after_1000_ms_rotation_deg_95"] < 0.1


def test_real_clouds_are_laid_from_every_guess() -> None:
    fields, _ = measure_pair(public("pair3d"), 3)
    assert fields["pair.starts_found"] == 50
    assert fields["pair.position_error_m"] < 0.02
