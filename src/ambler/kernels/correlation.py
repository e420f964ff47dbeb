"""Kernels that match points against a probability grid: exhaustive correlation (after Olson's RTCSM) and Gauss-Newton on a
bicubic surface (after Cartographer's scan matcher). Cells are uint16 probabilities, see `kernels.submap`.
"""

import math

import numpy as np

from ambler.kernels.jit import jit

P_LOW = 0.1
P_PER_VALUE = 0.8 / 32766.0
# On this surface the Gauss-Newton step is about twice as long as it should be, since J^T J leaves out the curvature of P: begun with less damping, most
# steps would go beyond the minimum and be taken back.
_FIRST_DAMPING = 1.0


@jit
def correlate(cells, frame, points, center, search, weights, unknown, sums, best):
    """Score every pose of a window around `center` and write the best into `best` float64 (4,): x, y, yaw, score.

    `cells` uint16 (H, W), `frame` (resolution, x, y of the outer corner), `points` float32 (N, 2) in the base frame,
    `center` float64 (3,); `search` (cells of half window, half angles, angle step); `weights` (translation, rotation) of the
    penalty exp(-(w_t |t| + w_r |a|)^2). A point in an unknown cell or beyond the border has the probability `unknown`. `sums` int32 (S, S), S >= 2 * cells + 1, is scratch, which takes 65 thousand points. Score = mean probability * penalty.
    """
    height, width = cells.shape
    n = points.shape[0]
    half = int(search[0])
    half_angles = int(search[1])
    size = 2 * half + 1
    inverse = 1.0 / frame[0]
    nothing = np.int32(round((unknown - P_LOW) / P_PER_VALUE))
    best[3] = -1.0
    for a in range(-half_angles, half_angles + 1):
        turn = a * search[2]
        yaw = center[2] + turn
        c, s = math.cos(yaw) * inverse, math.sin(yaw) * inverse
        ox, oy = (center[0] - frame[1]) * inverse, (center[1] - frame[2]) * inverse
        for iy in range(size):
            for ix in range(size):
                sums[iy, ix] = 0
        for i in range(n):
            px, py = points[i, 0], points[i, 1]
            jx = int(math.floor(ox + c * px - s * py)) - half
            jy = int(math.floor(oy + s * px + c * py)) - half
            if jx >= 0 and jy >= 0 and jx + size <= width and jy + size <= height:
                # Never negative: else the compiler asks of each cell whether it is.
                left, low = np.uint64(jx), np.uint64(jy)
                for iy in range(np.uint64(size)):
                    for ix in range(np.uint64(size)):
                        value = np.int32(cells[low + iy, left + ix])
                        sums[iy, ix] += value if value != 0 else nothing
            else:
                for iy in range(size):
                    for ix in range(size):
                        inside = 0 <= jy + iy < height and 0 <= jx + ix < width
                        value = np.int32(cells[jy + iy, jx + ix]) if inside else np.int32(0)
                        sums[iy, ix] += value if value != 0 else nothing
        for iy in range(size):
            for ix in range(size):
                mean = P_LOW + P_PER_VALUE * sums[iy, ix] / n
                if mean <= best[3]:
                    continue  # the penalty is a factor of at most 1
                tx, ty = (ix - half) * frame[0], (iy - half) * frame[0]
                cost = math.hypot(tx, ty) * weights[0] + abs(turn) * weights[1]
                score = mean * math.exp(-cost * cost)
                if score > best[3]:
                    best[0], best[1], best[2], best[3] = center[0] + tx, center[1] + ty, yaw, score


@jit
def _probability(cells, iy, ix, unknown):
    if 0 <= iy < cells.shape[0] and 0 <= ix < cells.shape[1]:
        value = cells[iy, ix]
        if value != 0:
            return P_LOW + P_PER_VALUE * (value - 1)
    return unknown


