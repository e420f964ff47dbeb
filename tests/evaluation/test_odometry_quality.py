"""Fused odometry against satellites: geometry of the tangent plane, the vertical, and the recorded Husky."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from ambler.cli.main import main
from ambler.core.errors import BadInputError
from ambler.core.messages import GnssFix, Imu
from ambler.evaluation.odometry_quality import fused, read_odometry_record, to_plane, vertical, wheels_alone
from ambler.localization.odometry import OdometryConfig
from tests.public_data import public

BAG = "ros1/husky_imu_odom_gps.bag"


def fix(latitude: float, longitude: float) -> GnssFix:
    return GnssFix(0, "gps", latitude, longitude, 0.0, (1.0, 1.0, 1.0))


@pytest.mark.parametrize("latitude", [0.0, 42.0, -60.0])
def test_a_degree_is_as_long_as_on_the_ellipsoid(latitude: float) -> None:
    """Against the series for the length of a degree (m): 111132.95 - 559.85 cos 2l, and 111412.88 cos l - 93.5 cos 3l."""
    plane = to_plane([fix(latitude, 8.0), fix(latitude + 1e-3, 8.0), fix(latitude, 8.0 + 1e-3)])
    angle = math.radians(latitude)
    assert plane[1, 1] == pytest.approx(1e-3 * (111132.95 - 559.85 * math.cos(2 * angle)), rel=1e-4)
    assert plane[2, 0] == pytest.approx(1e-3 * (111412.88 * math.cos(angle) - 93.5 * math.cos(3 * angle)), rel=1e-4)
    assert plane[0].tolist() == [0.0, 0.0]


def test_up_is_where_gravity_comes_from() -> None:
    rng = np.random.default_rng(0)
    true = np.array([0.1, 0.9, -0.2]) / np.linalg.norm([0.1, 0.9, -0.2])
    samples = [Imu(k, "imu", (0.0, 0.0, 0.0), tuple(9.81 * true + rng.normal(0, 0.3, 3))) for k in range(500)]
    np.testing.assert_allclose(vertical(samples), true, atol=0.01)
    with pytest.raises(BadInputError, match="gravity"):
        vertical([Imu(0, "imu", (0.0, 0.0, 0.0), (0.0, 0.0, 0.1))])


def test_the_gyroscope_halves_the_error_of_the_husky() -> None:
    record = read_odometry_record(public(BAG))
    assert record.up[1] > 0.99, "its IMU lies on the side"
    wheels, both = wheels_alone(record), fused(record, OdometryConfig())
    assert both.error.ate_rms_m < 0.6 * wheels.error.ate_rms_m
    assert both.error.ate_rms_m < 5.0


def test_the_command_writes_its_result(tmp_path: Path) -> None:
    out, picture = tmp_path / "odometry.json", tmp_path / "tracks.png"
    assert main(["eval", "odometry", str(public(BAG)), "--json", str(out), "--picture", str(picture)]) == 0
    assert json.loads(out.read_text())["fixes"] == 989
    assert picture.stat().st_size > 10_000


def test_a_recording_without_what_is_needed_is_one_clear_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "not_a.bag"
    path.write_bytes(b"nothing")
    assert main(["eval", "odometry", str(path)]) == 2
    assert str(path) in capsys.readouterr().err
