"""The map of the filter: points in a hash of voxels (kernels/voxel_map.py) around the sensor, in memory that never grows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.kernels import voxel_map as kernels
from ambler.lio.config import VoxelMapConfig

F64 = NDArray[np.float64]


class VoxelMap:
    """All arrays are allocated once. What lies farther than the radius from the sensor is forgotten when it has moved on; where there is
    no room for that the radius shrinks, for good."""

    def __init__(self, config: VoxelMapConfig | None = None) -> None:
        self.config = config or VoxelMapConfig()
        most, each = self.config.voxels_most, self.config.points_per_voxel
        table = 1 << max(4, (4 * most - 1).bit_length())
        self._table = (np.full(table, kernels.EMPTY, np.int64), np.zeros(table, np.int32))
        self._slot_keys, self._counts = np.zeros(most, np.int64), np.zeros(most, np.int32)
        self._points = np.zeros((most, each, 3), np.float32)
        self._weights = np.zeros((most, each), np.float32)
        self._used = np.zeros(1, np.int64)
        self._evicted_at: F64 | None = None
        self._radius = self.config.radius
        self.lost = 0
        """Points that found no room."""

    def __len__(self) -> int:
        """The number of voxels."""
        return int(self._used[0])

    @property
    def memory_mb(self) -> float:
        """What the arrays take."""
        arrays = (*self._table, self._slot_keys, self._counts, self._points, self._weights)
        return sum(a.nbytes for a in arrays) / 1e6

    def insert(self, points: F64) -> None:
        """Add points float64 (M, 3) in the map's frame; those that are not finite are left out."""
        c = self.config
        self.lost += int(
            kernels.insert(
                *(*self._table, self._slot_keys, self._counts, self._points, self._weights, self._used, points),
                *(c.voxel, c.spacing, c.merge, c.merge_most),
            )
        )

    def keep_near(self, center: F64) -> None:
        """Forget what lies farther than the radius from `center` (3,), each time that it has moved by a step, or when room runs out."""
        c = self.config
        if self._evicted_at is None:
            self._evicted_at = center.copy()
        while len(self) > 0.9 * c.voxels_most and self._radius > 2.0 * c.voxel:
            self._radius *= 0.9
            self._evict(center)
        if float(np.linalg.norm(center - self._evicted_at)) >= c.evict_step:
            self._evict(center)

    def fit_planes(self, queries: F64) -> tuple[F64, NDArray[np.bool_]]:
        """Return planes (n, d) float64 (M, 4) with n.x + d = 0 through the five points nearest to each query (M, 3), and where there is one; what stands where there is none is finite and means nothing."""
        c = self.config
        planes, is_plane = np.zeros((len(queries), 4)), np.zeros(len(queries), np.bool_)
        kernels.fit_planes(
            *(*self._table, self._counts, self._points, c.voxel, queries, kernels.OFFSETS, c.cells_visited),
            *(c.reach, c.thickness, c.flatness, planes, is_plane),
        )
        return planes, is_plane

    def points(self) -> NDArray[np.float32]:
        """Return all points float32 (M, 3)."""
        filled = np.arange(self.config.points_per_voxel) < self._counts[: len(self), None]
        return self._points[: len(self)][filled]

    def _evict(self, center: F64) -> None:
        kernels.evict(
            *(*self._table, self._slot_keys, self._counts, self._points, self._weights, self._used),
            *(center, self._radius, self.config.voxel),
        )
        self._evicted_at = center.copy()
