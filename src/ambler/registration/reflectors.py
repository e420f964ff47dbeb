"""Retro-reflectors in a scan, found by their intensity; reflectors are strips or poles of known radius."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DetectorConfig:
    """Returns from `intensity_min` on belong to reflectors; those nearer than `join` metres are one, at most `size_max` wide.
    `width`: of flat strips (m); `radius`: of poles, 0 for strips."""

    intensity_min: float = 200.0
    join: float = 0.12
    size_max: float = 0.3
    width: float = 0.1
    radius: float = 0.0
    least_returns: int = 1
    range_most: float = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class ReflectorDetection:
    """Reflectors in one scan: `centers` float64 (K, 2) in the base frame, `sigmas` (K,): what the sampling of a strip by a few beams
    leaves open (m)."""

    centers: F64
    sigmas: F64


def detect_reflectors(points_base: F32, intensities: F32, config: DetectorConfig) -> ReflectorDetection:
    """Find the reflectors of a scan, points float32 (N, 2) in the base frame, in the order of their bearing."""
    if len(intensities) != len(points_base):
        raise BadInputError(f"{len(intensities)} intensities for {len(points_base)} points")
    keep = (intensities >= config.intensity_min) & np.isfinite(points_base).all(axis=1)
    bright = points_base[keep].astype(np.float64)
    bright = bright[np.hypot(bright[:, 0], bright[:, 1]) < config.range_most]
    if len(bright) == 0:
        return ReflectorDetection(np.empty((0, 2)), np.empty(0))
    bright = bright[np.argsort(np.arctan2(bright[:, 1], bright[:, 0]), kind="stable")]
    gaps = np.hypot(*(bright - np.roll(bright, 1, axis=0)).T) > config.join
    # Start at a gap, so that a reflector behind the robot is not cut in two at +-180 degrees.
    first = int(np.argmax(gaps)) if gaps.any() else 0
    bright, gaps = np.roll(bright, -first, axis=0), np.roll(gaps, -first)
    gaps[0] = True
    centers, sigmas = [], []
    for group in np.split(bright, np.flatnonzero(gaps)[1:]):
        extent = float(np.hypot(*(group.max(axis=0) - group.min(axis=0))))
        if len(group) < config.least_returns or extent > config.size_max:
            continue
        center = group.mean(axis=0)
        # The seen half of a pole is on average pi / 4 of its radius nearer than its axis.
        center *= 1.0 + 0.25 * math.pi * config.radius / max(float(np.hypot(*center)), 1e-6)
        centers.append(center)
        # n evenly spaced returns leave the centre open by the width of a strip / n, but only along the strip.
        sigmas.append(config.width / len(group) / math.sqrt(24.0))
    return ReflectorDetection(np.array(centers).reshape(-1, 2), np.array(sigmas))
