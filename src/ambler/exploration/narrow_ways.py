"""What keeps the robot out: the narrowest place on the widest way to where it cannot go."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.messages import Frontier, OccupancyGrid

Mask = NDArray[np.bool_]
CELLS_MOST = 100_000  # that are looked at, a third of a second: what lies farther behind a narrow place than that is told without a width
AROUND = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx)


@dataclass(frozen=True, slots=True)
class NarrowPlace:
    """How wide (m, to a cell, between the middles of what is beside it) the ground is that robots move on, and where (m)."""

    width: float
    x: float
    y: float

    def __str__(self) -> str:
        return f"about {self.width:.2f} m wide at ({self.x:.2f}, {self.y:.2f})"


def tell_narrow_ways(
    frontiers: Sequence[Frontier],
    occupancy: OccupancyGrid,
    free_below: int,
    reached: Mask,
    *,
    near: float,
    width: float,
) -> tuple[Frontier, ...]:
    """Return the frontiers, with the narrowest place of the widest way in the reason of each that is at least as long as the robot's `width` (m) and not come near: no
    free ground within `near` metres (along each axis) of its middle is `reached`, [iy, ix], because ways there are less than twice as wide as the robot."""
    spec, steps = occupancy.spec, round(near / occupancy.spec.resolution)
    is_free = (occupancy.data >= 0) & (occupancy.data < free_below)
    wanted = np.zeros(spec.shape, np.int32)
    for number, frontier in enumerate(frontiers, 1):
        if len(frontier.cells) * spec.resolution < width:
            continue
        iy, ix = spec.cell_of(*min(frontier.cells.tolist(), key=lambda cell: math.dist(cell, frontier.centroid)))
        y0, x0 = max(0, iy - steps), max(0, ix - steps)
        around = np.s_[y0 : iy + steps + 1, x0 : ix + steps + 1]
        pieces, _ = ndimage.label(is_free[around], np.ones((3, 3)))  # not through a wall
        is_near = pieces == pieces[iy - y0, ix - x0]
        if is_free[iy, ix] and not reached[around][is_near].any():
            wanted[around][is_near] = number
    told = list(frontiers)
    for number, place in narrowest_places(occupancy, free_below, reached, wanted).items():
        if place.width < 2.0 * width:
            reason = f"{frontiers[number - 1].reason}; the widest way there is {place}"
            told[number - 1] = replace(frontiers[number - 1], reason=reason)
    return tuple(told)


def narrowest_places(
    occupancy: OccupancyGrid, free_below: int, reached: Mask, wanted: NDArray[np.int32]
) -> dict[int, NarrowPlace]:
    """Return for each number in `wanted`, [iy, ix], 0 for none, the narrowest place of the widest way to its cells from those that are
    `reached`; not of what no free ground joins to them. Unknown cells narrow nothing: there may be ground.

    A search for paths of the greatest bottleneck: the widest cell first, as Dijkstra's with the least of a path for the sum.
    """
    data, spec = occupancy.data, occupancy.spec
    clearance = cv2.distanceTransform((data < free_below).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    labels, _ = ndimage.label((data >= 0) & (data < free_below) & ~reached, np.ones((3, 3)))
    is_beyond = np.isin(labels, np.unique(labels[(wanted > 0) & (labels > 0)]))
    beside = is_beyond & cv2.dilate(reached.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    heap = [(-float(clearance[iy, ix]), (iy, ix), (iy, ix)) for iy, ix in np.argwhere(beside).tolist()]
    heapq.heapify(heap)
    is_done = ~is_beyond
    found: dict[int, NarrowPlace] = {}
    numbers, left = len(np.unique(wanted[is_beyond & (wanted > 0)])), CELLS_MOST
    while heap and len(found) < numbers and left > 0:
        least, (iy, ix), narrowest = heapq.heappop(heap)
        if is_done[iy, ix]:
            continue
        is_done[iy, ix] = True
        left -= 1
        number = int(wanted[iy, ix])
        if number and number not in found:
            found[number] = NarrowPlace(-2.0 * least * spec.resolution, *spec.center_of(*narrowest))
        for dy, dx in AROUND:
            jy, jx = iy + dy, ix + dx
            if 0 <= jy < spec.height and 0 <= jx < spec.width and not is_done[jy, jx]:
                here = -float(clearance[jy, jx])
                heapq.heappush(heap, (here, (jy, jx), (jy, jx)) if here > least else (least, (jy, jx), narrowest))
    return found
