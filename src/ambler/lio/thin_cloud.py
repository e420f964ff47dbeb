"""A cloud with one point per cell, for those who look at it or search with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import PointCloud
from ambler.kernels import voxel_map as kernels


def thinned(cloud: PointCloud, cell: float) -> PointCloud:
    """Return the first point of every cell of `cell` metres; the cloud itself for 0."""
    if cell <= 0.0:
        return cloud
    kept = first_in_cells(cloud.points, cell)
    points, intensity = cloud.points[kept], cloud.intensity[kept]
    return PointCloud(cloud.stamp_ns, cloud.frame, points, intensity, cloud.time[kept], cloud.ring[kept])


def first_in_cells(points: NDArray[np.float32], cell: float) -> NDArray[np.int64]:
    """Return the number of the first of points (N, 3) in every cell of `cell` metres that holds any."""
    n = len(points)
    numbers = np.arange(n)
    scratch = np.empty(1 << max(4, (2 * n).bit_length()), np.int64)
    return numbers[: kernels.thin_out(np.ascontiguousarray(points), numbers, cell, scratch, numbers)]
