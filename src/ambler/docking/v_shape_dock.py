"""A dock by a V in the laser scan: two straight legs that meet in a corner, a notch or a wedge.

Corners are found by splitting the scan where it leaves straight lines (Ramer 1972), and where the dock is expected: near a notch, no scanner
at the side of a robot sees both legs. Each is refined by fitting a line to the points of either leg, whichever scanner took them. The corner is where the lines meet, the dock's direction halves their angle; the covariance follows from the lines'.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2, wrap_angle
from ambler.docking.covariance import difference, through_offset
from ambler.docking.detection import DockDetection, DockObservation, require_numbers
from ambler.docking.dock import Dock

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class VShapeConfig:
    """`gap`: distance between neighbours that belong to different things (m). `split`: distance from a straight line at which it is
    split (m). `angle`, `leg`: how far angle (rad) and length (share) may differ. `noise`: least standard deviation of a
    point (m). `bias`: systematic error of position and yaw (m, rad). `reach`: how far from a prior corners are looked at (m, rad). `bands`: of each round of fitting, how far from the leg points
    may lie at the corner (m) and more per metre. `same`: corners nearer than this are one (m)."""

    gap: float = 0.15
    split: float = 0.025
    angle: float = math.radians(8.0)
    leg: float = 0.35
    points: int = 6
    noise: float = 0.002
    bias: tuple[float, float] = (0.0015, math.radians(0.1))
    reach: tuple[float, float] = (0.5, math.radians(25.0))
    bands: tuple[tuple[float, float], ...] = ((0.04, 0.05), (0.03, 0.03), (0.03, 0.03))
    same: float = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Corner:
    """Where a V may be: its corner and the unit directions of its legs, float64 (2,)."""

    at: F64
    one: F64
    two: F64


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A fitted line: middle and unit direction away from the corner, float64 (2,), standard deviations across it (m) and of its angle."""

    middle: F64
    direction: F64
    sigma: float
    angle_sigma: float
    length: float


