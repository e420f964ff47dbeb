"""Rigid alignment of two planar point sets by trimmed ICP from several starts (Besl and McKay 1992; Chetverikov et al. 2002)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ambler.core.errors import BadInputError
from ambler.core.se2 import SE2

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AlignConfig:
    """The nearest `keep` of all pairs count in each step. Starts: identity, turns by `yaws_deg` about the middle of the source, and
    `shifts` (m) along each axis, tried with about `coarse_points` points; the best of them is refined with all."""

    keep: float = 0.9
    iterations: int = 100
    coarse_iterations: int = 25
    coarse_points: int = 400
    yaws_deg: tuple[float, ...] = (-10.0, -5.0, 5.0, 10.0)
    shifts: tuple[float, ...] = (-0.4, 0.4)
    tolerance: float = 1e-6


@dataclass(frozen=True, slots=True)
class Alignment:
    """`target_from_source` and the root mean square of the kept distances, metres."""

    target_from_source: SE2
    rms: float


def best_rigid_motion(source: F64, target: F64) -> SE2:
    """Return the motion of pairs (N, 2) that minimizes the squared distances (Umeyama 1991, scale 1): target_from_source."""
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    yaw = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    turned = SE2(0.0, 0.0, yaw).transform(source_mean[None])[0]
    shift = target_mean - turned
    return SE2(float(shift[0]), float(shift[1]), yaw)


def align(source: F64, target: F64, config: AlignConfig | None = None) -> Alignment:
    """Find the rigid motion that lays source points (N, 2) onto target points (M, 2); no scale.

    Raises BadInputError when one of them has fewer than three points.
    """
    c = config or AlignConfig()
    if min(len(source), len(target)) < 3:
        raise BadInputError("alignment needs at least three points on both sides")
    tree = cKDTree(target)
    stride = max(1, len(source) // c.coarse_points)
    coarse = source[::stride]
    middle = source.mean(axis=0)
    starts = [SE2()]
    for yaw in c.yaws_deg:
        about = SE2(middle[0], middle[1]) @ SE2(0.0, 0.0, math.radians(yaw)) @ SE2(-middle[0], -middle[1])
        starts.append(about)
    starts += [SE2(d, 0.0) for d in c.shifts] + [SE2(0.0, d) for d in c.shifts]
    tried = [_refine(coarse, target, tree, start, c, c.coarse_iterations) for start in starts]
    best = min(tried, key=lambda a: a.rms)
    return _refine(source, target, tree, best.target_from_source, c, c.iterations)


def _refine(source: F64, target: F64, tree: cKDTree, start: SE2, c: AlignConfig, iterations: int) -> Alignment:
    pose = start
    kept = max(3, int(c.keep * len(source)))
    rms = math.inf
    for _ in range(iterations):
        moved = pose.transform(source)
        distance, index = (np.asarray(a) for a in tree.query(moved))
        nearest = np.argpartition(distance, kept - 1)[:kept]
        rms = float(np.sqrt(np.mean(distance[nearest] ** 2)))
        step = best_rigid_motion(moved[nearest], target[index[nearest]])
        pose = step @ pose
        if max(abs(step.x), abs(step.y), abs(step.yaw)) < c.tolerance:
            break
    return Alignment(pose, rms)
