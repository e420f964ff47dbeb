"""Directions in which the planes of a scan say next to nothing: along a tunnel, across an open field.

The translation's part of the information after the rotation has been solved for (Schur complement), and the other way round, is
decomposed; an eigenvalue is how many planes face that direction (each counts with the square of its cosine).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.lio.config import DegeneracyConfig
from ambler.lio.health import LioResult

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Degeneracy:
    """Unit vectors that are left alone: `translation` float64 (K, 3) in the map and `rotation` (L, 3) in the IMU. `weakest` is the smallest share of
    the inliers that face any direction of translation: a third is the best there is."""

    translation: F64
    rotation: F64
    weakest: float

    @classmethod
    def none(cls) -> Degeneracy:
        """Of a scan that had no plane at all."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), 0.0)

    @property
    def is_degenerate(self) -> bool:
        return len(self.translation) + len(self.rotation) > 0

    def frozen(self, information: F64, gradient: F64) -> tuple[F64, F64]:
        """Return information (W, W) and gradient (W,) that say nothing of these directions."""
        if not self.is_degenerate:
            return information, gradient
        keep = np.eye(len(gradient))
        keep[:3, :3] -= self.translation.T @ self.translation
        keep[3:6, 3:6] -= self.rotation.T @ self.rotation
        return keep @ information @ keep, keep @ gradient


def find_degeneracy(information: F64, inliers: float, config: DegeneracyConfig) -> Degeneracy:
    """Find the weak directions of an information matrix (6 or more columns, unit noise) of so many inliers."""
    least = max(config.constraints_least, config.share_least * inliers)
    h = information[:6, :6] + 1e-9 * np.eye(6)
    tt, tr, rr = h[:3, :3], h[:3, 3:], h[3:, 3:]
    shares, directions = np.linalg.eigh(tt - tr @ np.linalg.solve(rr, tr.T))
    moments, axes = np.linalg.eigh(rr - tr.T @ np.linalg.solve(tt, tr))
    weak_r = moments < least * config.rotation_arm**2
    return Degeneracy(directions.T[shares < least], axes.T[weak_r], float(shares[0]) / max(inliers, 1.0))


def often_frozen(results: Sequence[LioResult]) -> F64:
    """Return unit vectors in the map, float64 (K, 3), along which at least half of the scans that met planes left the place alone."""
    frozen = [result.health.frozen_translation for result in results if result.health.inliers]
    if not frozen:
        return np.zeros((0, 3))
    shares, directions = np.linalg.eigh(sum(f.T @ f for f in frozen) / len(frozen))
    return np.asarray(directions.T[shares >= 0.5])


def is_along(frozen: F64, directions: F64) -> bool:
    """Say whether any of some unit vectors (K, 3) leads rather along than across one of others (L, 3)."""
    return bool((np.abs(frozen @ directions.T) > np.sqrt(0.5)).any())
