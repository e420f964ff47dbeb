"""Kernels that match two scans of any two planar scanners: point to line, neighbours found by their bearing.

Lines are fitted to the neighbouring beams of the target, so that the noise of single beams averages out (PLICP: Censi 2008).
"""

import math

import numpy as np

from ambler.kernels.bearing import turn_of
from ambler.kernels.jit import jit
from ambler.kernels.scan_points import carry

REACH = 3


@jit
def place_scan(ranges, beam, sign, limits, middle, twist, points):
    """Write the returns of one scan as points float64 (M, 2) of the sensor frame at its middle; returns M.

    `beam` (angle_min, angle_increment, time_increment), `sign` -1 for a scanner upside down, `limits` (nearest, farthest) used,
    `middle` seconds from the first beam to the reference instant, `twist` (vx, vy, wz) of the sensor.
    """
    m = 0
    for i in range(ranges.shape[0]):
        r = float(ranges[i])
        if not limits[0] <= r <= limits[1]:
            continue
        a = sign * (beam[0] + i * beam[1])
        x, y = carry(r * math.cos(a), r * math.sin(a), i * beam[2] - middle, twist)
        points[m, 0] = x
        points[m, 1] = y
        m += 1
    return m


@jit
def fit_lines(points, count, radius, half_width, max_spread, lines, cells):
    """Fit a line to each point's neighbours in beam order (up to `half_width` on each side, within `radius` metres).

    `lines` float64 (N, 4): centroid and unit normal, or a zero normal where fewer than five neighbours lie together or they
    spread more than `max_spread` (m, RMS) off the line. `cells` int32 (C,) is filled with the point seen in each of C bearings.
    """
    for c in range(cells.shape[0]):
        cells[c] = -1
    for i in range(count):
        sx = sy = sxx = sxy = syy = 0.0
        n = 0
        for side in (-1, 1):
            j = i if side < 0 else i + 1
            while 0 <= j < count and abs(j - i) <= half_width:
                dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
                if dx * dx + dy * dy > radius * radius:
                    break
                sx += dx
                sy += dy
                sxx += dx * dx
                sxy += dx * dy
                syy += dy * dy
                n += 1
                j += side
        lines[i, 2] = 0.0
        lines[i, 3] = 0.0
        if n < 5:
            continue
        mx, my = sx / n, sy / n
        cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
        half = 0.5 * (cxx + cyy)
        root = math.sqrt(0.25 * (cxx - cyy) ** 2 + cxy * cxy)
        small = max(half - root, 0.0)
        if small > max_spread * max_spread or half + root < 9.0 * small:
            continue
        angle = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
        lines[i, 0] = points[i, 0] + mx
        lines[i, 1] = points[i, 1] + my
        lines[i, 2] = -math.sin(angle)
        lines[i, 3] = math.cos(angle)
        c = int((turn_of(points[i, 1], points[i, 0]) + 0.5) * cells.shape[0]) % cells.shape[0]
        cells[c] = i


@jit
def _nearest_line(x, y, gate, points, cells):
    """Return the index of the nearest point with a line within `gate`, searched among the bearings next to (x, y), or -1."""
    cell_count = cells.shape[0]
    c = int((turn_of(y, x) + 0.5) * cell_count)
    best = -1
    best2 = gate * gate
    for k in range(c - REACH, c + REACH + 1):
        j = cells[k % cell_count]
        if j >= 0:
            d2 = (points[j, 0] - x) ** 2 + (points[j, 1] - y) ** 2
            if d2 < best2:
                best, best2 = j, d2
    return best


@jit
def match_scans(
    source, source_lines, source_count, target, target_lines, target_count, cells, gates, huber, pose, hessian, stats
):
    """Refine target_from_source `pose` float64 (3,) in place by Gauss-Newton, perturbed on the right.

    One iteration per entry of `gates` (m, how far a neighbour may lie); `huber` (m) is where residuals stop to count fully.
    Writes the information float64 (3, 3) for residuals of unit variance, and `stats` (5,): residual RMS (m), inliers,
    inlier ratio, last step (m), smallest share of the information in one direction of translation.
    """
    gradient = np.zeros(3)
    step = 0.0
    for it in range(gates.shape[0]):
        for a in range(3):
            gradient[a] = 0.0
            for b in range(3):
                hessian[a, b] = 0.0
        c, s = math.cos(pose[2]), math.sin(pose[2])
        total = 0.0
        weight_sum = 0.0
        n = 0
        tried = 0
        for i in range(source_count):
            nx, ny = source_lines[i, 2], source_lines[i, 3]
            if nx == 0.0 and ny == 0.0:
                continue
            tried += 1
            px, py = source[i, 0], source[i, 1]
            x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
            j = _nearest_line(x, y, gates[it], target, cells)
            if j < 0:
                continue
            lx, ly = target_lines[j, 2], target_lines[j, 3]
            if abs(lx * (c * nx - s * ny) + ly * (s * nx + c * ny)) < 0.85:
                continue
            e = lx * (x - target_lines[j, 0]) + ly * (y - target_lines[j, 1])
            w = 1.0 if abs(e) <= huber else huber / abs(e)
            jx, jy = lx * c + ly * s, -lx * s + ly * c
            jw = jy * px - jx * py
            hessian[0, 0] += w * jx * jx
            hessian[0, 1] += w * jx * jy
            hessian[0, 2] += w * jx * jw
            hessian[1, 1] += w * jy * jy
            hessian[1, 2] += w * jy * jw
            hessian[2, 2] += w * jw * jw
            gradient[0] += w * jx * e
            gradient[1] += w * jy * e
            gradient[2] += w * jw * e
            total += w * e * e
            weight_sum += w
            n += 1
        hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
        stats[1] = n
        stats[2] = n / max(tried, 1)
        stats[0] = math.sqrt(total / max(weight_sum, 1e-9))
        half = 0.5 * (hessian[0, 0] + hessian[1, 1])
        root = math.sqrt(0.25 * (hessian[0, 0] - hessian[1, 1]) ** 2 + hessian[0, 1] ** 2)
        stats[4] = (half - root) / max(half + root, 1e-9)
        det = (
            hessian[0, 0] * (hessian[1, 1] * hessian[2, 2] - hessian[1, 2] ** 2)
            - hessian[0, 1] * (hessian[0, 1] * hessian[2, 2] - hessian[1, 2] * hessian[0, 2])
            + hessian[0, 2] * (hessian[0, 1] * hessian[1, 2] - hessian[1, 1] * hessian[0, 2])
        )
        if n < 20 or det <= 1e-9 * half * half * max(hessian[2, 2], 1e-9):
            stats[3] = math.inf
            return
        d = np.linalg.solve(hessian, gradient)
        pose[0] -= c * d[0] - s * d[1]
        pose[1] -= s * d[0] + c * d[1]
        pose[2] -= d[2]
        step = math.hypot(d[0], d[1]) + abs(d[2])
        stats[3] = step


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    points, lines, cells = np.zeros((4, 2)), np.zeros((4, 4)), np.zeros(16, np.int32)
    three = np.zeros(3)
    n = place_scan(np.ones(4, np.float32), three, 1.0, np.array([0.1, 9.0]), 0.0, three, points)
    fit_lines(points, n, 0.3, 4, 0.03, lines, cells)
    match_scans(points, lines, n, points, lines, n, cells, np.ones(1), 0.03, np.zeros(3), np.zeros((3, 3)), np.zeros(5))
