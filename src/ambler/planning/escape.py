"""The way out for a robot whose own cell is forbidden: it stands too close to an obstacle, in one, or on an unknown cell."""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import StartOccupiedError
from ambler.core.grid import COST_INSCRIBED

INSCRIBED_WEIGHT, LETHAL_WEIGHT = 10.0, 1000.0


def find_escape(
    costs: NDArray[np.uint8], weights: NDArray[np.uint16], start: tuple[int, int], radius: float, reach: float = 0.0
) -> list[tuple[int, int]]:
    """Return the cells (iy, ix) from the start to the first allowed cell; only the start itself when that is allowed.

    Least cost within `radius` cells: a step into an inscribed cell counts 10 times, into a lethal or unknown one 1000 times
    its length, so that the robot leaves a wall on its own side. Beyond, up to `reach` cells, only over inscribed cells: along a gap that is too narrow to turn in. `weights` has a border of one cell, 0 is forbidden.
    Raises StartOccupiedError.
    """
    if weights[start[0] + 1, start[1] + 1]:
        return [start]
    height, width = costs.shape
    best: dict[tuple[int, int], float] = {start: 0.0}
    came_from: dict[tuple[int, int], tuple[int, int]] = {}
    queue = [(0.0, start)]
    while queue:
        cost, cell = heapq.heappop(queue)
        if cost > best[cell]:
            continue
        if weights[cell[0] + 1, cell[1] + 1]:
            way = [cell]
            while way[-1] != start:
                way.append(came_from[way[-1]])
            return way[::-1]
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                iy, ix = cell[0] + dy, cell[1] + dx
                if not (0 <= iy < height and 0 <= ix < width):
                    continue
                is_crossed = weights[iy + 1, ix + 1] or costs[iy, ix] == COST_INSCRIBED
                if math.hypot(iy - start[0], ix - start[1]) > (max(radius, reach) if is_crossed else radius):
                    continue
                factor = 1.0 if weights[iy + 1, ix + 1] else LETHAL_WEIGHT
                if costs[iy, ix] == COST_INSCRIBED:
                    factor = INSCRIBED_WEIGHT
                total = cost + math.hypot(dy, dx) * factor
                if total < best.get((iy, ix), math.inf):
                    best[iy, ix] = total
                    came_from[iy, ix] = cell
                    heapq.heappush(queue, (total, (iy, ix)))
    raise StartOccupiedError("the robot stands on an occupied or unknown place, with no free one within its own radius")
