"""What speaks for a place against another that looks alike: how many separate things one of them explains and the other does not.

In a corridor two places share their long walls, and with them nearly all returns: the share of returns that each explains differs by a few
per cent, whichever is right. What tells them apart is a niche here and a pillar there. Each such thing may have been moved since the map was made,
so one of them says little however many beams meet it; several of them, at several spots, do not all move to where another place has them.
Returns are gathered over all viewpoints in cells of the odometry's frame, so that a thing that is seen again counts once.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

I64 = NDArray[np.int64]
CELL = 0.5  # metres: what lies nearer together is taken for one thing
LEAST = 3  # returns in a cell; fewer may be a beam that grazes an edge


def _nothing() -> I64:
    return np.empty(0, np.int64)


EXPLAINED, TOO_FAR, TOO_NEAR = 0, 1, 2  # as `kernels.likelihood_field.label_return` judges a return


@dataclass(frozen=True, slots=True, eq=False)
class PlaceEvidence:
    """Cells int64 (K, 2) of the odometry's frame, and how many returns in each the place explained, saw too far and too near: int64 (K, 3)."""

    cells: I64 = field(default_factory=lambda: np.empty((0, 2), np.int64))
    counts: I64 = field(default_factory=lambda: np.empty((0, 3), np.int64))

    def with_view(self, points_odom: NDArray[np.floating], labels: NDArray[np.int8]) -> PlaceEvidence:
        """Return this with one more view: returns (N, 2), and how the place judges each, int8 (N,)."""
        is_told = labels >= 0
        seen = np.floor(np.asarray(points_odom, np.float64)[is_told] / CELL).astype(np.int64)
        cells, index = np.unique(np.concatenate((self.cells, seen)), axis=0, return_inverse=True)
        index, known = index.ravel(), len(self.cells)
        counts = np.zeros((len(cells), 3), np.int64)
        np.add.at(counts, index[:known], self.counts)
        np.add.at(counts, (index[known:], labels[is_told]), 1)
        return PlaceEvidence(cells, counts)

    @property
    def contradicted(self) -> float:
        """The share of the cells with returns in which the place explains fewer than it has too near or too far: 0 for none at all."""
        is_told = self.counts.sum(axis=1) >= LEAST
        wrong = np.maximum(self.counts[:, TOO_FAR], self.counts[:, TOO_NEAR])
        is_wrong = is_told & (wrong >= LEAST) & (wrong > self.counts[:, EXPLAINED])
        return int(is_wrong.sum()) / max(int(is_told.sum()), 1)

    def things_over(self, other: PlaceEvidence) -> tuple[int, int]:
        """Return how many separate things this place explains where the other, seen from the same viewpoints, has nothing (too near), and how many
        behind what it has (too far)."""
        explained, wrong = self.counts[:, EXPLAINED], self.counts.sum(axis=1) - self.counts[:, EXPLAINED]
        mine = self.cells[(explained >= LEAST) & (explained > 2 * wrong)]
        near, far = (
            other.cells[(other.counts[:, k] >= LEAST) & (other.counts[:, k] > other.counts[:, EXPLAINED])]
            for k in (TOO_NEAR, TOO_FAR)
        )
        return _things(mine, near), _things(mine, far)


def _things(mine: I64, wrong: I64) -> int:
    """Count the patches of cells that are in both lists (K, 2)."""
    cells, counts = np.unique(np.concatenate((mine, wrong)), axis=0, return_counts=True)
    cells = cells[counts == 2]
    if len(cells) == 0:
        return 0
    low = cells.min(axis=0)
    picture = np.zeros(cells.max(axis=0) - low + 1, np.bool_)
    picture[tuple((cells - low).T)] = True
    return int(ndimage.label(picture, np.ones((3, 3)))[1])
