"""What loop closure says of poses between its keyframes: corrections are blended from keyframe to keyframe by time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3


def corrected_pose(
    stamps_ns: NDArray[np.int64], correction: Callable[[int], SE3], stamp_ns: int, odom_from_body: SE3
) -> SE3:
    """Return map_from_body of a body that the odometry saw at `stamp_ns`; `correction` gives map_from_odom at a keyframe by its number, and `stamps_ns` (K,) are
    those of the keyframes, K > 0, in order. Before the first and after the last its own correction counts."""
    k = int(np.clip(np.searchsorted(stamps_ns, stamp_ns, side="right") - 1, 0, len(stamps_ns) - 1))
    here = correction(k) @ odom_from_body
    if k + 1 == len(stamps_ns):
        return here
    ratio = float(np.clip((stamp_ns - stamps_ns[k]) / (stamps_ns[k + 1] - stamps_ns[k]), 0.0, 1.0))
    return here.interpolate(correction(k + 1) @ odom_from_body, ratio)
