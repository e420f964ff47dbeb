"""Cameras and flat markers: the pinhole model with the distortion of ROS, and what a camera says about a marker.

Pixel centres lie at whole numbers, so the middle of a picture of width W is (W - 1) / 2. The camera frame is optical: z forward,
x to the right, y down. A marker's frame: x to the right and y up as one looks at its face, z out of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A pinhole camera, focal lengths and centre in pixels. `distortion` is (k1, k2, p1, p2, k3), ROS's `plumb_bob`, or with
    (k4, k5, k6) after it, `rational_polynomial`."""

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if len(self.distortion) not in (5, 8):
            raise ValueError("a camera has 5 or 8 coefficients of distortion")

    @property
    def matrix(self) -> F64:
        """The intrinsic matrix, float64 (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def distort(self, rays: F64) -> F64:
        """Map rays (N, 2), x / z and y / z in the camera frame, to pixels float64 (N, 2)."""
        k1, k2, p1, p2, k3, k4, k5, k6 = (*self.distortion, 0.0, 0.0, 0.0)[:8]
        x, y = rays[:, 0], rays[:, 1]
        r2 = x * x + y * y
        radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        out = np.empty_like(rays)
        out[:, 0] = self.fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + self.cx
        out[:, 1] = self.fy * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) + self.cy
        return out

    def project(self, points_camera: NDArray[np.floating]) -> F64:
        """Map points (N, 3) before the camera to pixels float64 (N, 2)."""
        points = np.asarray(points_camera, np.float64)
        return self.distort(points[:, :2] / points[:, 2:])

    def undistort(self, pixels: NDArray[np.floating]) -> F64:
        """Map pixels (N, 2) to rays float64 (N, 2), the inverse of `distort`, by fixed-point iteration."""
        plain = (np.asarray(pixels, np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)
        rays = plain.copy()
        for _ in range(40):
            error = (self.distort(rays) - (self.cx, self.cy)) / (self.fx, self.fy) - plain
            rays -= error
            if float(np.abs(error).max(initial=0.0)) < 1e-10:
                break
        return rays


@dataclass(frozen=True, slots=True)
class MarkerSpec:
    """A printed square marker: its dictionary (as in OpenCV, without DICT_), number, and the side of its black square in metres."""

    dictionary: str
    number: int
    size: float

    @property
    def name(self) -> str:
        """The name of its frame."""
        return f"marker_{self.number}"

    def corners(self) -> F64:
        """The corners in the marker's frame, float64 (4, 3): upper left, upper right, lower right, lower left."""
        h = 0.5 * self.size
        return np.array([[-h, h, 0.0], [h, h, 0.0], [h, -h, 0.0], [-h, -h, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class MarkerDetection:
    """A marker in a picture. `rays` float64 (4, 2) are its corners without distortion, `ray_covariance` (8, 8) theirs, corner by corner.
    A flat square seen from afar fits two poses: `other` is the one that was not chosen, None when there is none; the choice is
    `is_ambiguous` when neither the picture nor a prior decides it. `covariance` (6, 6) is that of `camera_from_marker`."""

    marker: MarkerSpec
    rays: F64
    ray_covariance: F64
    camera_from_marker: SE3
    covariance: F64
    other: SE3 | None
    is_ambiguous: bool
    error_px: float


class MarkerFinder(Protocol):
    """Finds known markers in grey pictures."""

    def detect(self, image: U8, priors: Mapping[str, SE3] | None = None) -> tuple[MarkerDetection, ...]:
        """Return what is seen in a picture uint8 (H, W). `priors` are expected poses in the camera frame by the marker's name; they
        choose between the two solutions."""
        ...
