"""A camera is calibrated from rendered checkerboards, saved, and read back; bad pictures and bad files are refused in words."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambler.calibration.camera_calibration import Checkerboard, calibrate_camera
from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3
from ambler.sim.camera import FRONT_CAMERA, CameraSpec, PrintCamera, checkerboard_print
from ambler.wire.camera_info import load_camera_info, save_camera_info

BOARD = Checkerboard(7, 5, 0.04)


def pictures(poses: list[tuple[float, ...]]) -> list[np.ndarray]:
    camera = PrintCamera(CameraSpec(), np.random.default_rng(1))
    out = []
    for x, y, z, roll, turn in poses:
        board = SE3.from_rpy((x, y, z), math.pi + roll, turn, 0.0)
        out.append(camera.take([SE3()], [checkerboard_print(BOARD.columns, BOARD.rows, BOARD.square, board)]))
    return out


SPREAD = [
    (-0.2, -0.12, 0.6, 0.0, 0.4), (0.2, -0.12, 0.6, 0.3, -0.3), (-0.2, 0.12, 0.6, -0.4, 0.2), (0.2, 0.12, 0.6, 0.2, 0.5),
    (0.0, 0.0, 0.45, 0.5, 0.0), (0.0, 0.0, 0.45, -0.4, -0.4), (-0.05, 0.02, 0.8, 0.1, 0.6), (0.1, 0.0, 0.5, 0.0, -0.6),
    (0.0, -0.1, 0.5, -0.5, 0.3), (-0.12, 0.05, 0.5, 0.4, -0.5),
]  # fmt: skip


def test_a_camera_is_calibrated_from_checkerboards() -> None:
    done = calibrate_camera("front", pictures(SPREAD), BOARD)
    assert len(done.used) >= 8
    assert done.error_px < 0.25
    assert done.camera.fx == pytest.approx(FRONT_CAMERA.fx, rel=0.004)
    assert done.camera.fy == pytest.approx(FRONT_CAMERA.fy, rel=0.004)
    assert done.camera.cx == pytest.approx(FRONT_CAMERA.cx, abs=2.0)
    assert done.camera.cy == pytest.approx(FRONT_CAMERA.cy, abs=2.0)
    rng = np.random.default_rng(2)
    rays = rng.uniform((-0.5, -0.38), (0.5, 0.38), (200, 2))
    assert np.abs(done.camera.distort(rays) - FRONT_CAMERA.distort(rays)).max() < 3.0


def test_pictures_that_cannot_tell_are_refused() -> None:
    few = pictures(SPREAD[:2])
    with pytest.raises(BadInputError, match="found in 2 of 2"):
        calibrate_camera("front", few, BOARD)
    with pytest.raises(BadInputError, match="one part"):
        calibrate_camera("front", pictures([(0.0, 0.0, 1.2, 0.1, 0.1)]) * 6, BOARD)
    with pytest.raises(BadInputError, match="sizes"):
        calibrate_camera("front", [few[0], few[1][:-2]], BOARD)


def test_distortion_is_undone() -> None:
    rational = replace(FRONT_CAMERA, distortion=(-0.2, 0.05, 0.001, -0.001, 0.01, 0.02, -0.01, 0.005))
    rays = np.random.default_rng(3).uniform(-0.5, 0.5, (300, 2))
    for camera in (FRONT_CAMERA, rational):
        assert np.abs(camera.undistort(camera.distort(rays)) - rays).max() < 1e-8
    with pytest.raises(ValueError, match="coefficients"):
        replace(FRONT_CAMERA, distortion=(0.1,))


@pytest.mark.parametrize("distortion", [FRONT_CAMERA.distortion, (0.1, 0.2, 0.0, 0.0, 0.3, 0.4, 0.5, 0.6)])
def test_camera_info_is_read_as_it_was_written(tmp_path: Path, distortion: tuple[float, ...]) -> None:
    camera = replace(FRONT_CAMERA, fx=554.123456789, distortion=distortion)
    save_camera_info(tmp_path / "front.yaml", camera)
    assert load_camera_info(tmp_path / "front.yaml") == camera
    assert [p.name for p in tmp_path.iterdir()] == ["front.yaml"]


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("image_width: 640", "image_width: many", "image_width"),
        ("554.0", "0.0", "not calibrated"),
        ("plumb_bob", "fisheye", "fisheye"),
        ("camera_matrix", "matrix", "camera_matrix must have 9"),
        ("-0.11", ".nan", "not finite"),
        ("-0.11", "x", "no number"),
        ("image_width", "[", "YAML"),
    ],
)
def test_bad_camera_info_is_refused(tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "front.yaml"
    save_camera_info(path, FRONT_CAMERA)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(BadInputError, match=text):
        load_camera_info(path)


def test_a_missing_camera_info_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="cannot be read"):
        load_camera_info(tmp_path / "none.yaml")
    assert CameraModel("c", 10, 10, 1.0, 1.0, 4.5, 4.5).matrix[0, 2] == 4.5
