"""Rigid alignment of two planar point sets by trimmed ICP from several starts (Besl and McKay 1992; Chetverikov et al. 2002).

Cells of two grids attract each other, so that point-to-point ICP stops a little beside the truth; the last steps therefore
measure distances to the lines through the target's points (Chen and Medioni 1992).
"""

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
    `shifts` (m) along each axis, tried with about `coarse_points` points; the best of them is refined with all. Lines go
    through `line_neighbours` points; a result that they move farther than `max_line_shift` (m) is not believed."""

    keep: float = 0.9
    iterations: int = 100
    coarse_iterations: int = 25
    coarse_points: int = 400
    yaws_deg: tuple[float, ...] = (-10.0, -5.0, 5.0, 10.0)
    shifts: tuple[float, ...] = (-0.4, 0.4)
    line_iterations: int = 20
    line_neighbours: int = 11
    max_line_shift: float = 0.15
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
        starts.append(_turn_about(middle, math.radians(yaw)))
    starts += [SE2(d, 0.0) for d in c.shifts] + [SE2(0.0, d) for d in c.shifts]
    tried = [_refine(coarse, target, tree, start, c, c.coarse_iterations) for start in starts]
    best = min(tried, key=lambda a: a.rms)
    by_points = _refine(source, target, tree, best.target_from_source, c, c.iterations)
    by_lines = _refine_to_lines(source, target, tree, by_points.target_from_source, c)
    moved = by_lines.transform(middle[None])[0] - by_points.target_from_source.transform(middle[None])[0]
    return Alignment(by_lines, by_points.rms) if np.hypot(*moved) <= c.max_line_shift else by_points


def _turn_about(point: F64, yaw: float) -> SE2:
    x, y = float(point[0]), float(point[1])
    return SE2(x, y) @ SE2(0.0, 0.0, yaw) @ SE2(-x, -y)


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


def _normals(points: F64, tree: cKDTree, neighbours: int) -> F64:
    """Return the unit normal of the line through each point's neighbourhood, float64 (N, 2)."""
    index = np.asarray(tree.query(points, k=min(neighbours, len(points)))[1])
    around = points[index] - points[index].mean(axis=1, keepdims=True)
    scatter = np.einsum("nki,nkj->nij", around, around)
    return np.asarray(np.linalg.eigh(scatter)[1][:, :, 0])


def _refine_to_lines(source: F64, target: F64, tree: cKDTree, start: SE2, c: AlignConfig) -> SE2:
    """Minimize the trimmed squared distances to the target's lines by Gauss-Newton steps; returns target_from_source."""
    normals = _normals(target, tree, c.line_neighbours)
    pose = start
    kept = max(3, int(c.keep * len(source)))
    for _ in range(c.line_iterations):
        moved = pose.transform(source)
        distance, index = (np.asarray(a) for a in tree.query(moved))
        nearest = np.argpartition(distance, kept - 1)[:kept]
        p, n = moved[nearest], normals[index[nearest]]
        middle = p.mean(axis=0)
        q = p - middle
        residual = np.einsum("ni,ni->n", n, p - target[index[nearest]])
        jacobian = np.column_stack([n, n[:, 1] * q[:, 0] - n[:, 0] * q[:, 1]])
        damping = 1e-6 * kept * np.eye(3)
        step = -np.linalg.solve(jacobian.T @ jacobian + damping, jacobian.T @ residual)
        pose = SE2(float(step[0]), float(step[1])) @ _turn_about(middle, float(step[2])) @ pose
        if float(np.abs(step).max()) < c.tolerance:
            break
    return pose
