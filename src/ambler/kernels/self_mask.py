"""Kernels that say which points lie on the robot itself: polygons of its base frame, even-odd rule."""

import numpy as np

from ambler.kernels.jit import jit


@jit
def is_inside(x, y, vertices, starts):
    """Say whether a point lies in any of the polygons (even-odd rule). `vertices` (M, 2); polygon k is starts[k]:starts[k+1]."""
    for k in range(starts.shape[0] - 1):
        inside = False
        j = starts[k + 1] - 1
        for i in range(starts[k], starts[k + 1]):
            yi, yj = vertices[i, 1], vertices[j, 1]
            if (yi > y) != (yj > y):
                cut = vertices[i, 0] + (y - yi) * (vertices[j, 0] - vertices[i, 0]) / (yj - yi)
                if x < cut:
                    inside = not inside
            j = i
        if inside:
            return True
    return False


@jit
def mask_points(points, vertices, starts, out):
    """Write to `out` uint8 (N,) whether each point (N, 2) lies in any of the polygons."""
    for i in range(points.shape[0]):
        out[i] = is_inside(points[i, 0], points[i, 1], vertices, starts)


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    mask_points(np.zeros((1, 2)), np.zeros((0, 2)), np.zeros(1, np.int64), np.zeros(1, np.uint8))
