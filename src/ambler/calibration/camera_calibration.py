"""Camera calibration from pictures of a checkerboard (Zhang 2000, by OpenCV), with a judgement of what the pictures can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel
from ambler.core.errors import BadInputError

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

PICTURES = 6
FOCAL_SHARE = 0.01  # standard deviation of the focal length from which it is unknown
COVERED = 0.35  # share of the picture's area that the corners of all pictures must span


@dataclass(frozen=True, slots=True)
class Checkerboard:
    """Inner corners along and across, and the side of a square in metres."""

    columns: int
    rows: int
    square: float

    def points(self) -> NDArray[np.float32]:
        """The inner corners, float32 (N, 3), row by row."""
        grid = np.zeros((self.columns * self.rows, 3), np.float32)
        grid[:, :2] = np.mgrid[: self.columns, : self.rows].T.reshape(-1, 2) * self.square
        return grid


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """A camera, the RMS distance of its corners in pixels, the standard deviation of its focal length, and the pictures used."""

    camera: CameraModel
    error_px: float
    focal_sigma_px: float
    used: tuple[int, ...]


def find_checkerboard(image: U8, board: Checkerboard) -> F64 | None:
    """Return the inner corners float64 (N, 2) in pixels, or None when the board is not seen whole."""
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    is_found, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    return np.asarray(corners, np.float64).reshape(-1, 2) if is_found else None


def calibrate_camera(name: str, images: Sequence[U8], board: Checkerboard) -> CameraCalibration:
    """Calibrate from pictures uint8 (H, W) of one size; raises BadInputError that says what the pictures lack."""
    shapes = {image.shape for image in images}
    if len(shapes) != 1:
        raise BadInputError(f"{len(images)} pictures of {len(shapes)} sizes; all must have the same")
    height, width = shapes.pop()
    found = [(k, find_checkerboard(image, board)) for k, image in enumerate(images)]
    seen = [(k, corners) for k, corners in found if corners is not None]
    if len(seen) < PICTURES:
        raise BadInputError(
            f"the board of {board.columns} x {board.rows} corners was found in {len(seen)} of {len(images)} pictures; {PICTURES} are needed"
        )
    together = np.concatenate([corners for _, corners in seen])
    span = np.ptp(together, axis=0) / (width, height)
    if float(span[0] * span[1]) < COVERED:
        raise BadInputError("the board was shown in one part of the picture only; show it at the rims too")
    points = [board.points()] * len(seen)
    corners_px = [corners.astype(np.float32).reshape(-1, 1, 2) for _, corners in seen]
    error, matrix, distortion, _, _, sigmas, _, _ = cv2.calibrateCameraExtended(
        points, corners_px, (int(width), int(height)), np.eye(3), np.zeros(5)
    )
    sigma = float(np.max(np.reshape(sigmas, -1)[:2]))
    if not np.isfinite(matrix).all() or sigma > FOCAL_SHARE * float(matrix[0, 0]):
        raise BadInputError("the pictures do not tell the focal length; tilt the board in different directions")
    k1, k2, p1, p2, k3 = (float(v) for v in np.reshape(distortion, -1)[:5])
    camera = CameraModel(
        name, int(width), int(height), float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]),
        (k1, k2, p1, p2, k3),
    )  # fmt: skip
    return CameraCalibration(camera, float(error), sigma, tuple(k for k, _ in seen))
