"""The way out for a robot whose own cell is forbidden: it stands too close to an obstacle, in one, or on an unknown cell."""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import StartOccupiedError
from ambler.core.grid import COST_INSCRIBED

INSCRIBED_WEIGHT, LETHAL_WEIGHT = 10.0, 1000.0
Cell = tuple[int, int]


def find_escape(
    costs: NDArray[np.uint8],
    is_allowed: NDArray[np.bool_],
    start: Cell,
    radius: float,
    reach: float = 0.0,
    goal: Cell | None = None,
) -> list[Cell]:
    """Return the cells (iy, ix) from the start to the first allowed cell; only the start itself when that is allowed.

    Least cost within `radius` cells: a step into an inscribed cell counts 10 times, into a lethal or unknown one 1000 times
    its length, so that the robot leaves a wall on its own side. Beyond, up to `reach` cells, only over inscribed cells: along a gap that is too narrow to turn in.
    A pocket, allowed cells that lead nowhere farther than `radius`, is left too, over inscribed cells, unless the goal lies in it or nothing else
    is allowed, and so is the next one, where cells touch at corners only: the cells on which a robot stands count as free, whatever was marked around it. `is_allowed` bool [iy, ix]. Raises StartOccupiedError.
    """
    height, width = costs.shape
    best: dict[Cell, float] = {start: 0.0}
    came_from: dict[Cell, Cell] = {}
    pockets: set[Cell] = set()
    in_pocket: Cell | None = None
    queue = [(0.0, start)]
    while queue:
        cost, cell = heapq.heappop(queue)
        if cost > best[cell] or (in_pocket is not None and not _is_crossed(costs, is_allowed, cell)):
            continue
        if is_allowed[cell] and cell not in pockets:
            pocket = _pocket_of(is_allowed, cell, radius)
            if pocket is None or goal in pocket:
                return _way_to(cell, came_from)
            pockets |= pocket
            in_pocket = cell if in_pocket is None else in_pocket
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                iy, ix = cell[0] + dy, cell[1] + dx
                if not (0 <= iy < height and 0 <= ix < width):
                    continue
                beside = ((cell[0], ix), (iy, cell[1]))  # of a diagonal step: no corner of a wall is cut
                if not all(side in (cell, (iy, ix)) or _is_crossed(costs, is_allowed, side) for side in beside):
                    continue
                is_crossed = _is_crossed(costs, is_allowed, (iy, ix))
                if math.hypot(iy - start[0], ix - start[1]) > (max(radius, reach) if is_crossed else radius):
                    continue
                factor = 1.0 if is_allowed[iy, ix] else LETHAL_WEIGHT
                if costs[iy, ix] == COST_INSCRIBED:
                    factor = INSCRIBED_WEIGHT
                total = cost + math.hypot(dy, dx) * factor
                if total < best.get((iy, ix), math.inf):
                    best[iy, ix] = total
                    came_from[iy, ix] = cell
                    heapq.heappush(queue, (total, (iy, ix)))
    if in_pocket is not None:
        return _way_to(in_pocket, came_from)
    raise StartOccupiedError("the robot stands on an occupied or unknown place, with no free one within its own radius")


def _is_crossed(costs: NDArray[np.uint8], is_allowed: NDArray[np.bool_], cell: Cell) -> bool:
    """Say whether a robot may cross a cell though its body may not fit there in every heading: no wall, and known."""
    return bool(is_allowed[cell]) or costs[cell] == COST_INSCRIBED


def _way_to(cell: Cell, came_from: dict[Cell, Cell]) -> list[Cell]:
    way = [cell]
    while way[-1] in came_from:
        way.append(came_from[way[-1]])
    return way[::-1]


def _pocket_of(is_allowed: NDArray[np.bool_], cell: Cell, radius: float) -> set[Cell] | None:
    """Return the allowed cells that hang together with one as the searches see it, None if some lie farther than `radius` from it."""
    height, width = is_allowed.shape
    pocket, stack = {cell}, [cell]
    while stack:
        y, x = stack.pop()
        if math.hypot(y - cell[0], x - cell[1]) > radius:
            return None
        for iy, ix in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):  # no corner is cut
            is_inside = 0 <= iy < height and 0 <= ix < width
            if is_inside and is_allowed[iy, ix] and (iy, ix) not in pocket:
                pocket.add((iy, ix))
                stack.append((iy, ix))
    return pocket
