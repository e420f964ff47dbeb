"""The lowest points that a cloud showed lately, in the odom frame: the floor between a robot and the nearest ring of beams that meets it.

A scanner whose lowest beam meets the floor 3 m away sees a slope that begins nearer only as points that stand higher than the robot. Driving towards it, the robot
has seen all of it. What is kept are points, not a verdict: what of them is floor is asked anew at every scan, outwards from the robot.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.se3 import SE3

F64 = NDArray[np.float64]

CELL = 0.1  # metres; of which the lowest point counts
MOST_OFF = 0.06  # metres between what is seen and what is remembered, of the quarter of places that agrees best: more, and odometry has jumped
LEVELS = 1 << 16  # millimetres of height that are told apart
LEAST_BOTH = 30  # cells that are seen again, for that to be judged


class FloorMemory:
    """`update` it with every cloud. Points are forgotten `reach` metres from the robot, or after `max_travel` metres of its way, and all of them when they do not fit what is seen."""

    def __init__(self, reach: float, max_travel: float) -> None:
        self._reach, self._max_travel = reach, max_travel
        self._lows_odom = np.empty((0, 3))
        self._seen_at = np.empty(0)
        self._travel = 0.0
        self._at: F64 | None = None

    def update(self, points: F64, odom_from_level: SE3, under: float) -> F64:
        """Take points (N, 3) in a level frame that stands on the floor under the robot, and return what is remembered where none of them lies, float64
        (M, 3) in the same frame. Points within `under` metres are the robot's own."""
        here = np.array(odom_from_level.translation)
        self._travel += 0.0 if self._at is None else float(np.linalg.norm(here - self._at))
        self._at = here
        is_beyond = points[:, 0] ** 2 + points[:, 1] ** 2 > under * under
        lows = _lowest(np.asarray(odom_from_level.transform(points[is_beyond])))
        away = self._lows_odom[:, :2] - here[:2]
        is_kept = (self._travel - self._seen_at < self._max_travel) & ((away**2).sum(axis=1) < self._reach**2)
        kept, seen_at = self._lows_odom[is_kept], self._seen_at[is_kept]
        is_again, of_seen = _found_in(_cells(kept), _cells(lows))
        if is_again.sum() >= LEAST_BOTH and np.quantile(np.abs(kept[is_again, 2] - lows[of_seen, 2]), 0.25) > MOST_OFF:
            is_again[:] = True
        kept, seen_at = kept[~is_again], seen_at[~is_again]
        self._lows_odom = np.concatenate((lows, kept))
        self._seen_at = np.concatenate((np.full(len(lows), self._travel), seen_at))
        return np.asarray(odom_from_level.inverse().transform(kept))


def _cells(points: F64) -> NDArray[np.int64]:
    cells = np.floor(points[:, :2] / CELL).astype(np.int64)
    return np.asarray((cells[:, 0] << 20) + cells[:, 1], np.int64)


def _lowest(points: F64) -> F64:
    """Return the lowest point, to the millimetre, of every cell, ordered by cell."""
    cells = _cells(points)
    height = np.clip(1000.0 * (points[:, 2] - points[:, 2].min(initial=0.0)), 0.0, LEVELS - 1.0)
    order = np.argsort(cells * LEVELS + height.astype(np.int64))
    is_first = np.ones(len(order), np.bool_)
    is_first[1:] = np.diff(cells[order]) > 0
    return points[order[is_first]]


def _found_in(wanted: NDArray[np.int64], sorted_cells: NDArray[np.int64]) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return bool (N,), whether a cell is one of the sorted ones, and the place (M,) of those that are."""
    if len(sorted_cells) == 0:
        return np.zeros(len(wanted), np.bool_), np.empty(0, np.intp)
    at = np.minimum(np.searchsorted(sorted_cells, wanted), len(sorted_cells) - 1)
    is_found = sorted_cells[at] == wanted
    return is_found, at[is_found]
