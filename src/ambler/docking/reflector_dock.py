"""A dock by retro-reflectors: bright returns are matched to the known pattern by their distances, then aligned."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2, wrap_angle
from ambler.docking.covariance import difference, through_offset
from ambler.docking.detection import DockDetection, DockObservation, require_numbers
from ambler.docking.dock import Dock
from ambler.registration.reflectors import DetectorConfig, detect_reflectors

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ReflectorDockConfig:
    """`match`: how far a reflector may lie from where the others say (m). `sigma`: error of one reflector's place (m). `bias`: what no
    alignment is better than (m, rad). `reach`: how far from a prior the dock may be (m, rad). `beyond`: how far beyond its docked pose a robot can be at most (m); one farther in would read the pattern from behind."""

    detector: DetectorConfig = field(default_factory=lambda: DetectorConfig(width=0.05))
    match: float = 0.03
    sigma: float = 0.002
    bias: tuple[float, float] = (0.0015, math.radians(0.1))
    reach: tuple[float, float] = (0.5, math.radians(25.0))
    beyond: float = 0.1


class ReflectorDockDetector:
    """A `DockDetector` by the intensities of a planar scan."""

    def __init__(self, dock: Dock, config: ReflectorDockConfig | None = None) -> None:
        if len(dock.reflectors) < 2:
            raise BadInputError(f"dock {dock.name} has fewer than two reflectors")
        self._dock = dock
        self._config = config if config is not None else ReflectorDockConfig()

    def detect(self, observation: DockObservation, prior: SE2 | None = None) -> DockDetection | None:
        """Return the dock; None when its pattern is not seen, or is seen at several places and no prior tells which."""
        points, intensities = observation.points_base, observation.intensities
        if points is None or intensities is None or not require_numbers(observation):
            return None
        seen = detect_reflectors(points.astype(np.float32), intensities.astype(np.float32), self._config.detector)
        expected = None if prior is None else prior @ self._dock.offset.inverse()
        found = self._matches(seen.centers, expected)
        if not found:
            return None
        most = max(len(pairs) for _, pairs in found)
        best = [(pose, pairs) for pose, pairs in found if len(pairs) == most]
        if len(best) > 1 and expected is None:
            return None
        pose, pairs = min(best, key=lambda f: 0.0 if expected is None else expected.distance_to(f[0]))
        index = np.array(pairs)
        sigma = np.hypot(self._config.sigma, seen.sigmas[index[:, 0]])
        pose, covariance = align(seen.centers[index[:, 0]], self._dock.reflectors[index[:, 1]], sigma)
        place, turn = self._config.bias
        covariance = through_offset(covariance, self._dock.offset) + np.diag([place, place, turn]) ** 2
        return DockDetection(observation.stamp_ns, "reflectors", pose @ self._dock.offset, covariance, most)

    def _matches(self, seen: F64, expected: SE2 | None) -> list[tuple[SE2, list[tuple[int, int]]]]:
        """Return distinct poses of the dock before the robot at which at least two reflectors (all but one of many) fit."""
        known = self._dock.reflectors
        needed = max(2, len(known) - 1) if len(known) > 2 else 2
        found: list[tuple[SE2, list[tuple[int, int]]]] = []
        for a, b in itertools.combinations(range(len(known)), 2):
            length = float(np.hypot(*(known[b] - known[a])))
            for i, j in itertools.permutations(range(len(seen)), 2):
                if abs(float(np.hypot(*(seen[j] - seen[i]))) - length) > self._config.match:
                    continue
                pose, _ = align(seen[[i, j]], known[[a, b]], np.ones(2))
                pairs = self._pairs(seen, pose)
                if len(pairs) < needed or pose.inverse().x > self._config.beyond or not self._is_near(expected, pose):
                    continue
                if all(f.distance_to(pose) > 0.1 or abs(wrap_angle(f.yaw - pose.yaw)) > 0.2 for f, _ in found):
                    found.append((pose, pairs))
        return found

    def _pairs(self, seen: F64, pose: SE2) -> list[tuple[int, int]]:
        wanted = pose.transform(self._dock.reflectors)
        away = np.hypot(*(seen[:, None] - wanted[None]).transpose(2, 0, 1))
        nearest = np.argmin(away, axis=0)
        return [(int(i), k) for k, i in enumerate(nearest) if away[i, k] < self._config.match]

    def _is_near(self, expected: SE2 | None, pose: SE2) -> bool:
        if expected is None:
            return True
        d = difference(expected, pose)
        return math.hypot(d[0], d[1]) < self._config.reach[0] and abs(d[2]) < self._config.reach[1]


def align(points_a: F64, points_b: F64, sigmas: F64) -> tuple[SE2, F64]:
    """Return `a_from_b` that brings points_b (K, 2) onto points_a best, weighted by their sigmas (K,), and its covariance (3, 3)."""
    w = 1.0 / sigmas**2
    middle_a, middle_b = w @ points_a / w.sum(), w @ points_b / w.sum()
    a, b = points_a - middle_a, points_b - middle_b
    dot = float(w @ (a * b).sum(axis=1))
    cross = float(w @ (b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]))
    turn = SE2(0.0, 0.0, math.atan2(cross, dot))
    place = middle_a - turn.transform(middle_b[None])[0]
    jacobian = np.zeros((len(points_b), 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -points_b[:, 1], points_b[:, 0]
    information = np.einsum("k,kia,kib->ab", w, jacobian, jacobian)
    return SE2(float(place[0]), float(place[1]), turn.yaw), np.asarray(np.linalg.inv(information))
