"""The keyframes of a map: where each scan that was inserted lies in it, when everything has been optimized."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.slam2d.slam import Slam2d


@dataclass(frozen=True, slots=True, eq=False)
class Keyframes:
    """`stamps_ns` int64 (N,) and `map_from_base` float64 (N, 3) of (x, y, yaw)."""

    stamps_ns: NDArray[np.int64]
    map_from_base: NDArray[np.float64]


def keyframes_of(slam: Slam2d) -> Keyframes:
    """Return the keyframes of a map as it is now, in the order of their stamps."""
    stamps = [slam.stamp_of_node(k) for k in range(slam.nodes)]
    poses = [slam.map_from_node(k).as_array() for k in range(slam.nodes)]
    return Keyframes(np.array(stamps, np.int64), np.array(poses, np.float64).reshape(-1, 3))
