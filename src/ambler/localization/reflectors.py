"""Retro-reflectors, found in scans by `registration.reflectors`: kept in a surveyed or learned map, recognized without a prior pose.

Source of the idea: laser-target navigation, triangulated in the plane.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class ReflectorMap:
    """Positions float64 (M, 2) in the map frame and their standard deviations (M,), metres."""

    positions: F64
    sigmas: F64

    @classmethod
    def surveyed(cls, positions: F64, sigma: float = 0.003) -> ReflectorMap:
        """Build from measured positions (M, 2)."""
        positions = np.array(positions, float).reshape(-1, 2)
        if not np.isfinite(positions).all():
            raise BadInputError("a reflector's position is not finite")
        return cls(positions, np.full(len(positions), sigma))


class ReflectorSurvey:
    """Learns a reflector map while another localizer knows the pose: means weighted by certainty, seen at least `least_views` times."""

    def __init__(self, join: float = 0.3, least_views: int = 5, sigma: float = 0.02) -> None:
        self._join, self._least_views, self._sigma = join, least_views, sigma
        self._positions = np.empty((0, 2))
        self._weights = np.empty(0)
        self._views = np.empty(0, np.int64)

    def add(self, reflectors_base: F64, map_from_base: SE2, covariance: F64) -> None:
        """Take the reflectors (K, 2) seen from a pose with its covariance (3, 3)."""
        for point, seen in zip(map_from_base.transform(reflectors_base), reflectors_base, strict=True):
            far2 = float(seen @ seen)
            variance = self._sigma**2 + 0.5 * float(covariance[0, 0] + covariance[1, 1]) + far2 * covariance[2, 2]
            distances = np.hypot(*(self._positions - point).T)
            k = int(np.argmin(distances)) if len(distances) else -1
            if k < 0 or distances[k] > self._join:
                self._positions = np.vstack([self._positions, point])
                self._weights = np.append(self._weights, 1.0 / variance)
                self._views = np.append(self._views, 1)
                continue
            total = self._weights[k] + 1.0 / variance
            self._positions[k] += (point - self._positions[k]) / variance / total
            self._weights[k] = total
            self._views[k] += 1

    def result(self) -> ReflectorMap:
        """Return the reflectors seen often enough; one view's errors repeat, so no position is told better than 2 mm."""
        keep = self._views >= self._least_views
        sigmas = np.maximum(1.0 / np.sqrt(self._weights[keep]), 0.002)
        return ReflectorMap(self._positions[keep].copy(), sigmas)


@dataclass(frozen=True, slots=True, eq=False)
class Recognition:
    """A pose at which `matched` reflectors fit, or None with the reason in `text` (too few, none, or several places fit)."""

    map_from_base: SE2 | None
    matched: int
    text: str


def recognize(reflectors_base: F64, reflector_map: ReflectorMap, tolerance: float = 0.08) -> Recognition:
    """Find the pose without a prior: pairs of reflectors with equal distances, counted by how many others then fit."""
    seen, known = reflectors_base, reflector_map.positions
    if len(seen) < 3 or len(known) < 3:
        return Recognition(None, 0, f"{len(seen)} reflectors seen, {len(known)} known; three are needed")
    pairs = sorted(
        itertools.combinations(range(len(seen)), 2), key=lambda p: -float(np.hypot(*(seen[p[0]] - seen[p[1]])))
    )[:8]
    between = np.hypot(*(known[:, None] - known[None]).transpose(2, 0, 1))
    found: list[tuple[int, float, SE2]] = []
    for i, j in pairs:
        step = seen[j] - seen[i]
        for a, b in np.argwhere(np.abs(between - np.hypot(*step)) < tolerance).tolist():
            if a == b:
                continue
            far = known[b] - known[a]
            yaw = math.atan2(far[1], far[0]) - math.atan2(step[1], step[0])
            turned = SE2(0.0, 0.0, yaw).transform((0.5 * (seen[i] + seen[j]))[None])[0]
            middle = 0.5 * (known[a] + known[b]) - turned
            pose = SE2(float(middle[0]), float(middle[1]), math.atan2(math.sin(yaw), math.cos(yaw)))
            index, errors = associate(seen, pose, known, tolerance)
            found.append((int((index >= 0).sum()), float(errors[index >= 0].sum()), pose))
    found.sort(key=lambda f: (-f[0], f[1]))
    if not found or found[0][0] < 3:
        return Recognition(None, 0, "no three reflectors of the map fit")
    best = found[0]
    for count, _, pose in found[1:]:
        away = pose.distance_to(best[2]) > 0.5 or abs(math.sin(0.5 * (pose.yaw - best[2].yaw))) > 0.1
        if count == best[0] and away:
            return Recognition(None, count, f"several places fit with {count} reflectors")
    return Recognition(best[2], best[0], f"{best[0]} of {len(seen)} reflectors fit")


def associate(seen: F64, pose: SE2, known: F64, reach: float) -> tuple[I64, F64]:
    """Pair each seen reflector with the nearest known one within `reach`; -1 when none, taken, or not clearly the nearest.

    Returns (index int64 (K,), distance float64 (K,)).
    """
    distances = np.hypot(*(pose.transform(seen)[:, None] - known[None]).transpose(2, 0, 1))
    index = np.argmin(distances, axis=1)
    nearest = distances[np.arange(len(seen)), index]
    is_good = nearest < reach
    if known.shape[0] > 1:
        second = np.partition(distances, 1, axis=1)[:, 1]
        is_good &= second > 2.0 * nearest
    for k in np.flatnonzero(is_good):
        rivals = np.flatnonzero(is_good & (index == index[k]))
        is_good[rivals] = rivals == rivals[np.argmin(nearest[rivals])]
    return np.where(is_good, index, -1), nearest
