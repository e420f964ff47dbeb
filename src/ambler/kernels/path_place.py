"""Kernels on a path float64 (P, 4) of (x, y, arc length, heading): where somebody is on it, how far it goes on ahead, and whether it is free."""

import math

import numpy as np

from ambler.kernels.jit import jit


@jit
def place_on_path(points, x, y, spacing, near, reach):
    """Return the arc length of the place of a path that is nearest to (x, y): of those points that lie within `reach` metres of path from the arc length `near`, and up to
    `spacing` behind it towards the next one."""
    best, at = math.inf, 0
    for k in range(points.shape[0]):
        away = math.hypot(points[k, 0] - x, points[k, 1] - y)
        if abs(points[k, 2] - near) <= reach and away < best:
            best, at = away, k
    along = points[at, 2]
    if at + 1 < points.shape[0]:
        dx, dy = points[at + 1, 0] - points[at, 0], points[at + 1, 1] - points[at, 1]
        ahead = (x - points[at, 0]) * dx + (y - points[at, 1]) * dy
        along += min(spacing, max(0.0, ahead / max(1e-9, math.hypot(dx, dy))))
    return along


@jit
def end_of_stretch(points, first, until, turn_back, seen):
    """Return the index behind the last point of a path that begins at `first`: up to the arc length `until`, and beyond the arc length `seen` no farther than where it has turned by `turn_back` radians."""
    turned = 0.0
    for k in range(first + 1, points.shape[0]):
        turned += (points[k, 3] - points[k - 1, 3] + math.pi) % (2.0 * math.pi) - math.pi
        if points[k, 2] > until or (abs(turned) > turn_back and points[k, 2] > seen):
            return k
    return points.shape[0]


@jit
def cells_of_path(points, resolution, cells):
    """Write the cells int32 (P, 2) of (iy, ix) of the points of a path that is measured from a grid's corner."""
    for k in range(points.shape[0]):
        cells[k, 0], cells[k, 1] = math.floor(points[k, 1] / resolution), math.floor(points[k, 0] / resolution)


@jit
def leads_too_near(points, distance, resolution, radius):
    """Whether a path, measured from the corner of the grid `distance` float64 (H, W), leads through one of its cells that is less than `radius` from something lethal."""
    for k in range(points.shape[0]):
        iy, ix = math.floor(points[k, 1] / resolution), math.floor(points[k, 0] / resolution)
        if 0 <= iy < distance.shape[0] and 0 <= ix < distance.shape[1] and distance[iy, ix] < radius:
            return True
    return False


def warm_up() -> None:
    """Compile every kernel of this module."""
    points = np.array([[0.0, 0.0, 0.0, 0.0], [0.1, 0.0, 0.1, 0.0]])
    place_on_path(points, 0.0, 0.0, 0.05, 0.0, math.inf)
    end_of_stretch(points, 0, 1.0, 2.0, 0.5)
    cells_of_path(points, 0.05, np.empty((2, 2), np.int32))
    leads_too_near(points, np.zeros((3, 3)), 0.05, 0.1)
