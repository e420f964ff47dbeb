"""Exhaustive correlation of a scan with a grid in a small window (Olson 2009, as in Cartographer's real-time matcher)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2
from ambler.kernels import correlation
from ambler.registration.cell_grid import CellGrid

F32 = NDArray[np.float32]


def angular_step(points: F32, resolution: float, quantile: float = 1.0) -> float:
    """Return the rotation (rad) that moves a point at the given range quantile of (N, 2) by one cell; ranges count from 3 cells on."""
    ranges = np.sort(np.hypot(points[:, 0], points[:, 1]))
    r = max(3.0 * resolution, float(ranges[min(len(ranges) - 1, int(quantile * len(ranges)))]))
    return 0.999 * math.acos(1.0 - resolution * resolution / (2.0 * r * r))


@dataclass(frozen=True, slots=True)
class Window:
    """Half widths of a search: metres and radians."""

    linear: float = 0.1
    angular: float = math.radians(20.0)


@dataclass(frozen=True, slots=True)
class CorrelationResult:
    """Best pose of the window and its score: mean probability times the penalty."""

    grid_from_base: SE2
    score: float


def correlate(
    grid: CellGrid,
    points: F32,
    center: SE2,
    window: Window,
    translation_weight: float = 0.1,
    rotation_weight: float = 0.1,
    unknown: float = correlation.P_LOW,
) -> CorrelationResult:
    """Score all poses around `center` (grid_from_base) at one cell and the matching angular step; points (N, 2) in the base frame. A point in an unknown cell
    has the probability `unknown`."""
    resolution = float(grid.frame[0])
    step = angular_step(points, resolution, 0.9)
    half = math.ceil(window.linear / resolution)
    search = np.array([half, math.ceil(window.angular / step), step])
    best = np.empty(4)
    sums = np.empty((2 * half + 1, 2 * half + 1), np.int32)
    weights = np.array([translation_weight, rotation_weight])
    correlation.correlate(grid.cells, grid.frame, points, center.as_array(), search, weights, unknown, sums, best)
    return CorrelationResult(SE2.from_array(best[:3]), float(best[3]))
