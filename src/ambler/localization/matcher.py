"""Matches points to the surfaces of a map and says honestly how much the match is worth.

Errors of a scan have two parts: noise, independent from beam to beam, and errors of the map, which all beams on one stretch of
wall share. Both variances are estimated from the residuals of the match itself (variance components over wall patches).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.kernels import grid_tracker as kernel
from ambler.localization.surface_map import SurfaceMap

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

CLEARLY = 0.03  # robust cost per point: three of a hundred returns that one pose explains and another does not
THING_GAP = 0.3  # metres between returns that follow each other in a scan and are of one thing
THING_MOST = 1.0  # metres: a person, a chair, a box; walls are larger
THING_LEAST = 5  # returns
THING_TELLS = 0.5  # of its returns: faces of a small thing look into all directions
WEAK_RATIO = 0.2  # of what a scan tells of its weakest direction to its strongest: above it walls tell both
MAP_PRIOR = 3.0  # stretches of wall that the belief about the map's errors is worth before anything was seen
MAP_MEMORY = 100.0  # stretches of wall that are remembered
MAP_NOISE_LEAST = 0.0005  # metres
MAP_DOUBT = 2.1  # walls of one map err together (all drawn too thick, say) by more than residuals can show


@dataclass(frozen=True, slots=True)
class MatcherConfig:
    """`max_points` are used per scan; `first_scale`, `last_scale` widths of the robust loss (m); a direction is determined when its
    eigenvalue is `min_ratio` of the largest and worth `min_weight` points; `patch` length of wall that shares an error;
    `noise`, `map_noise` what is believed of scanner and map before the residuals speak (m, cells)."""

    max_points: int = 360
    iterations: int = 12
    first_scale: float = 0.3
    last_scale: float = 0.05
    min_ratio: float = 0.01
    min_weight: float = 3.0
    patch: float = 3.0
    noise: float = 0.01
    map_noise_cells: float = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class MatchResult:
    """Solution `state` float64 (4,) (x, y, yaw, depth); `score` share of explained points; `cost` robust cost per point (0 to 1);
    `determined` directions of the pose (0 to 3). `normal` (4, 4) is sum w J J^T without the undetermined directions, `full` with
    them, `shared` the sum over stretches of wall; `noise`, `map_noise` variances (m²); `lever` metres that a radian is worth."""

    state: F64
    score: float
    cost: float
    determined: int
    normal: F64
    full: F64
    shared: F64
    noise: float
    map_noise: float
    lever: float

    @property
    def map_from_base(self) -> SE2:
        return SE2.from_array(self.state[:3])

    def information(self) -> F64:
        """Return the information float64 (4, 4) of the solution, none in the undetermined directions."""
        spread = self.noise * self.full + self.map_noise * self.shared
        spread += (1e-9 * np.trace(spread) + 1e-15) * np.eye(4)
        information = self.full @ np.linalg.solve(spread, self.full)
        for unknown in self._undetermined():
            told = information @ unknown
            worth = float(unknown @ told)
            if worth > 1e-9 * np.trace(information):
                information -= np.outer(told, told) / worth
        return np.asarray(0.5 * (information + information.T))

    def _undetermined(self) -> list[F64]:
        """Return the directions float64 (4,) of the state that `normal` lacks."""
        scale = np.array([1.0, 1.0, self.lever])
        values, vectors = np.linalg.eigh(self.normal[:3, :3] / np.outer(scale, scale))
        floor = 1e-9 * max(float(values[-1]), 1e-12)
        return [np.append(v / scale, 0.0) for value, v in zip(values, vectors.T, strict=True) if value <= floor]

    def map_covariance(self) -> F64:
        """Return the covariance float64 (4, 4) that the map's errors cause; more scans from the same place do not lessen it."""
        scale = np.array([1.0, 1.0, self.lever, 1.0])
        inverse = np.linalg.pinv(self.normal / np.outer(scale, scale), rcond=1e-6, hermitian=True) / np.outer(
            scale, scale
        )
        return np.asarray(self.map_noise * inverse @ self.shared @ inverse)


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """A match fused with a prediction: `state` float64 (4,), its filter `covariance` (4, 4); `published` covariance (3, 3) of the pose,
    in which averaging over scans does not lessen the map's errors; `surprise` squared Mahalanobis distance per direction."""

    state: F64
    covariance: F64
    published: F64
    surprise: float

    @property
    def map_from_base(self) -> SE2:
        return SE2(float(self.state[0]), float(self.state[1]), wrap_angle(float(self.state[2])))