@jit
def surface(cells, fx, fy, unknown, row, slope, out):
    """Write Catmull-Rom bicubic probability and its gradient (per cell) at (fx, fy) cells into `out` float64 (3,); unknown cells have that of `unknown`.

    `row`, `slope` float64 (4,) are scratch. Cell (iy, ix) has its centre at (ix + 0.5, iy + 0.5).
    """
    gx, gy = fx - 0.5, fy - 0.5
    jx, jy = int(math.floor(gx)), int(math.floor(gy))
    u, v = gx - jx, gy - jy
    inside = jx >= 1 and jy >= 1 and jx + 2 < cells.shape[1] and jy + 2 < cells.shape[0]
    for k in range(4):
        iy = jy - 1 + k
        if inside:
            i0, i1, i2, i3 = cells[iy, jx - 1], cells[iy, jx], cells[iy, jx + 1], cells[iy, jx + 2]
            p0 = P_LOW + P_PER_VALUE * (i0 - 1.0) if i0 != 0 else unknown
            p1 = P_LOW + P_PER_VALUE * (i1 - 1.0) if i1 != 0 else unknown
            p2 = P_LOW + P_PER_VALUE * (i2 - 1.0) if i2 != 0 else unknown
            p3 = P_LOW + P_PER_VALUE * (i3 - 1.0) if i3 != 0 else unknown
        else:
            p0, p1 = _probability(cells, iy, jx - 1, unknown), _probability(cells, iy, jx, unknown)
            p2, p3 = _probability(cells, iy, jx + 1, unknown), _probability(cells, iy, jx + 2, unknown)
        a = 0.5 * (-p0 + 3.0 * p1 - 3.0 * p2 + p3)
        b = 0.5 * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3)
        d = 0.5 * (p2 - p0)
        row[k] = p1 + u * (d + u * (b + u * a))
        slope[k] = d + u * (2.0 * b + 3.0 * u * a)
    a = 0.5 * (-row[0] + 3.0 * row[1] - 3.0 * row[2] + row[3])
    b = 0.5 * (2.0 * row[0] - 5.0 * row[1] + 4.0 * row[2] - row[3])
    d = 0.5 * (row[2] - row[0])
    out[0] = row[1] + v * (d + v * (b + v * a))
    out[2] = d + v * (2.0 * b + 3.0 * v * a)
    a = 0.5 * (-slope[0] + 3.0 * slope[1] - 3.0 * slope[2] + slope[3])
    b = 0.5 * (2.0 * slope[0] - 5.0 * slope[1] + 4.0 * slope[2] - slope[3])
    d = 0.5 * (slope[2] - slope[0])
    out[1] = slope[1] + v * (d + v * (b + v * a))


