"""The scanner of the ideal grid world: beams over a true grid that mark what they pass and what they hit."""

import math

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit


@jit
def sense(
    truth: NDArray[np.int8],
    occupied_from: int,
    x: float,
    y: float,
    beams: int,
    reach: float,
    free: int,
    occupied: int,
    built: NDArray[np.int8],
) -> None:
    """Mark the cells of `built` that `beams` equally spaced beams from (x, y) pass, and the first one that each hits.

    Position and `reach` in cells, cell (iy, ix) covering [ix, ix + 1) x [iy, iy + 1). Beams are sampled every half cell, and leave
    gaps between them where they are farther apart than a cell. Once occupied, always occupied.
    """
    height, width = truth.shape
    steps = int(2.0 * reach)
    for i in range(beams):
        angle = i * (2.0 * math.pi / beams)
        dx, dy = 0.5 * math.cos(angle), 0.5 * math.sin(angle)
        for k in range(steps):
            ix, iy = int(math.floor(x + k * dx)), int(math.floor(y + k * dy))
            if ix < 0 or iy < 0 or ix >= width or iy >= height:
                break
            if truth[iy, ix] >= occupied_from:
                built[iy, ix] = occupied
                break
            built[iy, ix] = free


def warm_up() -> None:
    """Compile every kernel with its real dtypes."""
    truth = np.zeros((4, 4), np.int8)
    sense(truth, 50, 2.5, 2.5, 8, 4.0, 0, 100, np.full((4, 4), -1, np.int8))
