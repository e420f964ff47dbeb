"""How far a filled footprint can move along one arc of constant velocity."""

import math

import numpy as np

from ambler.kernels.footprint import LethalCells, Outline, lethal_distance, lethal_row_sums
from ambler.kernels.jit import jit
from ambler.kernels.rollout import covered_at_start, covered_cells


@jit
def free_arc(start, twist, seconds, step, cells, outline):
    """Return for how many seconds (at most `seconds`) the footprint at `start` (x, y, yaw), from the grid's corner, can move with the
    body `twist` (vx, vy, wz), checked every `step` seconds. It may never cover more lethal cells than before."""
    count = max(1, int(math.ceil(seconds / step)))
    inside = covered_at_start(start, cells, outline)
    for k in range(1, count + 1):
        t = seconds * k / count
        a = twist[2] * t
        if abs(a) < 1e-9:
            dx, dy = twist[0] * t, twist[1] * t
        else:
            dx = (math.sin(a) * twist[0] - (1.0 - math.cos(a)) * twist[1]) / twist[2]
            dy = ((1.0 - math.cos(a)) * twist[0] + math.sin(a) * twist[1]) / twist[2]
        c0, s0 = math.cos(start[2]), math.sin(start[2])
        x, y = start[0] + c0 * dx - s0 * dy, start[1] + s0 * dx + c0 * dy
        c, s = math.cos(start[2] + a), math.sin(start[2] + a)
        inside = covered_cells(x, y, c, s, inside, cells, outline)
        if inside < 0:
            return seconds * (k - 1) / count
    return seconds


def warm_up() -> None:
    """Compile every kernel of this module."""
    n = 8
    sums, distance = np.zeros((n, n + 1), np.int32), np.empty((n, n))
    lethal_row_sums(np.zeros((n, n), np.uint8), 254, sums)
    lethal_distance(sums, 0.05, distance)
    normals = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    outline = Outline(normals, np.full(4, 0.1), np.array([[0.0, 0.0, 0.15]]))
    start, twist = np.array([0.2, 0.2, 0.0]), np.array([0.1, 0.0, 0.1])
    free_arc(start, twist, 1.0, 0.1, LethalCells(sums, distance, 0.05), outline)
