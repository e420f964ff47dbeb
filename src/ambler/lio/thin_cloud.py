"""A cloud with one point per cell, for those who look at it or search with it."""

from __future__ import annotations

import numpy as np

from ambler.core.messages import PointCloud
from ambler.kernels import voxel_map as kernels


def thinned(cloud: PointCloud, cell: float) -> PointCloud:
    """Return the first point of every cell of `cell` metres; the cloud itself for 0."""
    if cell <= 0.0:
        return cloud
    n = len(cloud.points)
    chosen = np.empty(n, np.int64)
    scratch = np.empty(1 << max(4, (2 * n).bit_length()), np.int64)
    chosen = chosen[: kernels.thin_out(np.ascontiguousarray(cloud.points), cell, scratch, chosen)]
    points, intensity = cloud.points[chosen], cloud.intensity[chosen]
    return PointCloud(cloud.stamp_ns, cloud.frame, points, intensity, cloud.time[chosen], cloud.ring[chosen])
