"""Kernels that flatten a cloud into the bins of a virtual planar scanner, block by block."""

import math

import numpy as np

from ambler.kernels.bearing import turn_of_single
from ambler.kernels.jit import jit, jit_fused
from ambler.kernels.scan_motion import BLOCK, carry_block
from ambler.kernels.self_mask import is_inside

ZERO, HALF, INF = np.float32(0.0), np.float32(0.5), np.float32(np.inf)


@jit_fused
def _place_points(cloud, m, x, y, z):
    """Write the points of a block in the base frame; `m` float32 (3, 4)."""
    for i in range(cloud.shape[0]):
        px, py, pz = cloud[i, 0], cloud[i, 1], cloud[i, 2]
        x[i] = m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3]
        y[i] = m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3]
        z[i] = m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3]


@jit_fused
def _is_any_near(x, y, reach2):
    near = np.int32(0)
    limit = np.float32(reach2)
    for i in range(x.shape[0]):
        near = np.int32(near + np.int32(x[i] * x[i] + y[i] * y[i] <= limit))
    return near > 0


@jit_fused
def _sort_points(x, y, z, origin, band, limits, bins, hits, passes, cells, fates):
    """Write each point's bin, its fate (the index in the counts of `cloud_to_bins`), and what it tells its bin.

    `hits` is the distance of a used point (else +inf), `passes` how far the ray of another one is free (else -inf).
    """
    ox, oy, c, s = np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2]), np.float32(origin[3])
    oz, low, high = np.float32(origin[4]), np.float32(band[0]), np.float32(band[1])
    near, far, width = np.float32(limits[0]), np.float32(limits[1]), np.float32(bins)
    below = oz - low if low < oz < high else ZERO
    above = oz - high if low < oz < high else ZERO
    for i in range(x.shape[0]):
        dx, dy = x[i] - ox, y[i] - oy
        d = np.sqrt(dx * dx + dy * dy)
        is_below, is_above, is_far = z[i] < low, z[i] > high, d > far
        is_outside = is_below | is_above
        fate = np.uint8(3) if is_far | (d < near) else np.uint8(0)
        fate = np.uint8(1) if is_outside else fate
        fate = fate if abs(z[i]) + d < INF else np.uint8(4)
        inside = (below if is_below else above) / (oz - z[i])
        free = d * inside if is_outside else (INF if is_far else ZERO)
        hits[i] = d if fate == 0 else INF
        passes[i] = free if ((fate == 1) | (fate == 3)) & (free > ZERO) else -INF
        fates[i] = fate
        cell = np.int32((turn_of_single(c * dy - s * dx, c * dx + s * dy) + HALF) * width + HALF)
        cell = cell - bins if cell >= bins else cell
        cells[i] = cell if fate < 4 else np.int32(0)


@jit_fused
def _count_fates(fates, counts):
    outside = far = invalid = np.int32(0)
    for i in range(fates.shape[0]):
        outside = np.int32(outside + np.int32(fates[i] == 1))
        far = np.int32(far + np.int32(fates[i] == 3))
        invalid = np.int32(invalid + np.int32(fates[i] == 4))
    counts[0] += fates.shape[0] - outside - far - invalid
    counts[1] += outside
    counts[3] += far
    counts[4] += invalid


@jit
def cloud_to_bins(
    cloud, times, base_from_sensor, twist, vertices, starts, mask_reach, origin, band, limits, ranges, reach, counts
):
    """Flatten a cloud into the bins of a virtual scanner: the nearest return inside the height band of each azimuth.

    `cloud` float32 (N, 3) in the sensor frame, `times` float32 (N,) seconds after the common time, `twist` (vx, vy, wz) of the
    base over the cloud, `origin` (x, y, cos, sin, z) of the virtual scanner in the base frame, `band` (z_min, z_max) in the
    base frame, `limits` (range_min, range_max). Lowers `ranges` float32 (B,); raises `reach` float32 (B,) to how far the
    rays of the bin are known free inside the band, seen from the virtual origin at height z. `counts` int64 (5,): used,
    outside the band, on the robot itself, outside the range limits, not finite.
    """
    bins = np.int32(ranges.shape[0])
    work = np.empty((5, BLOCK), np.float32)
    cells, fates = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.uint8)
    matrix, standing = base_from_sensor.astype(np.float32), np.zeros(3)
    moves = twist[0] != 0.0 or twist[1] != 0.0 or twist[2] != 0.0
    for first in range(0, cloud.shape[0], BLOCK):
        n = min(first + BLOCK, cloud.shape[0]) - first
        x, y, z, hits, passes = work[0, :n], work[1, :n], work[2, :n], work[3, :n], work[4, :n]
        _place_points(cloud[first : first + n], matrix, x, y, z)
        if _is_any_near(x, y, mask_reach * mask_reach):
            for i in range(n):
                if x[i] * x[i] + y[i] * y[i] <= mask_reach * mask_reach and is_inside(x[i], y[i], vertices, starts):
                    counts[2] += 1
                    counts[4] -= 1
                    z[i] = math.nan
        if moves:
            carry_block(x, y, times[first : first + n], twist, standing)
        _sort_points(x, y, z, origin, band, limits, bins, hits, passes, cells[:n], fates[:n])
        _count_fates(fates[:n], counts)
        for i in range(n):
            k = cells[i]
            ranges[k] = min(ranges[k], hits[i])
            reach[k] = max(reach[k], passes[i])


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    n, bins, two = 4, 8, np.array([0.0, 10.0])
    cloud_to_bins(
        np.ones((n, 3), np.float32), np.zeros(n, np.float32), np.ascontiguousarray(np.eye(4)[:3]), np.zeros(3),
        np.zeros((0, 2)), np.zeros(1, np.int64), 0.0, np.array([0.0, 0.0, 1.0, 0.0, 0.5]), two, two,
        np.full(bins, np.inf, np.float32), np.zeros(bins, np.float32), np.zeros(5, np.int64),
    )  # fmt: skip