class VShapeDockDetector:
    """A `DockDetector` by a planar scan."""

    def __init__(self, dock: Dock, config: VShapeConfig | None = None) -> None:
        if dock.v_shape is None:
            raise BadInputError(f"dock {dock.name} has no V shape")
        self._dock = dock
        self._v = dock.v_shape
        self._config = config if config is not None else VShapeConfig()

    def detect(self, observation: DockObservation, prior: SE2 | None = None) -> DockDetection | None:
        """Return the dock; None when no corner fits, or several do and no prior tells which."""
        points = observation.points_base
        if points is None or not require_numbers(observation):
            return None
        to_dock = self._v.dock_from_corner.inverse() @ self._dock.offset
        if prior is not None:
            at = (prior @ to_dock.inverse()).as_array()[:2]
            points = points[np.hypot(*(points - at).T) < self._config.reach[0] + 1.5 * self._v.leg]
            fit = self._fit(points, self._expected(prior @ to_dock.inverse()))
            if fit is not None and prior.distance_to(fit[0] @ to_dock) < self._config.same:
                return self._detection(observation.stamp_ns, fit, to_dock)
        found: list[tuple[SE2, F64]] = []
        for corner in self._corners(points):
            fit = self._fit(points, corner)
            if fit is None or any(fit[0].distance_to(f[0]) < self._config.same for f in found):
                continue
            if prior is None or self._is_near(prior, fit[0] @ to_dock):
                found.append(fit)
        if not found or (prior is None and len(found) > 1):
            return None
        best = min(found, key=lambda f: 0.0 if prior is None else prior.distance_to(f[0] @ to_dock))
        return self._detection(observation.stamp_ns, best, to_dock)

    def _detection(self, stamp_ns: int, fit: tuple[SE2, F64], to_dock: SE2) -> DockDetection:
        return DockDetection(stamp_ns, "v_shape", fit[0] @ to_dock, through_offset(fit[1], to_dock), 2)

    def _is_near(self, prior: SE2, pose: SE2) -> bool:
        d = difference(prior, pose)
        return math.hypot(d[0], d[1]) < self._config.reach[0] and abs(d[2]) < self._config.reach[1]

    def _expected(self, base_from_corner: SE2) -> Corner:
        """Return the corner with its legs where a prior has them."""
        half = math.pi - 0.5 * self._v.angle
        yaws = (base_from_corner.yaw + half, base_from_corner.yaw - half)
        one, two = (np.array([math.cos(yaw), math.sin(yaw)]) for yaw in yaws)
        return Corner(np.array([base_from_corner.x, base_from_corner.y]), one, two)

    def _corners(self, points: F64) -> list[Corner]:
        """Return where the scans bend; each scanner by itself."""
        step = np.hypot(*np.diff(points, axis=0).T)
        groups = np.split(np.arange(len(points)), np.flatnonzero(step > self._config.gap) + 1)
        corners = []
        for group in groups:
            if len(group) < 2 * self._config.points:
                continue
            run = points[group]
            bends = (self._sides(run, k) for k in _bends(run, 0, len(run) - 1, self._config.split))
            corners += [corner for corner in bends if corner is not None]
        return corners

    def _fit(self, points: F64, corner: Corner) -> tuple[SE2, F64] | None:
        """Return `base_from_corner` and its covariance (3, 3), or None when the legs are not those of the dock."""
        at, sides = corner.at, (corner.one, corner.two)
        legs: tuple[Leg, Leg] | None = None
        for band in self._config.bands:
            one, two = (self._leg(points, at, side, band) for side in sides)
            if one is None or two is None:
                return None
            cross = float(one.direction[0] * two.direction[1] - one.direction[1] * two.direction[0])
            if abs(cross) < 0.1:
                return None
            legs, at, sides = (one, two), _meet(one, two), (one.direction, two.direction)
        return None if legs is None else self._judge(*legs, at)

    def _sides(self, run: F64, k: int) -> Corner | None:
        """Return the corner at a bend with first directions of its legs: to the mean of the points before and after it in the order of the
        beams."""
        corner = run[k]
        away = np.hypot(*(run - corner).T)
        near = np.flatnonzero((away < self._v.leg) & (away > 0.15 * self._v.leg))
        before, after = near[near < k], near[near > k]
        if min(len(before), len(after)) < self._config.points // 2:
            return None
        a, b = run[before].mean(axis=0) - corner, run[after].mean(axis=0) - corner
        return Corner(corner, a / np.hypot(*a), b / np.hypot(*b))

    def _leg(self, points: F64, corner: F64, direction: F64, band: tuple[float, float]) -> Leg | None:
        d = points - corner
        along, across = d @ direction, direction[0] * d[:, 1] - direction[1] * d[:, 0]
        keep = (
            (along > 0.12 * self._v.leg) & (along < 0.92 * self._v.leg) & (np.abs(across) < band[0] + band[1] * along)
        )
        if int(keep.sum()) < self._config.points:
            return None
        for _ in range(2):
            part = points[keep]
            middle = part.mean(axis=0)
            _, values, axes = np.linalg.svd(part - middle, full_matrices=False)
            turned = axes[0] if float(axes[0] @ direction) > 0.0 else -axes[0]
            sigma = max(self._config.noise, float(values[1]) / math.sqrt(max(1, len(part) - 2)))
            off = np.abs((points - middle) @ np.array([-turned[1], turned[0]]))
            along = (points - corner) @ turned
            keep &= off < 3.0 * sigma + 1e-9
            if int(keep.sum()) < self._config.points:
                return None
        length = float(np.quantile(along[keep], 0.98))
        return Leg(middle, turned, sigma / math.sqrt(len(part)), sigma / max(1e-9, float(values[0])), length)

    def _judge(self, one: Leg, two: Leg, corner: F64) -> tuple[SE2, F64] | None:
        between = math.acos(float(np.clip(one.direction @ two.direction, -1.0, 1.0)))
        halving = one.direction + two.direction
        opens = float(halving @ -corner) > 0.0  # towards the scanner: a notch
        angle = between if opens else 2.0 * math.pi - between
        if abs(angle - self._v.angle) > self._config.angle:
            return None
        if min(one.length, two.length) < (1.0 - self._config.leg) * self._v.leg:
            return None
        into = -halving if opens else halving
        yaw = math.atan2(float(into[1]), float(into[0]))
        normals = np.array([[-leg.direction[1], leg.direction[0]] for leg in (one, two)])
        inverse = np.linalg.inv(normals)
        # Across a line at the corner: its offset, and its angle times the way from its middle.
        ways = [float(leg.direction @ (corner - leg.middle)) for leg in (one, two)]
        jacobian = np.zeros((3, 4))
        for k in range(2):
            jacobian[:2, 2 * k], jacobian[:2, 2 * k + 1] = inverse[:, k], inverse[:, k] * ways[k]
            jacobian[2, 2 * k + 1] = 0.5
        spread = np.array([one.sigma, one.angle_sigma, two.sigma, two.angle_sigma])
        covariance = jacobian @ np.diag(spread**2) @ jacobian.T
        turn = np.eye(3)
        turn[:2, :2] = [[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]]
        place, angle_bias = self._config.bias
        covariance = turn @ covariance @ turn.T + np.diag([place, place, angle_bias]) ** 2
        return SE2(float(corner[0]), float(corner[1]), wrap_angle(yaw)), covariance


def _meet(one: Leg, two: Leg) -> F64:
    normals = np.array([[-leg.direction[1], leg.direction[0]] for leg in (one, two)])
    return np.asarray(np.linalg.solve(normals, [normals[0] @ one.middle, normals[1] @ two.middle]))


def _bends(points: F64, first: int, last: int, split: float) -> list[int]:
    """Return the indices at which a stretch of a scan must be bent to follow its points."""
    if last - first < 2:
        return []
    a, b = points[first], points[last]
    length = float(np.hypot(*(b - a)))
    d = points[first : last + 1] - a
    if length < 1e-6:
        off = np.hypot(d[:, 0], d[:, 1])
    else:
        off = np.abs(d[:, 0] * (b[1] - a[1]) - d[:, 1] * (b[0] - a[0])) / length
    k = first + int(np.argmax(off))
    if float(off.max()) < split or k in (first, last):
        return []
    return [*_bends(points, first, k, split), k, *_bends(points, k, last, split)]
