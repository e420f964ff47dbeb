"""Judges whether two submaps show the same place: overlap, residuals, weak directions; and what a match tells the graph."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.lio.config import DegeneracyConfig, LoopConfig
from ambler.lio.degeneracy import Degeneracy, find_degeneracy
from ambler.lio.keyframes import Keyframe
from ambler.lio.window_search import find_starts
from ambler.posegraph.so3 import exp_all, log_all
from ambler.registration.submap_match import CloudMatch, match_clouds

F64 = NDArray[np.float64]
ELSEWHERE, RIVAL = (
    0.5,
    0.8,
)  # m between two ends, and share of the better one's overlap, from which on one cannot tell which is true
FREE = 1e4  # variance (m², rad²) of a direction that a match says nothing about


@dataclass(frozen=True, slots=True, eq=False)
class Closure:
    """Keyframe `later` seen from `earlier`: `earlier_from_later` float64 (4, 4), its covariance (6, 6) perturbed on the right, and `information` (6, 6), 0 along
    weak directions. `overlap` and `residual_m` as in `CloudMatch`; `moved_m`: how far it lies from what the graph had; `weak` float64 (K, 3)
    are the unit vectors of translation, in the later keyframe, that it says nothing about."""

    earlier: int
    later: int
    earlier_from_later: F64
    covariance: F64
    information: F64
    overlap: float
    residual_m: float
    moved_m: float
    weak: F64

    @property
    def is_weak(self) -> bool:
        """Whether some direction was left alone."""
        return len(self.weak) > 0


def match_keyframes(
    frames: tuple[Keyframe, Keyframe], indices: tuple[int, int], guess: F64, config: LoopConfig
) -> Closure | None:
    """Match a later keyframe to an earlier one from a guess of earlier_from_later (4, 4); None: it is not the same place, or one cannot tell."""
    earlier, later = frames
    match = match_clouds(earlier.cloud, later.cloud, guess, config.reach, config.overlap_least)
    if (
        match is None
        or not match.converged
        or match.overlap < config.overlap_least
        or match.residual_m > config.residual_most
    ):
        return None
    weak = find_degeneracy(match.information, match.pairs, DegeneracyConfig(share_least=config.share_least))
    if len(weak.translation) > 1 or len(weak.rotation) > 0:
        return None
    covariance, information = _uncertainty(match, weak, config)
    off = np.linalg.inv(guess) @ match.target_from_source
    return Closure(
        *(*indices, match.target_from_source, covariance, information, match.overlap, match.residual_m),
        float(np.linalg.norm(off[:3, 3])),
        weak.translation,
    )


def search_keyframes(
    frames: tuple[Keyframe, Keyframe],
    indices: tuple[int, int],
    poses: tuple[F64, F64],
    window: tuple[float, float],
    config: LoopConfig,
) -> Closure | None:
    """Match a later keyframe to an earlier one whose relation is known to a window (m, rad) only; `poses` are map_from_keyframe (4, 4) of both. None: nowhere in it, or
    at two places that are about as good."""
    earlier, later = poses
    fixed, moving = (frame.cloud.points @ pose[:3, :3].T for frame, pose in zip(frames, poses, strict=True))
    between = later[:3, 3] - earlier[:3, 3]
    found: list[Closure] = []
    for x, y, turn in find_starts(
        fixed, moving, config.range_most, window[0] + float(np.hypot(*between[:2])), window[1]
    ):
        guess = np.eye(4)
        guess[:3, :3] = earlier[:3, :3].T @ exp_all(np.array([[0.0, 0.0, turn]]))[0] @ later[:3, :3]
        guess[:3, 3] = earlier[:3, :3].T @ np.array([x, y, between[2]])
        closure = match_keyframes(frames, indices, guess, config)
        if closure is not None:
            found.append(closure)
    if not found:
        return None
    found.sort(key=lambda closure: -closure.overlap)
    best = found[0]
    for other in found[1:]:
        is_elsewhere = np.linalg.norm(error_of(best.earlier_from_later, other.earlier_from_later)[:3]) > ELSEWHERE
        if is_elsewhere and other.overlap > RIVAL * best.overlap:
            return None
    off = error_of(np.linalg.inv(earlier) @ later, best.earlier_from_later)
    return replace(best, moved_m=float(np.linalg.norm(off[:3])))


def error_of(expected: F64, measured: F64) -> F64:
    """Return the perturbation (6,) on the right of an expected pose (4, 4) that leads to a measured one."""
    off = np.linalg.inv(expected) @ measured
    return np.concatenate([off[:3, 3], log_all(off[None, :3, :3])[0]])


def _uncertainty(match: CloudMatch, weak: Degeneracy, config: LoopConfig) -> tuple[F64, F64]:
    """Return the covariance (6, 6) of a match and its information, which is none along weak directions."""
    noise = max(match.residual_m, 1e-3) ** 2
    floor = np.repeat(np.square(config.match_sigma), 3)
    covariance = noise * np.linalg.inv(match.information + 1e-6 * np.eye(6)) + np.diag(floor)
    information, _ = weak.frozen(np.linalg.inv(covariance), np.zeros(6))
    for k, axes in ((0, weak.translation), (3, weak.rotation)):
        covariance[k : k + 3, k : k + 3] += FREE * axes.T @ axes
    return 0.5 * (covariance + covariance.T), 0.5 * (information + information.T)
