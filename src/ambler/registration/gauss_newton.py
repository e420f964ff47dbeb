"""Refinement of a pose on the bicubic surface of a probability grid (after Cartographer's scan matcher), with its covariance."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels import correlation
from ambler.registration.cell_grid import CellGrid

F32 = NDArray[np.float32]
_DIAGONAL = np.diag_indices(3)


@dataclass(frozen=True, slots=True)
class RefineConfig:
    """Weights of the points, of the prior's translation (1/m) and of its rotation (1/rad).

    Where the scan says much less about one direction than about the other (information below `weak_ratio` of it: along a corridor)
    the prior's translation weight rises there up to `weak_translation_weight`. A point in an unknown cell has the probability `unknown`.
    """

    occupied_weight: float = 1.0
    translation_weight: float = 1.0
    rotation_weight: float = 4.0
    weak_translation_weight: float = 10.0
    weak_ratio: float = 0.25
    max_iterations: int = 20
    unknown: float = correlation.P_LOW


@dataclass(frozen=True, slots=True, eq=False)
class MatchResult:
    """Where the scan fits. `information` float64 (3, 3) is J^T J of the points over x, y, yaw in the grid frame; `score` the mean
    probability under the points, `inlier_ratio` the share of points on cells more likely occupied than not."""

    grid_from_base: SE2
    information: NDArray[np.float64]
    score: float
    inlier_ratio: float
    residual: float
    iterations: int
    weak_ratio: float

    @property
    def degeneracy(self) -> float:
        """That of the information (`degeneracy_of`)."""
        return degeneracy_of(self.information)

    def covariance(self, sigma: float, floor: tuple[float, float]) -> NDArray[np.float64]:
        """Return float64 (3, 3) of (x, y, yaw): sigma^2 over the discounted information, plus a floor (metres, radians).

        `sigma` is the noise of one point's probability with the correlation between neighbours taken into account. Information
        that is weak in one direction comes from clutter and the lattice rather than from walls, and is discounted (see `weak_ratio`).
        """
        h = self.information.copy()
        schur = translational(h)
        least = max(self.weak_ratio * _eigenvalues(schur)[1], 1e-9)
        h[:2, :2] += _by_eigenvalue(schur, lambda value: value * min(max(value / least, 0.05), 1.0) ** 2) - schur
        h[_DIAGONAL] += sigma**2 * np.array([1.0, 1.0, 10.0])
        cov = sigma**2 * np.linalg.inv(h)
        cov = 0.5 * (cov + cov.T)
        cov[_DIAGONAL] += (floor[0] ** 2, floor[0] ** 2, floor[1] ** 2)
        return cov


def translational(h: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the translational information (2, 2) with the yaw marginalized."""
    if h[2, 2] <= 0.0:
        return h[:2, :2]
    (a, b, c), (_, d, e), (_, _, f) = h.tolist()
    return np.array([[a - c * c / f, b - c * e / f], [b - c * e / f, d - e * e / f]])


def _eigenvalues(matrix: NDArray[np.float64]) -> tuple[float, float]:
    """Return both of a symmetric matrix (2, 2), the smaller one first: so small a matrix takes NumPy ten times as long."""
    (a, b), (_, d) = matrix.tolist()
    middle, half = 0.5 * (a + d), math.hypot(0.5 * (a - d), b)
    return middle - half, middle + half


def _by_eigenvalue(matrix: NDArray[np.float64], value_of: Callable[[float], float]) -> NDArray[np.float64]:
    """Return the symmetric matrix (2, 2) that has the same eigenvectors and other eigenvalues."""
    low, high = _eigenvalues(matrix)
    new_low, new_high = value_of(low), value_of(high)
    slope = (new_high - new_low) / (high - low) if high > low else 0.0
    (a, b), (_, d) = matrix.tolist()
    return np.array([[new_low + slope * (a - low), slope * b], [slope * b, new_low + slope * (d - low)]])


def degeneracy_of(h: NDArray[np.float64]) -> float:
    """Return the smallest over the largest eigenvalue of the translational information with the yaw marginalized: 0 in a corridor, 1 isotropic."""
    low, high = _eigenvalues(translational(h))
    return max(0.0, low) / high if high > 0.0 else 0.0


def _prior_information(h: NDArray[np.float64], config: RefineConfig) -> NDArray[np.float64]:
    """Return the prior's information (3, 3): stronger along directions in which the points say little."""
    telling = translational(h)
    enough = max(config.weak_ratio * _eigenvalues(telling)[1], 1e-9)
    low, high = config.translation_weight**2, config.weak_translation_weight**2
    out = np.zeros((3, 3))
    out[:2, :2] = _by_eigenvalue(telling, lambda value: low + (high - low) * min(max(1.0 - value / enough, 0.0), 1.0))
    out[2, 2] = config.rotation_weight**2
    return out


def refine(grid: CellGrid, points: F32, start: SE2, prior: SE2, config: RefineConfig) -> MatchResult:
    """Move `start` (grid_from_base) to the best fit of the points (N, 2) near `prior`."""
    pose = start.as_array()
    centre = prior.as_array()
    centre[2] = pose[2] + (centre[2] - pose[2] + np.pi) % (2 * np.pi) - np.pi
    h, g, info = np.empty((3, 3)), np.empty(3), np.empty(4)
    info[:3] = correlation.normal_equations(grid.cells, grid.frame, points, pose, config.unknown, h, g, np.empty(11))
    weights = _prior_information(h, config)
    correlation.refine(
        *(grid.cells, grid.frame, points, pose, centre, config.occupied_weight, weights),
        *(config.max_iterations, config.unknown, h, g, info),
    )
    return MatchResult(
        SE2.from_array(pose),
        h,
        float(info[0]),
        float(info[1]),
        float(info[2]),
        int(info[3]),
        config.weak_ratio,
    )
