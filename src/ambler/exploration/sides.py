"""From which of eight sides something is looked at: side 0 looks from +x, side 2 from +y."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

SIDES = 8
Offsets = NDArray[np.floating] | NDArray[np.int64]


def sides_of(dy: Offsets, dx: Offsets) -> NDArray[np.int64]:
    """Return on which sides of a place the offsets (dy, dx), of one shape, lead."""
    turns = np.arctan2(dy, dx) / (2.0 * math.pi)
    return np.asarray(np.floor(turns * SIDES + 0.5).astype(np.int64) % SIDES)
