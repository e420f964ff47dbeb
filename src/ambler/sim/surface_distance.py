"""How far points lie from the true surfaces of a world: the truth that clouds are judged by."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.sim.scene import RayScene

F64 = NDArray[np.float64]
LEAST_COSINE = 0.05


def surface_distances(scene: RayScene, points: F64, reach: float = 2.0) -> F64:
    """Return the distances (N,) of points (N, 3) in the world from its surfaces, inf beyond `reach` metres: along the six axes, each times the cosine at which its
    ray meets a surface, the least of them."""
    # Rays meet the floor from above and the ceiling from below only.
    distances = np.fmin(np.abs(points[:, 2] - scene.solids.floor), np.abs(points[:, 2] - scene.solids.ceiling))
    for axis in (*np.eye(3), *-np.eye(3)):
        found, _, cosine = scene.cast(points, np.tile(axis, (len(points), 1)), reach)
        distances = np.fmin(distances, np.where(np.isfinite(found), found, np.inf) * np.maximum(cosine, LEAST_COSINE))
    return np.asarray(np.where(distances <= reach, distances, np.inf))
