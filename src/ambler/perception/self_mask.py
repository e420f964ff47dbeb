"""The robot's own body as polygons of the base frame: what a scanner measures there is dropped."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.kernels.self_mask import mask_points

F64 = NDArray[np.float64]


class SelfMask:
    """Any number of simple polygons (N, 2) in the base frame, metres; a point is on the robot if any of them contains it."""

    def __init__(self, polygons: Sequence[NDArray[np.floating[Any]]] = ()) -> None:
        for k, polygon in enumerate(polygons):
            if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3 or not np.isfinite(polygon).all():
                raise BadInputError(f"self-mask polygon {k} needs at least three finite corners (x, y)")
        empty = np.zeros((0, 2))
        self.vertices: F64 = np.ascontiguousarray(np.concatenate([empty, *polygons]), np.float64)
        self.starts = np.cumsum([0] + [len(p) for p in polygons]).astype(np.int64)

    @property
    def reach(self) -> float:
        """Largest distance of the mask from the base origin, metres; 0 when there is none."""
        if len(self.vertices) == 0:
            return 0.0
        return float(np.max(np.hypot(self.vertices[:, 0], self.vertices[:, 1])))

    def contains(self, points_base: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
        """Return bool (N,): which points (N, 2) of the base frame lie on the robot."""
        out = np.zeros(len(points_base), np.uint8)
        mask_points(np.ascontiguousarray(points_base, np.float64), self.vertices, self.starts, out)
        return out.astype(np.bool_)
