"""What drivers call the columns of a PointCloud2 besides x, y, z, and in which unit they tell the time of every point.

Velodyne `time` (float32, s after the stamp), Ouster `t` and Livox `offset_time` (uint32, ns after the stamp), Hesai and RoboSense
`timestamp` (float64, s since the epoch), Livox's PointCloud2 `timestamp` (float64, ns since the epoch).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

TIME = ("time", "t", "timestamp", "offset_time", "time_offset")
RING = ("ring", "line", "channel")
INTENSITY = ("intensity", "reflectivity")
EPOCH_S, EPOCH_NS = 1e8, 1e17  # from here on a time is counted since the epoch (1973), in s or ns


def column(packed: NDArray[np.void], names: tuple[str, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the first column of these names, zeros when there is none."""
    for name in names:
        if name in (packed.dtype.names or ()):
            return np.array(packed[name], dtype)
    return np.zeros(len(packed), dtype)


def point_times(packed: NDArray[np.void], stamp_ns: int) -> NDArray[np.float32]:
    """Return the seconds after the stamp at which every point was taken, float32 (N,); zeros when nothing tells."""
    name = next((name for name in TIME if name in (packed.dtype.names or ())), None)
    if name is None or len(packed) == 0:
        return np.zeros(len(packed), np.float32)
    told = packed[name]
    if told.dtype.kind in "iu":
        ns = told.astype(np.int64)
        return np.asarray((ns - stamp_ns if ns.max() > EPOCH_NS else ns) * 1e-9, np.float32)
    if told.dtype.itemsize < 8:
        return np.array(told, np.float32)  # too coarse for times since the epoch
    largest = np.nanmax(told) if np.isfinite(told).any() else 0.0
    if largest > EPOCH_NS:
        return np.asarray((told - float(stamp_ns)) * 1e-9, np.float32)
    return np.asarray(told - stamp_ns * 1e-9 if largest > EPOCH_S else told, np.float32)
