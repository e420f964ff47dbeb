"""A dock by its markers: one pose of the dock is fitted to all corners of all markers at once.

Robot and dock stand on one floor, which fixes height, roll and pitch nearly; what is left is the plane, and several markers
far apart tell its yaw better than any single one. Every marker offers one or two first guesses (the planar ambiguity); all are
fitted, and picture, level and prior choose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.camera import MarkerDetection, MarkerFinder
from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.docking.covariance import difference, through_offset
from ambler.docking.detection import DockDetection, DockObservation
from ambler.docking.dock import Dock, DockMarker
from ambler.registration.corner_pose import CornerPose, LevelPrior, fit_corner_pose

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MarkerDockConfig:
    """`place` (m), `turn` (rad), `size` (share): how exactly markers hang where the dock says, turned as it says, and are printed as large as it says;
    the standard deviations of ± 1 mm, ± 0.3° and ± 0.3 %, to which people hang and print them. `prior`: standard deviations (m, rad) of the expected pose, which only
    chooses. `lens`: standard deviation of its two focal lengths, of ± 0.3 % (the principal point moves all markers alike). `surprise`: chi-squared per corner coordinate
    from which a marker does not fit the others, as far as place, turn, size and lens can be off. `guess`: share of belief
    in the second pose from which, when the two are `apart` (rad), nothing is said."""

    place: float = 0.0006
    turn: float = math.radians(0.17)
    size: float = 0.0017
    lens: float = 0.0017
    prior: tuple[float, float] = (0.15, math.radians(4.0))
    surprise: float = 9.0
    guess: float = 0.01
    apart: float = math.radians(6.0)
    level: LevelPrior = field(default_factory=LevelPrior)


class MarkerDockDetector:
    """A `DockDetector` by a camera."""

    def __init__(
        self, dock: Dock, finder: MarkerFinder, base_from_camera: SE3, config: MarkerDockConfig | None = None
    ) -> None:
        if not dock.markers:
            raise BadInputError(f"dock {dock.name} has no markers")
        self._dock = dock
        self._finder = finder
        self._base_from_camera = base_from_camera
        self._camera_from_base = base_from_camera.inverse()
        self._config = config if config is not None else MarkerDockConfig()
        self._markers = {m.spec: m for m in dock.markers}

    def detect(self, observation: DockObservation, prior: SE2 | None = None) -> DockDetection | None:
        """Return the dock as the picture shows it; None without a picture, a marker, or a decision between two poses."""
        if observation.image is None:
            return None
        seen = [
            s for s in self._finder.detect(observation.image, self._marker_priors(prior)) if s.marker in self._markers
        ]
        expected = None if prior is None else prior @ self._dock.offset.inverse()
        while seen:
            fits = self._fits(seen, expected)
            if not fits:
                return None
            worst = self._misfit(seen, fits[0][0].base_from_target)
            if worst is None:
                return self._detection(observation.stamp_ns, fits, len(seen))
            if len(seen) <= 2:
                return (
                    None  # two markers contradict each other, or one contradicts the floor: neither is right for sure
                )
            del seen[worst]
        return None

    def _marker_priors(self, prior: SE2 | None) -> dict[str, SE3] | None:
        if prior is None:
            return None
        camera_from_dock = self._camera_from_base @ SE3.from_se2(prior @ self._dock.offset.inverse())
        return {m.spec.name: camera_from_dock @ m.dock_from_marker for m in self._dock.markers}

    def _fits(self, seen: Sequence[MarkerDetection], expected: SE2 | None) -> list[tuple[CornerPose, float]]:
        """Return the distinct fits and their costs, the best first."""
        markers = [self._markers[s.marker] for s in seen]
        points = np.concatenate([m.dock_from_marker.transform(m.spec.corners()) for m in markers])
        rays = np.concatenate([s.rays for s in seen])
        information = np.zeros((2 * len(rays), 2 * len(rays)))
        for k, s in enumerate(seen):
            block = slice(8 * k, 8 * k + 8)
            information[block, block] = np.linalg.inv(self._ray_covariance(s))
        fits: list[tuple[CornerPose, float]] = []
        for guess in self._guesses(seen, markers):
            fit = fit_corner_pose(points, rays, information, guess, self._camera_from_base, self._config.level)
            if fit is None:
                continue
            pose = fit.base_from_target.to_se2()
            if all(np.abs(difference(f.base_from_target.to_se2(), pose)).max() > 0.005 for f, _ in fits):
                fits.append((fit, fit.error + self._surprise(pose, expected)))
        return sorted(fits, key=lambda f: f[1])

    def _guesses(self, seen: Sequence[MarkerDetection], markers: Sequence[DockMarker]) -> list[SE3]:
        out = []
        for s, marker in zip(seen, markers, strict=True):
            poses = [s.camera_from_marker] + ([] if s.other is None else [s.other])
            out += [self._base_from_camera @ pose @ marker.dock_from_marker.inverse() for pose in poses]
        # A level start: the lean of a far marker's pose is mostly noise.
        return [SE3.from_se2(guess.to_se2()) for guess in out]

    def _ray_covariance(self, s: MarkerDetection) -> F64:
        """The corners' covariance, and what becomes of it when the marker hangs, is turned and is printed a little otherwise than told."""
        spread = np.repeat([self._config.place, self._config.turn, self._config.size], (3, 3, 1))
        moved = _moved_rays(s.camera_from_marker, s.marker.corners()) * spread
        return np.asarray(s.ray_covariance + moved @ moved.T)

    def _surprise(self, pose: SE2, expected: SE2 | None) -> float:
        if expected is None:
            return 0.0
        away, turn = self._config.prior
        d = difference(expected, pose)
        return float((d[0] ** 2 + d[1] ** 2) / away**2 + (d[2] / turn) ** 2)

    def _misfit(self, seen: Sequence[MarkerDetection], base_from_dock: SE3) -> int | None:
        """Return the marker that fits worst if it does not fit at all."""
        camera_from_dock = self._camera_from_base @ base_from_dock
        errors = []
        for s in seen:
            marker = self._markers[s.marker]
            corners = (camera_from_dock @ marker.dock_from_marker).transform(marker.spec.corners())
            e = (corners[:, :2] / corners[:, 2:] - s.rays).reshape(-1)
            bent = self._config.lens * _bent_rays(s.rays)
            errors.append(float(e @ np.linalg.solve(self._ray_covariance(s) + bent @ bent.T, e)) / len(e))
        worst = int(np.argmax(errors))
        return worst if errors[worst] > self._config.surprise else None

    def _detection(self, stamp_ns: int, fits: list[tuple[CornerPose, float]], parts: int) -> DockDetection | None:
        best, cost = fits[0]
        pose = best.base_from_target.to_se2()
        covariance = best.covariance[np.ix_((0, 1, 5), (0, 1, 5))].copy()
        for fit, other_cost in fits[1:]:
            belief = 1.0 / (1.0 + math.exp(min(50.0, 0.5 * (other_cost - cost))))
            d = difference(pose, fit.base_from_target.to_se2())
            if abs(float(d[2])) > self._config.apart and belief > self._config.guess:
                return None
            covariance += belief * np.outer(d, d)
        offset = self._dock.offset
        return DockDetection(stamp_ns, "markers", pose @ offset, through_offset(covariance, offset), parts)


