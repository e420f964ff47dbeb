"""Reversals of a driven path: places at which a robot turned round and went back where it came from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WINDOW = 1.0  # metres of the path before and after a place that are compared
STEP = 0.1  # metres between the places
OPPOSED = -0.7071  # cosine of 135 degrees


def count_reversals(places: NDArray[np.floating]) -> int:
    """Return how often a path (N, 2) in metres turns by more than 135 degrees between one metre of it and the next; turns within a metre of
    each other are one."""
    steps = np.hypot(*np.diff(places, axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    at = np.arange(0.0, along[-1], STEP)
    even = np.stack([np.interp(at, along, places[:, axis]) for axis in (0, 1)], axis=1)
    half = round(WINDOW / STEP)
    if len(even) <= 2 * half:
        return 0
    before, after = even[half:-half] - even[: -2 * half], even[2 * half :] - even[half:-half]
    cosine = (before * after).sum(axis=1) / np.maximum(np.hypot(*before.T) * np.hypot(*after.T), 1e-9)
    turned = np.flatnonzero(cosine < OPPOSED)
    return int(len(turned) > 0) + int((np.diff(turned) > half).sum())
