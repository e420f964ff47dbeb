"""Who came to a robot that stood, and has left again: of what a scanner cannot see, only that may be forgotten without being looked through.

What the robot itself drove up to stays where it is. What appeared beside it while it stood moves by itself; when for some time nothing at
all is seen around its place, it has gone. Without this, somebody who once touched the side of a robot would hold it for ever. It holds only
where scanners look all around (`blind_memory.see_all_around`): behind a robot that does not see backwards anybody may stand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]

STOOD = 0.5  # seconds without motion after which the surroundings are taken down
STILL = 0.01  # metres of the outermost corner that are no motion
MOVED = 0.15  # metres of the outermost corner by which what was taken down is out of date
CELL = 0.1  # metres; side of the cells that are compared
NEAR = 0.3  # metres around a remembered point: who stands there is wider than what a scanner cannot see of him
GONE = 2.0  # seconds without a return within that
RIM = 0.15  # metres around the robot that its scanners must look at, all of it: nobody is narrower
ROW = 1_000_003


class Visitors:
    """Compares what is there with what was there when the robot came to rest. All places (N, 2) are in the odom frame, m."""

    def __init__(self) -> None:
        self._cells: NDArray[np.int64] | None = None
        self._taken_at = 0.0
        self._rest_travel, self._rest_since = 0.0, 0.0

    def is_due(self, travel: float, now: float) -> bool:
        """Take how far (m) the outermost corner has come, and the time (s); say whether the robot has come to rest and shall `take_down`."""
        if travel - self._rest_travel > STILL:
            self._rest_travel, self._rest_since = travel, now
        if self._cells is not None and travel - self._taken_at > MOVED:
            self._cells = None
        return self._cells is None and now - self._rest_since >= STOOD

    def take_down(self, places: F64, travel: float) -> None:
        """Take everything that is known to stand around the robot now."""
        self._cells, self._taken_at = np.unique(_cells(places)), travel

    def came(self, places: F64) -> Flags:
        """Return bool (N,): whether nothing stood there or beside it when the robot came to rest; False while that is not known."""
        if self._cells is None or len(places) == 0:
            return np.zeros(len(places), np.bool_)
        cells = _cells(places)
        stood = np.zeros(len(places), np.bool_)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                stood |= np.isin(cells + dy * ROW + dx, self._cells)
        return ~stood


def rim_of(footprint: F64) -> F64:
    """Return points (N, 2) `RIM` metres outside a convex, counter-clockwise footprint (M, 2): along its sides and beyond its corners."""
    edge = np.roll(footprint, -1, axis=0) - footprint
    normals = np.column_stack((edge[:, 1], -edge[:, 0])) / np.hypot(*edge.T)[:, None]
    share = np.linspace(0.0, 1.0, 25)[:, None, None]
    sides = (footprint + share * edge + RIM * normals).reshape(-1, 2)
    outward = normals + np.roll(normals, 1, axis=0)
    return np.concatenate((sides, footprint + RIM * outward / np.hypot(*outward.T)[:, None]))


def is_seen_near(places: F64, returns: F64) -> Flags:
    """Return bool (N,): whether any of the returns (M, 2) lies within `NEAR` of a place."""
    if len(places) == 0 or len(returns) == 0:
        return np.zeros(len(places), np.bool_)
    apart = np.hypot(*(places[:, None] - returns[None]).transpose(2, 0, 1))
    return np.asarray(apart.min(axis=1) <= NEAR)


def _cells(places: F64) -> NDArray[np.int64]:
    cells = np.floor(places / CELL).astype(np.int64)
    return np.asarray(cells[:, 1] * ROW + cells[:, 0])
