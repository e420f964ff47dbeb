"""Planning where the map does not reach: a grid is laid in unknown ground that holds the robot, the goal and a margin around both."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import GoalOutsideMapError
from ambler.core.grid import COST_UNKNOWN, GridSpec

BLOCK = 64  # cells; the grid grows by whole blocks, so that it does not change with every step of the robot
MOST, LONGEST = 40_000_000, 32_000  # cells, in all and along a side: about 300 x 300 m in cells of 0.05 m


def with_surroundings(
    costs: NDArray[np.uint8], spec: GridSpec, points: list[tuple[float, float]], margin: float
) -> tuple[NDArray[np.uint8], GridSpec]:
    """Return costs uint8 [iy, ix] of a grid that reaches `margin` metres beyond the given one and beyond each of `points` (x, y), unknown where the
    given one does not reach, and its geometry. Raises GoalOutsideMapError where that takes more than `MOST` cells."""
    step = BLOCK * spec.resolution
    far = [(spec.origin_x, spec.origin_y)]
    far.append((spec.origin_x + spec.width * spec.resolution, spec.origin_y + spec.height * spec.resolution))
    far += [point for point in points if math.isfinite(point[0] + point[1])]
    low = [min(p[axis] for p in far) - margin for axis in (0, 1)]
    high = [max(p[axis] for p in far) + margin for axis in (0, 1)]
    left, down = (math.ceil((o - v) / step) * BLOCK for o, v in zip((spec.origin_x, spec.origin_y), low, strict=True))
    width = left + math.ceil((high[0] - spec.origin_x) / step) * BLOCK
    height = down + math.ceil((high[1] - spec.origin_y) / step) * BLOCK
    if width * height > MOST or max(width, height) > LONGEST:
        size = f"{width * spec.resolution:.0f} x {height * spec.resolution:.0f} m"
        raise GoalOutsideMapError(f"the goal is too far away: no plan is made in unknown ground of {size}")
    wide = GridSpec(
        *(spec.resolution, width, height),
        *(spec.origin_x - left * spec.resolution, spec.origin_y - down * spec.resolution),
    )
    out = np.full(wide.shape, COST_UNKNOWN, np.uint8)
    out[down : down + spec.height, left : left + spec.width] = costs
    return out, wide
