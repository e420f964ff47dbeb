"""In which directions of the plane what is seen can tell where the robot is, judged at its true pose and not by what a localizer says.

Each return that meets a surface of the map tells the distance along that surface's normal. A direction of (x, y, yaw) is determined when the
sum over the returns, yaw counted as mean range times radians, is at least `MIN_RATIO` of the largest and worth `MIN_RETURNS` returns: the measure
after Zhang, Kaess and Singh (2016) by which the matchers leave the rest to odometry.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.kernels import grid_tracker as kernel
from ambler.localization.surface_map import SurfaceMap

F64 = NDArray[np.float64]
MIN_RATIO, MIN_RETURNS = 0.01, 3.0
NEAR = 0.1  # metres between a return and the surface that it tells of; a made map is bent by less within sight


def determined_directions(surfaces: SurfaceMap, points_base: NDArray[np.float32], map_from_base: F64) -> F64:
    """Return the projection float64 (2, 2) on the determined directions of (x, y) along the map's axes: its trace is how many there are.

    `points_base` float32 (N, 2), `map_from_base` (3,) the true pose.
    """
    points = np.array(points_base[np.isfinite(points_base).all(axis=1)], np.float32, order="C")
    if len(points) == 0:
        return np.zeros((2, 2))
    normal, gradient, info = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    state = np.append(map_from_base, 0.0)
    kernel.accumulate(
        surfaces.nearest, surfaces.surfaces, surfaces.frame, points, state, NEAR, NEAR, normal, gradient, info
    )
    lever = max(0.5, float(np.sqrt(np.mean(np.square(points, dtype=np.float64).sum(axis=1)))))
    scale = np.array([1.0, 1.0, lever])
    values, vectors = np.linalg.eigh(normal[:3, :3] / np.outer(scale, scale))
    known = vectors[:2, values >= max(MIN_RETURNS, MIN_RATIO * float(values[-1]))]
    return np.asarray(known @ known.T)
