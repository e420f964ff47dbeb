"""Small numbers of each side of each cell, of which nearly all are zero: most cells of a map are floor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ambler.exploration.sides import SIDES

SQUARE = 64  # cells


class SideCounts:
    """Numbers uint8 [side, iy, ix] of a lattice without borders, kept in squares of cells, and only where some are not zero."""

    def __init__(self) -> None:
        self._squares: dict[tuple[int, int], NDArray[np.uint8]] = {}

    def read(self, iy: int, ix: int, height: int, width: int) -> NDArray[np.uint8]:
        """Return the numbers [side, height, width] of the cells from (iy, ix) on, in an array of their own."""
        out = np.zeros((SIDES, height, width), np.uint8)
        for key, there, here in _squares_of(iy, ix, height, width):
            if key in self._squares:
                out[:, *here] = self._squares[key][:, *there]
        return out

    def write(self, iy: int, ix: int, numbers: NDArray[np.uint8]) -> None:
        """Put in those of the cells from (iy, ix) on, as `read` gives them."""
        for key, there, here in _squares_of(iy, ix, *numbers.shape[1:]):
            if key not in self._squares:
                if not numbers[:, *here].any():
                    continue
                self._squares[key] = np.zeros((SIDES, SQUARE, SQUARE), np.uint8)
            self._squares[key][:, *there] = numbers[:, *here]


_Part = tuple[slice, slice]


def _squares_of(iy: int, ix: int, height: int, width: int) -> Iterator[tuple[tuple[int, int], _Part, _Part]]:
    """Tell which squares a box of cells reaches into, and of each, which of its cells are which of the box."""
    for ky in range(iy // SQUARE, (iy + height - 1) // SQUARE + 1):
        for kx in range(ix // SQUARE, (ix + width - 1) // SQUARE + 1):
            (there_y, here_y), (there_x, here_x) = _overlap(ky, iy, height), _overlap(kx, ix, width)
            yield (ky, kx), (there_y, there_x), (here_y, here_x)


def _overlap(square: int, begin: int, count: int) -> tuple[slice, slice]:
    """Return where cells `begin` to `begin + count` lie in the row of a square, and where in their own."""
    first, last = max(begin, square * SQUARE), min(begin + count, (square + 1) * SQUARE)
    return slice(first - square * SQUARE, last - square * SQUARE), slice(first - begin, last - begin)