def _bent_rays(rays: F64) -> F64:
    """Return the derivative (8, 2) of the rays (4, 2) of a marker's corners by shares of a lens's two focal lengths."""
    out = np.zeros((len(rays), 2, 2))
    out[:, 0, 0], out[:, 1, 1] = rays[:, 0], rays[:, 1]
    return out.reshape(-1, 2)


def _moved_rays(camera_from_marker: SE3, corners: F64) -> F64:
    """Return the derivative (8, 7) of the rays of a marker's corners (4, 3) by its place, its turning (3 each, in its own frame) and its size."""
    turn = camera_from_marker.matrix()[:3, :3]
    seen = camera_from_marker.transform(corners)
    z = seen[:, 2]
    image = np.zeros((len(corners), 2, 3))
    image[:, 0, 0] = image[:, 1, 1] = 1.0 / z
    image[:, 0, 2], image[:, 1, 2] = -seen[:, 0] / z**2, -seen[:, 1] / z**2
    motion = np.zeros((len(corners), 3, 7))
    motion[:, :, :3] = turn
    motion[:, :, 3:6] = np.cross(np.eye(3)[None], corners[:, None, :]).transpose(0, 2, 1)
    motion[:, :, 3:6] = turn @ motion[:, :, 3:6]
    motion[:, :, 6] = corners @ turn.T
    return np.asarray((image @ motion).reshape(-1, 7))