@jit
def normal_equations(cells, frame, points, pose, unknown, h, g, scratch):
    """Accumulate H = sum J^T J and g = sum J^T r of r = 1 - P(pose * p) over the points; returns (sum r^2, points with P > 0.5, sum P).

    `h` float64 (3, 3), `g` float64 (3,), both overwritten; `scratch` float64 (11,). J = -dP/d(x, y, yaw).
    """
    inverse = 1.0 / frame[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    row, slope, out = scratch[0:4], scratch[4:8], scratch[8:11]
    h00 = h01 = h02 = h11 = h12 = h22 = 0.0
    g0 = g1 = g2 = 0.0
    total = probable = 0.0
    inliers = 0
    for i in range(points.shape[0]):
        rx = c * points[i, 0] - s * points[i, 1]
        ry = s * points[i, 0] + c * points[i, 1]
        fx, fy = (rx + pose[0] - frame[1]) * inverse, (ry + pose[1] - frame[2]) * inverse
        surface(cells, fx, fy, unknown, row, slope, out)
        r = 1.0 - out[0]
        total += r * r
        probable += out[0]
        if out[0] > 0.5:
            inliers += 1
        dx, dy = out[1] * inverse, out[2] * inverse
        dw = -ry * dx + rx * dy
        h00 += dx * dx
        h01 += dx * dy
        h02 += dx * dw
        h11 += dy * dy
        h12 += dy * dw
        h22 += dw * dw
        g0 -= dx * r
        g1 -= dy * r
        g2 -= dw * r
    h[0, 0], h[0, 1], h[0, 2] = h00, h01, h02
    h[1, 0], h[1, 1], h[1, 2] = h01, h11, h12
    h[2, 0], h[2, 1], h[2, 2] = h02, h12, h22
    g[0], g[1], g[2] = g0, g1, g2
    return total, inliers, probable


@jit
def solve3(h, g, damping, out):
    """Solve (H + damping * diag(H)) out = -g for a symmetric positive definite H (3, 3) by Cramer's rule; False if singular."""
    a, d, f = h[0, 0] * (1 + damping) + 1e-12, h[1, 1] * (1 + damping) + 1e-12, h[2, 2] * (1 + damping) + 1e-12
    b, c, e = h[0, 1], h[0, 2], h[1, 2]
    m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m00 + b * m01 + c * m02
    if det <= 0.0:
        return False
    m11, m12, m22 = a * f - c * c, b * c - a * e, a * d - b * b
    out[0] = -(m00 * g[0] + m01 * g[1] + m02 * g[2]) / det
    out[1] = -(m01 * g[0] + m11 * g[1] + m12 * g[2]) / det
    out[2] = -(m02 * g[0] + m12 * g[1] + m22 * g[2]) / det
    return True


@jit
def _prior_cost(prior_information, pose, prior):
    cost = 0.0
    for k in range(3):
        for j in range(3):
            cost += (pose[k] - prior[k]) * prior_information[k, j] * (pose[j] - prior[j])
    return cost


@jit
def refine(cells, frame, points, pose, prior, weight, prior_information, max_iterations, unknown, h, g, info):
    """Move `pose` float64 (3,) in place to the minimum of weight^2 / N sum (1 - P)^2 + d^T W d, d = pose - prior, W = `prior_information`.

    Levenberg-Marquardt; the damping follows how well the model foretold the gain (Nielsen, IMM-REP-1999-05). What `normal_equations`
    says of the pose at the start is in `h`, `g` and the first three of `info`. `h` float64 (3, 3) gets sum J^T J of the points alone;
    `info` float64 (4,) gets mean probability, inlier ratio (P > 0.5), mean squared residual, iterations.
    """
    n = points.shape[0]
    scratch = np.empty(11)
    hw = np.empty((3, 3))
    gw = np.empty(3)
    step = np.empty(3)
    trial = np.empty(3)
    scale = weight * weight / n
    total, inliers, probable = info[0], info[1], info[2]
    cost = scale * total + _prior_cost(prior_information, pose, prior)
    damping, grow = _FIRST_DAMPING, 2.0
    ht = np.empty((3, 3))
    gt = np.empty(3)
    iterations = 0
    for _ in range(max_iterations):
        iterations += 1
        for k in range(3):
            gw[k] = scale * g[k]
            for j in range(3):
                hw[k, j] = scale * h[k, j] + prior_information[k, j]
                gw[k] += prior_information[k, j] * (pose[j] - prior[j])
        if not solve3(hw, gw, damping, step):
            damping *= 10.0
            continue
        foretold = 0.0
        for k in range(3):
            trial[k] = pose[k] + step[k]
            foretold += step[k] * (damping * hw[k, k] * step[k] - gw[k])
        total_t, inliers_t, probable_t = normal_equations(cells, frame, points, trial, unknown, ht, gt, scratch)
        cost_t = scale * total_t + _prior_cost(prior_information, trial, prior)
        moved = abs(step[0]) + abs(step[1]) + 5.0 * abs(step[2])
        if cost_t < cost:
            gain = cost - cost_t
            cost, total, inliers, probable = cost_t, total_t, float(inliers_t), probable_t
            pose[:] = trial
            h[:, :] = ht
            g[:] = gt
            as_foretold = gain / max(foretold, 1e-300)
            damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * as_foretold - 1.0) ** 3), 1e-7)
            grow = 2.0
            if moved < 1e-4 or gain < 1e-7 * cost:
                break
        else:
            if moved < 1e-4:
                break
            damping *= grow
            grow *= 2.0
            if damping > 1e4:
                break
    info[0] = probable / n
    info[1] = inliers / n
    info[2] = total / n
    info[3] = iterations


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    cells = np.full((8, 8), 20000, np.uint16)
    frame = np.array([1.0, 0.0, 0.0])
    points = np.ones((2, 2), np.float32)
    pose = np.full(3, 2.0)
    correlate(
        *(cells, frame, points, pose, np.array([1.0, 1.0, 0.1]), np.ones(2), P_LOW),
        *(np.zeros((3, 3), np.int32), np.zeros(4)),
    )
    surface(cells, 2.0, 2.0, P_LOW, np.zeros(4), np.zeros(4), np.zeros(3))
    h, g = np.zeros((3, 3)), np.zeros(3)
    normal_equations(cells, frame, points, pose, P_LOW, h, g, np.zeros(11))
    refine(cells, frame, points, pose, pose.copy(), 1.0, np.eye(3), 2, P_LOW, h, g, np.zeros(4))