def fuse(predicted: F64, covariance: F64, match: MatchResult) -> Fusion:
    """Fuse a predicted state float64 (4,) and its `covariance` (4, 4) with a match; undetermined directions stay predicted.

    Kalman update in information form: S^-1 = (P + Lambda^-1)^-1 = Lambda (I + P Lambda)^-1 also for singular Lambda.
    """
    innovation = match.state - predicted
    innovation[2] = wrap_angle(float(innovation[2]))
    information = match.information()
    shrink = np.linalg.inv(np.eye(4) + covariance @ information)
    surprise = float(innovation @ information @ shrink @ innovation) / max(match.determined, 1)
    posterior = shrink @ covariance
    posterior = 0.5 * (posterior + posterior.T)
    gain = posterior @ information
    # The depth is never surer than the map's own errors on a handful of walls allow.
    posterior[3, 3] = max(posterior[3, 3], match.map_noise / 6.0)
    kept = np.eye(4) - gain
    published = (posterior + kept @ match.map_covariance() @ kept.T)[:3, :3]
    return Fusion(predicted + gain @ innovation, posterior, published, surprise)


class ScanMatcher:
    """Matches against one map; holds scratch arrays, so one instance serves one caller at a time."""

    def __init__(self, surface_map: SurfaceMap, config: MatcherConfig) -> None:
        self.map = surface_map
        self.config = config
        self._sums = np.empty((2, 512, 6))
        self._map_evidence = MAP_PRIOR * np.array([(config.map_noise_cells * surface_map.spec.resolution) ** 2, 1.0])
        self._last_evidence = np.zeros(2)
        self._work, self._vectors, self._values = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)

    def thin(self, points: F32) -> F32:
        """Return at most `max_points` evenly chosen points as a new writeable array; rows that are not finite are dropped."""
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > self.config.max_points:
            points = points[np.linspace(0, len(points) - 1, self.config.max_points).astype(np.int64)]
        return np.array(points, np.float32, order="C")

    def descend(self, points: F32, start: F64, stiffness: F64, first_scale: float) -> tuple[F64, float, int, F64, F64]:
        """Return (state, cost, determined, H, info) of one descent from `start` float64 (4,)."""
        config = self.config
        state, h, g, info = start.copy(), np.empty((4, 4)), np.empty(4), np.empty(4)
        determined = kernel.descend(
            self.map.nearest,
            self.map.surfaces,
            self.map.frame,
            points,
            state,
            start,
            stiffness,
            np.array([first_scale, config.last_scale]),
            self._limits(points),
            config.iterations,
            h,
            g,
            info,
        )
        return state, float(info[0]), determined, h, info

    def match(self, points: F32, starts: F64, depth_variance: float, first_scale: float | None = None) -> MatchResult:
        """Match from every row of `starts` float64 (K, 4) and return the best; `points` come from `thin`.

        The depth is held near each start with `depth_variance` (m²), which matters where only one side of the room is seen.
        Where one small thing tells most of a direction, it is left out: somebody who stood there when the map was made, stands there again and walks off
        takes every match with him, along a corridor of which nothing else tells how far along it the robot is.
        """
        result = self._match(points, starts, depth_variance, first_scale)
        others = self.without_lone_thing(points, result)
        return result if others is points else self._match(others, starts, depth_variance, first_scale)

    def _match(self, points: F32, starts: F64, depth_variance: float, first_scale: float | None) -> MatchResult:
        config = self.config
        stiffness = np.array([1e-3, 1e-3, 1e-3, config.noise**2 / max(depth_variance, 1e-8)])
        scale = config.first_scale if first_scale is None else first_scale
        best = self.descend(points, starts[0], stiffness, scale)
        for k in range(1, len(starts)):
            other = self.descend(points, starts[k], stiffness, scale)
            if other[1] < best[1] - 1e-9:
                best = other
        state, cost, _, h, info = best
        shared, noise, map_noise = self._variances(points, state)
        normal, g = h.copy(), np.zeros(4)
        lever, ratio, weight = self._limits(points)
        determined = kernel.project(normal, g, lever, ratio, weight, self._work, self._values, self._vectors)
        score = float(info[3]) / max(len(points), 1)
        return MatchResult(state, score, cost, determined, normal, h, shared, noise, map_noise, lever)

    def explains_more(self, match: MatchResult, state: F64, points: F32) -> bool:
        """Say whether a match explains clearly more of the points, which come from `thin`, than `state` float64 (4,) does."""
        return self._cost(points, state) - match.cost >= CLEARLY

    def without_lone_thing(self, points: F32, match: MatchResult) -> F32:
        """Return the points, which come from `thin`, without the small thing that could tell more than all others of the direction of which a match tells least;
        themselves where there is none."""
        scale = np.array([1.0, 1.0, match.lever])
        values, vectors = np.linalg.eigh(match.full[:3, :3] / np.outer(scale, scale))
        if values[0] > WEAK_RATIO * values[-1]:
            return points
        begin, end = max(_small_things(points), key=lambda rows: rows[1] - rows[0], default=(0, 0))
        others, weakest = np.concatenate((points[:begin], points[end:])), vectors[:, 0] / scale
        told = self._accumulated(others, match.state)[0][:3, :3]
        return others if THING_TELLS * (end - begin) > weakest @ told @ weakest else points

    def _cost(self, points: F32, state: F64) -> float:
        """Return the robust cost per point of a state float64 (4,)."""
        return float(self._accumulated(points, state)[1][0])

    def _accumulated(self, points: F32, state: F64) -> tuple[F64, F64]:
        """Return sum w J J^T (4, 4) of a state float64 (4,), and what the kernel `accumulate` tells beside it (4,)."""
        scale, h, info = self.config.last_scale, np.empty((4, 4)), np.empty(4)
        kernel.accumulate(
            self.map.nearest,
            self.map.surfaces,
            self.map.frame,
            points,
            state,
            scale,
            4.0 * scale,
            h,
            np.empty(4),
            info,
        )
        return h, info

    def _limits(self, points: F32) -> F64:
        lever = float(np.sqrt(np.mean(np.square(points).sum(axis=1)))) if len(points) else 1.0
        return np.array([max(lever, 0.5), self.config.min_ratio, self.config.min_weight])

    def learn(self, novelty: float) -> None:
        """Remember what the last match told of the map's errors, with the weight of what was new in it (0 to 1)."""
        evidence = self._map_evidence + novelty * self._last_evidence
        self._map_evidence = evidence * min(1.0, MAP_MEMORY / evidence[1])

    def _variances(self, points: F32, state: F64) -> tuple[F64, float, float]:
        """Estimate the variances of noise and map from the residuals of this match and what earlier ones told of the map."""
        config = self.config
        shared, totals = np.empty((4, 4)), np.empty(7)
        kernel.patch_statistics(
            self.map.nearest,
            self.map.surfaces,
            self.map.frame,
            points,
            state,
            config.last_scale,
            config.patch,
            self._sums,
            shared,
            totals,
        )
        walls, patches, trust, between, inverse, within, weight = totals.tolist()
        noise = (within + 20.0 * config.noise**2) / (max(weight - patches, 0.0) + 20.0)
        # The fit of four unknowns takes errors away, most from the walls that weigh most.
        freedom = trust * (max(walls - 4.0, 0.0) / max(walls, 1.0)) ** 2
        self._last_evidence = np.array([between - noise * inverse, freedom]) if freedom > 0.0 else np.zeros(2)
        squares, weights = self._map_evidence + self._last_evidence
        return shared, float(noise), max(MAP_DOUBT * float(squares / weights), MAP_NOISE_LEAST**2)


def _small_things(points: F32) -> list[tuple[int, int]]:
    """Return the first and last row (exclusive) of each run of returns (N, 2), in the order of a scan, that is no larger than a thing which may move."""
    bounds = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > THING_GAP) + 1
    runs = zip([0, *bounds.tolist()], [*bounds.tolist(), len(points)], strict=True)
    return [
        (begin, end)
        for begin, end in runs
        if end - begin >= THING_LEAST and np.hypot(*np.ptp(points[begin:end], axis=0)) <= THING_MOST
    ]
