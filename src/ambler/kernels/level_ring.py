"""The returns of a cloud at the height of its scanner, as a planar scan."""

import math

import numpy as np

from ambler.kernels.jit import jit


@jit
def level_ring(points, intensity, times, sweep, slope, ranges, intensities):
    """Write the returns that rise or fall by less than `slope` (m per m) on their way into a planar scan of B beams, counter-clockwise from -pi; of those in one beam the most level one counts.

    `points` float32 (N, 3), `intensity`, `times` float32 (N,); `sweep` float64 (K, 3, 4): where the scanner was, at equal times from the scan's stamp to its last point, in one level frame. `ranges`,
    `intensities` float32 (B,), NaN and 0 where nothing is: from the place of the scanner at its stamp.
    """
    beams, count = len(ranges), len(sweep)
    ranges[:] = np.nan
    intensities[:] = 0.0
    level = np.full(beams, slope)
    last = 1e-9
    for i in range(len(times)):
        last = max(last, times[i])
    x0, y0 = sweep[0, 0, 3], sweep[0, 1, 3]
    for i in range(len(points)):
        m = sweep[max(0, min(int(times[i] / last * (count - 1) + 0.5), count - 1))]
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        rise = m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz
        way = math.sqrt(max(px * px + py * py + pz * pz - rise * rise, 1e-12))
        steep = abs(rise) / way
        if not steep < slope:
            continue
        dx = m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3] - x0
        dy = m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3] - y0
        k = int((math.atan2(dy, dx) + math.pi) * beams / (2.0 * math.pi) + 0.5) % beams
        if steep < level[k]:
            level[k], ranges[k], intensities[k] = steep, math.hypot(dx, dy), intensity[i]


def warm_up() -> None:
    """Compile every kernel with its real dtypes; clouds that come from messages are read-only."""
    points, values = np.ones((2, 3), np.float32), np.ones(2, np.float32)
    points.flags.writeable = values.flags.writeable = False
    sweep = np.tile(np.eye(3, 4), (2, 1, 1))
    level_ring(points, values, values, sweep, 0.1, np.empty(8, np.float32), np.empty(8, np.float32))
