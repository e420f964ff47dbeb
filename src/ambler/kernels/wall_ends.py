"""Where walls that end in the unknown would go on: straight, as far as nothing else is known.

What ends a seen wall in front of unknown ground is mostly whatever hid the rest of it, seldom a door. Cells are [iy, ix], lengths in cells.
"""

import math

import numpy as np

from ambler.kernels.jit import jit

THIN = 2.0  # square cells: how far the cells of a wall may scatter across it
ONE_SIDED = 0.3  # of the radius: how far the middle of a wall's cells lies from its end
MARGIN = 2  # cells from an end within which the wall may still be seen


@jit
def continue_walls(costs, lethal, blocked, unknown, radius, reach, out):
    """Mark in `out` uint8 the unknown cells on the straight continuation of walls, up to `reach` cells from their ends.

    `costs` uint8: `lethal` is a wall, `unknown` not known; from `blocked` on a cell may be either, beside a wall. A cell is an end when the wall's cells within `radius` of it lie along a line, on one side of it (principal
    axes). Free cells and other walls end a continuation.
    """
    ny, nx = costs.shape
    for iy in range(ny):
        for ix in range(nx):
            if costs[iy, ix] != lethal:
                continue
            uy, ux = _end(costs, lethal, iy, ix, radius)
            if uy == 0.0 and ux == 0.0:
                continue
            for t in range(1, reach + 1):
                jy, jx = int(math.floor(iy + t * uy + 0.5)), int(math.floor(ix + t * ux + 0.5))
                if jy < 0 or jx < 0 or jy >= ny or jx >= nx:
                    break
                cost = costs[jy, jx]
                if cost < blocked or (cost == lethal and t > MARGIN):
                    break
                if cost == unknown:
                    out[jy, jx] = 1


@jit
def _end(costs, lethal, iy, ix, radius):
    """Return the direction (y, x) in which the wall of a cell would go on, zeros where it is no end of a straight one."""
    ny, nx = costs.shape
    n, sy, sx, syy, sxx, sxy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for jy in range(max(0, iy - radius), min(ny, iy + radius + 1)):
        for jx in range(max(0, ix - radius), min(nx, ix + radius + 1)):
            dy, dx = float(jy - iy), float(jx - ix)
            if costs[jy, jx] != lethal or dy * dy + dx * dx > radius * radius:
                continue
            n += 1
            sy, sx, syy, sxx, sxy = sy + dy, sx + dx, syy + dy * dy, sxx + dx * dx, sxy + dx * dy
    if n < radius // 2:
        return 0.0, 0.0
    my, mx = sy / n, sx / n
    a, b, c = syy / n - my * my, sxy / n - mx * my, sxx / n - mx * mx
    middle, half = 0.5 * (a + c), math.hypot(0.5 * (a - c), b)
    if middle - half > THIN:
        return 0.0, 0.0
    angle = 0.5 * math.atan2(2.0 * b, c - a)
    uy, ux = math.sin(angle), math.cos(angle)
    along = my * uy + mx * ux
    if abs(along) < ONE_SIDED * radius:
        return 0.0, 0.0
    if along > 0.0:
        return -uy, -ux
    return uy, ux


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    continue_walls(np.zeros((4, 4), np.uint8), 254, 253, 255, 2, 2, np.zeros((4, 4), np.uint8))
