"""Where in a window of uncertainty may a submap lie on another? Images of what stands upright, seen from above, correlated over shifts and headings.

For drifts beyond the reach of point-to-point matching: a way of many kilometres, a stretch that was coasted.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2

F64 = NDArray[np.float64]
CELL = 0.5  # m
HEIGHT = 2.0  # m; what is higher counts no more: crowns and walls would drown poles
STARTS = 4
APART = 2.0  # m between two starts; nearer ones lead to the same end


def find_starts(
    fixed: F64, moving: F64, radius: float, window_m: float, window_rad: float
) -> list[tuple[float, float, float]]:
    """Return the best shifts and turns (x, y, yaw) that lay `moving` points (N, 3) on `fixed` ones (M, 3), the best first: turned about the origin, then shifted.
    Both have level axes; what lies farther than `radius` from the origin is left out."""
    size = next_fast_len(int(2.0 * (radius + window_m) / CELL) + 2, real=True)
    target = rfft2(_image(fixed, 0.0, radius, size))
    step = CELL / (0.5 * radius)
    turns = step * np.arange(-math.ceil(window_rad / step), math.ceil(window_rad / step) + 1)
    reach = math.ceil(window_m / CELL)
    found: list[tuple[float, float, float, float]] = []
    for turn in turns.tolist():
        scores = irfft2(target * np.conj(rfft2(_image(moving, turn, radius, size))), s=(size, size))
        near = np.roll(scores, (reach, reach), axis=(0, 1))[: 2 * reach + 1, : 2 * reach + 1]
        for k in np.argsort(near, axis=None)[::-1][: 2 * STARTS]:
            iy, ix = divmod(int(k), near.shape[1])
            found.append((float(near[iy, ix]), CELL * (ix - reach), CELL * (iy - reach), turn))
    starts: list[tuple[float, float, float]] = []
    for _, x, y, turn in sorted(found, reverse=True):
        if all(math.hypot(x - a, y - b) > APART for a, b, _ in starts):
            starts.append((x, y, turn))
        if len(starts) == STARTS:
            break
    return starts


def _image(points: F64, turn: float, radius: float, size: int) -> F64:
    """Return the vertical extent (size, size) of the points in each cell after a turn, less its mean over all cells that hold any."""
    c, s = math.cos(turn), math.sin(turn)
    x, y, z = points[np.hypot(points[:, 0], points[:, 1]) < radius].T
    ix, iy = ((v / CELL + 0.5 * size).astype(np.int64) for v in (c * x - s * y, s * x + c * y))
    index = iy * size + ix
    low, high = np.full(size * size, np.inf), np.full(size * size, -np.inf)
    np.minimum.at(low, index, z)
    np.maximum.at(high, index, z)
    is_seen = np.isfinite(low)
    out = np.zeros(size * size)
    out[is_seen] = np.minimum(high[is_seen] - low[is_seen], HEIGHT)
    out[is_seen] -= out[is_seen].mean() if is_seen.any() else 0.0
    return out.reshape(size, size)
