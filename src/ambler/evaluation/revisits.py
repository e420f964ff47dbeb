"""How well a trajectory returns to places: relative poses of scans near in space and far apart on the way, against a reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

F64 = NDArray[np.float64]

NEAR = 3.0  # m between two poses of a revisit
APART = 30.0  # m of way between them


@dataclass(frozen=True, slots=True, eq=False)
class RevisitErrors:
    """`errors` float64 (K,): metres between the estimated and the reference position of one pose in the frame of the other."""

    errors: F64

    def fields(self) -> dict[str, float | int | None]:
        """Return the machine-readable fields; unknown without a revisit."""
        some = len(self.errors) > 0
        return {
            "revisits": len(self.errors),
            "revisit_error_median_m": float(np.median(self.errors)) if some else None,
            "revisit_error_worst_m": float(self.errors.max()) if some else None,
        }


def revisit_errors(estimate: F64, reference: F64) -> RevisitErrors:
    """Compare all pairs of poses (N, 3) of (x, y, yaw) that the reference has within `NEAR` and `APART` of way from each other."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(reference[:, :2], axis=0).T))))
    pairs = cKDTree(reference[:, :2]).query_pairs(NEAR, output_type="ndarray").reshape(-1, 2)
    pairs = pairs[np.abs(way[pairs[:, 0]] - way[pairs[:, 1]]) > APART]
    off = _positions(estimate, pairs) - _positions(reference, pairs)
    return RevisitErrors(np.hypot(off[:, 0], off[:, 1]))


def _positions(poses: F64, pairs: NDArray[np.int64]) -> F64:
    """Return the position (K, 2) of each second pose in the frame of the first."""
    first, second = poses[pairs[:, 0]], poses[pairs[:, 1]]
    d = second[:, :2] - first[:, :2]
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    return np.stack((c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1]), axis=1)
