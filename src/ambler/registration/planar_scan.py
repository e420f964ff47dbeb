"""The planar scan that every 2-D matcher and grid takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.kernels import scan_points

F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class PlanarScan:
    """Points of one scan in the base frame of the instant `stamp_ns`, motion-compensated.

    `points` float32 (N, 2) are returns; `free_points` float32 (M, 2) end rays that are free but have no return; `origin` (x, y)
    is the sensor.
    """

    stamp_ns: int
    points: F32
    free_points: F32
    origin: tuple[float, float] = (0.0, 0.0)


def _table(n: int) -> NDArray[np.int64]:
    return np.empty(1 << max(4, (2 * n).bit_length()), np.int64)


def filter_voxels(points: F32, size: float) -> F32:
    """Keep the first point of every square voxel; (N, 2) -> (K, 2), order kept."""
    out = np.empty_like(points)
    return out[: int(scan_points.voxel_filter(points, size, _table(len(points)), out))]


def filter_voxels_adaptively(points: F32, max_size: float, min_points: int) -> F32:
    """Keep at least `min_points` points with the largest voxel up to `max_size` that allows it; (N, 2) -> (K, 2).

    The voxel is never below 1/128 of `max_size`, so that points closer than that may count as one.
    """
    out = np.empty_like(points)
    n = scan_points.adaptive_voxel_filter(points, max_size, min_points, _table(len(points)), out)
    return out[: int(n)]
