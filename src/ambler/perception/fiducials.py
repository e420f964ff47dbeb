"""Square markers (ArUco, AprilTag) in pictures: found by OpenCV, corners from edges, both planar poses compared.

A square seen from afar looks nearly the same from two sides: IPPE gives both poses. Each is refined with the corners' covariance;
the one that fits the picture and the prior better is taken, and the detection says when nothing could decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import CameraModel, MarkerDetection, MarkerSpec
from ambler.core.errors import BadInputError
from ambler.core.se3 import SE3, quaternion_multiply
from ambler.perception.marker_edges import EdgeConfig, refine_corners
from ambler.registration.corner_pose import CornerPose, fit_corner_pose

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class FiducialConfig:
    """`side_px`: markers smaller than this in the picture are left out. `decided`: difference of the two poses' errors (chi-squared)
    from which the choice is no guess. `prior_angle`: standard deviation of a prior's direction (rad). `edges`: of the four, how
    many must have been fitted. `error_px`: largest mean distance of the reprojected corners."""

    side_px: float = 16.0
    decided: float = 12.0
    prior_angle: float = math.radians(6.0)
    edges: int = 3
    error_px: float = 1.5
    edge: EdgeConfig = field(default_factory=EdgeConfig)


class FiducialDetector:
    """Finds the given markers; a `MarkerFinder`. Markers that were not told are ignored: their size is unknown."""

    def __init__(
        self, camera: CameraModel, markers: Sequence[MarkerSpec], config: FiducialConfig | None = None
    ) -> None:
        self.camera = camera
        self.config = config if config is not None else FiducialConfig()
        self._markers = {(m.dictionary, m.number): m for m in markers}
        if len(self._markers) < len(markers):
            raise BadInputError("a marker is told twice")
        self._detectors = {d: _detector(d) for d in sorted({m.dictionary for m in markers})}

    @property
    def shift_px(self) -> float:
        """How far edges are taken to have moved outwards (px)."""
        return self.config.edge.shift_px

    def with_shift(self, shift_px: float) -> FiducialDetector:
        """Return the same detector with a calibrated shift of edges (`calibration.range_bias`)."""
        config = replace(self.config, edge=replace(self.config.edge, shift_px=shift_px))
        return FiducialDetector(self.camera, list(self._markers.values()), config)

    def detect(self, image: U8, priors: Mapping[str, SE3] | None = None) -> tuple[MarkerDetection, ...]:
        """Return the markers in a grey picture uint8 (H, W), in the order of their dictionaries and numbers.

        A marker that is seen twice (a reflection, a copy) is taken only if a prior chooses one of them.
        """
        camera = self.camera
        if image.dtype != np.uint8 or image.shape != (camera.height, camera.width):
            raise BadInputError(
                f"camera {camera.name} gives {camera.width} x {camera.height} grey pictures, this one is {image.shape} {image.dtype}"
            )
        grey = image.astype(np.float32)
        seen: dict[tuple[str, int], list[MarkerDetection]] = {}
        for dictionary, (detector, cells) in self._detectors.items():
            corners, numbers, _ = detector.detectMarkers(image)
            for quad, number in zip(corners, [] if numbers is None else numbers.reshape(-1), strict=True):
                marker = self._markers.get((dictionary, int(number)))
                if marker is None:
                    continue
                prior = None if priors is None else priors.get(marker.name)
                corners_px = np.asarray(quad, np.float64).reshape(4, 2)
                if dictionary.startswith("APRILTAG"):
                    corners_px = np.roll(corners_px, 2, axis=0)  # OpenCV's AprilTags stand on their heads
                detection = self._measure(grey, corners_px, cells, marker, prior)
                if detection is not None:
                    seen.setdefault((dictionary, int(number)), []).append(detection)
        chosen = (_only(seen[key], priors) for key in sorted(seen))
        return tuple(s for s in chosen if s is not None)

    def _measure(
        self, grey: NDArray[np.float32], quad: F64, cells: int, marker: MarkerSpec, prior: SE3 | None
    ) -> MarkerDetection | None:
        sides = np.hypot(*(quad - np.roll(quad, 1, axis=0)).T)
        if float(sides.min()) < self.config.side_px:
            return None
        corners, covariance, fitted = refine_corners(grey, quad, cells, self.camera, self.config.edge)
        if fitted < self.config.edges or float(np.hypot(*(corners - quad).T).max()) > 0.2 * float(sides.max()):
            return None
        focal = np.array([self.camera.fx, self.camera.fy])
        rays = (corners - (self.camera.cx, self.camera.cy)) / focal
        scale = np.tile(1.0 / focal, 4)
        return self._pose(marker, rays, covariance * scale[:, None] * scale[None, :], prior)

    def _pose(self, marker: MarkerSpec, rays: F64, ray_covariance: F64, prior: SE3 | None) -> MarkerDetection | None:
        information: F64 = np.asarray(np.linalg.inv(ray_covariance), np.float64)
        fits: list[CornerPose] = []
        for guess in planar_poses(marker, rays):
            fit = fit_corner_pose(marker.corners(), rays, information, guess)
            if fit is not None and all(angle_between(fit.base_from_target, f.base_from_target) > 0.01 for f in fits):
                fits.append(fit)
        if not fits:
            return None
        fits.sort(key=lambda f: f.error + self._surprise(f, prior))
        best = fits[0]
        other = fits[1] if len(fits) > 1 else None
        gap = math.inf
        if other is not None:
            gap = other.error + self._surprise(other, prior) - best.error - self._surprise(best, prior)
        corners = best.base_from_target.transform(marker.corners())
        error = np.hypot(*((corners[:, :2] / corners[:, 2:] - rays) * (self.camera.fx, self.camera.fy)).T).mean()
        if float(error) > self.config.error_px:
            return None
        return MarkerDetection(
            marker, rays, ray_covariance, best.base_from_target, best.covariance,
            None if other is None else other.base_from_target, gap < self.config.decided, float(error),
        )  # fmt: skip

    def _surprise(self, fit: CornerPose, prior: SE3 | None) -> float:
        if prior is None:
            return 0.0
        return (angle_between(fit.base_from_target, prior) / self.config.prior_angle) ** 2


def planar_poses(marker: MarkerSpec, rays: F64) -> list[SE3]:
    """Return the one or two poses of a square whose corners are seen as rays (4, 2): IPPE (Collins and Bartoli 2014)."""
    found, turns, places, _ = cv2.solvePnPGeneric(
        marker.corners(), rays.reshape(4, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    poses = []
    for k in range(int(found)):
        x, y, z = (float(v) for v in np.reshape(places[k], 3))
        poses.append(SE3((x, y, z), _quaternion(np.reshape(turns[k], 3))))
    return [p for p in poses if math.isfinite(p.translation[2]) and p.translation[2] > 0.0]


def angle_between(a: SE3, b: SE3) -> float:
    """Return the angle between two orientations, radians."""
    w, x, y, z = a.rotation
    q = quaternion_multiply((w, -x, -y, -z), b.rotation)
    return 2.0 * math.atan2(math.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2), abs(q[0]))


def _quaternion(turn: F64) -> tuple[float, float, float, float]:
    angle = float(np.linalg.norm(turn))
    s = 0.5 if angle < 1e-12 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), s * float(turn[0]), s * float(turn[1]), s * float(turn[2])


def _only(detections: list[MarkerDetection], priors: Mapping[str, SE3] | None) -> MarkerDetection | None:
    if len(detections) == 1:
        return detections[0]
    prior = None if priors is None else priors.get(detections[0].marker.name)
    if prior is None:
        return None
    wanted = np.array(prior.translation)
    return min(detections, key=lambda s: float(np.linalg.norm(np.array(s.camera_from_marker.translation) - wanted)))


def _detector(dictionary: str) -> tuple[cv2.aruco.ArucoDetector, int]:
    found = getattr(cv2.aruco, f"DICT_{dictionary}", None)
    if found is None:
        names = sorted(n[5:] for n in dir(cv2.aruco) if n.startswith("DICT_") and n == n.upper())
        raise BadInputError(f"no dictionary of markers {dictionary!r}; there are {', '.join(names)}")
    markers = cv2.aruco.getPredefinedDictionary(found)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    parameters.minMarkerPerimeterRate = 0.02
    return cv2.aruco.ArucoDetector(markers, parameters), int(markers.markerSize) + 2
