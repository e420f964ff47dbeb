"""Kernels that match planar points to the surfaces of a map: robust point-to-line Gauss-Newton with a free surface depth.

The state is (x, y, yaw, depth): the pose of the base in the map, and how far behind the map's surfaces the real ones lie (half
a cell for maps whose occupied cells were hit, none for maps drawn from plans; also the range bias of the scanner). A point is
paired with the nearest surface that faces the base, so that it can never be drawn to the far side of a wall. Directions that
the points do not determine (a corridor) are projected out (after Zhang, Kaess and Singh, "On Degeneracy of Optimization-based
State Estimation Problems", 2016).
"""

import math

import numpy as np

from ambler.kernels.jit import jit


@jit
def find_surface(nearest, surfaces, frame, x, y, bx, by):
    """Return the surface nearest to (x, y) among those that face against the beam direction (bx, by), or -1."""
    ix = int(math.floor((x - frame[1]) / frame[0]))
    iy = int(math.floor((y - frame[2]) / frame[0]))
    if ix < 0 or iy < 0 or iy >= nearest.shape[1] or ix >= nearest.shape[2]:
        return -1
    best = -1
    best_d = math.inf
    for axis in range(2):
        if axis == 0:
            f = 1 if bx > 0.0 else 0
        else:
            f = 3 if by > 0.0 else 2
        k = nearest[f, iy, ix]
        if k < 0:
            continue
        nx, ny = surfaces[k, 2], surfaces[k, 3]
        if nx * bx + ny * by > 0.0:
            continue
        d = (surfaces[k, 0] - x) ** 2 + (surfaces[k, 1] - y) ** 2
        if d < best_d:
            best, best_d = k, d
    return best


@jit
def accumulate(nearest, surfaces, frame, points, state, scale, reach, h, g, info):
    """Write H = sum w J J^T (4, 4) and g = sum w J r (4,) of r = n (q - s) + depth with Geman-McClure weights of width `scale`.

    `points` float32 (N, 2) in the base frame, `state` float64 (4,). Pairs farther than `reach` along the normal, or 2 cells + reach / 2
    beside the surface, do not count. `info` float64 (4,): robust cost (0 best, 1 worst, per point), sum of weights, sum w r^2,
    pairs with |r| < scale. Every point beyond the map or without a surface costs 1.
    """
    c, s = math.cos(state[2]), math.sin(state[2])
    h[:, :] = 0.0
    g[:] = 0.0
    n = points.shape[0]
    cost = weights = squares = 0.0
    near = 0
    beside = 2.0 * frame[0] + 0.5 * reach
    scale2 = scale * scale
    for i in range(n):
        rx = c * points[i, 0] - s * points[i, 1]
        ry = s * points[i, 0] + c * points[i, 1]
        x, y = rx + state[0], ry + state[1]
        k = find_surface(nearest, surfaces, frame, x, y, rx, ry)
        if k < 0:
            cost += 1.0
            continue
        nx, ny = surfaces[k, 2], surfaces[k, 3]
        dx, dy = x - surfaces[k, 0], y - surfaces[k, 1]
        r = dx * nx + dy * ny + state[3]
        t = dy * nx - dx * ny
        if abs(r) > reach or abs(t) > beside:
            cost += 1.0
            continue
        q = r * r / scale2
        cost += q / (1.0 + q)
        w = 1.0 / ((1.0 + q) * (1.0 + q))
        if q < 1.0:
            near += 1
        jw = rx * ny - ry * nx
        wx, wy, ww = w * nx, w * ny, w * jw
        h[0, 0] += wx * nx
        h[0, 1] += wx * ny
        h[0, 2] += wx * jw
        h[0, 3] += wx
        h[1, 1] += wy * ny
        h[1, 2] += wy * jw
        h[1, 3] += wy
        h[2, 2] += ww * jw
        h[2, 3] += ww
        h[3, 3] += w
        g[0] += wx * r
        g[1] += wy * r
        g[2] += ww * r
        g[3] += w * r
        weights += w
        squares += w * r * r
    for a in range(4):
        for b in range(a):
            h[a, b] = h[b, a]
    info[0] = cost / max(n, 1)
    info[1] = weights
    info[2] = squares
    info[3] = near


@jit
def eigen3(m, values, vectors):
    """Diagonalize a symmetric (3, 3) matrix by Jacobi rotations: ascending `values` (3,), `vectors` (3, 3) in columns; `m` is spoilt."""
    vectors[:, :] = 0.0
    for a in range(3):
        vectors[a, a] = 1.0
    for _ in range(12):
        off = m[0, 1] * m[0, 1] + m[0, 2] * m[0, 2] + m[1, 2] * m[1, 2]
        if off < 1e-24 * (m[0, 0] * m[0, 0] + m[1, 1] * m[1, 1] + m[2, 2] * m[2, 2]):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if m[p, q] == 0.0:
                    continue
                theta = 0.5 * (m[q, q] - m[p, p]) / m[p, q]
                sign = 1.0 if theta >= 0.0 else -1.0
                t = sign / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    a, b = m[k, p], m[k, q]
                    m[k, p], m[k, q] = c * a - s * b, s * a + c * b
                for k in range(3):
                    a, b = m[p, k], m[q, k]
                    m[p, k], m[q, k] = c * a - s * b, s * a + c * b
                for k in range(3):
                    a, b = vectors[k, p], vectors[k, q]
                    vectors[k, p], vectors[k, q] = c * a - s * b, s * a + c * b
    for a in range(3):
        values[a] = m[a, a]
    for a in range(2):
        for b in range(2 - a):
            if values[b] > values[b + 1]:
                values[b], values[b + 1] = values[b + 1], values[b]
                for k in range(3):
                    vectors[k, b], vectors[k, b + 1] = vectors[k, b + 1], vectors[k, b]


@jit
def project(h, g, lever, min_ratio, min_weight, work, values, vectors):
    """Remove from H (4, 4) and g the pose directions that the points do not determine; returns how many remain (0 to 3).

    Such a direction is unknown, not known: what its few points say together with the depth says nothing of the depth alone, so it is
    eliminated (Schur complement) before it is removed.

    A direction stays when its eigenvalue (yaw counted as `lever` metres per radian) is at least `min_ratio` of the largest and
    at least `min_weight` (weighted points). The depth counts as known: how well a single wall tells the distance to it is limited
    by the depth's own variance, which fusion takes into account, not by this test.
    """
    inverse = 1.0 / lever
    for a in range(3):
        sa = inverse if a == 2 else 1.0
        for b in range(3):
            sb = inverse if b == 2 else 1.0
            work[a, b] = sa * sb * h[a, b]
    eigen3(work, values, vectors)
    floor = max(min_weight, min_ratio * values[2])
    kept = 0
    for k in range(3):
        if values[k] >= floor:
            kept += 1
            continue
        # Remove the direction v (metres) and u = v in units of the state: Q = I - u_in v_out^T.
        v0, v1, v2 = vectors[0, k], vectors[1, k], vectors[2, k]
        d0, d1, d2 = v0, v1, v2 * inverse
        e0, e1, e2 = v0, v1, v2 * lever
        shared = d0 * h[0, 3] + d1 * h[1, 3] + d2 * h[2, 3]
        if values[k] > 1e-9 * values[2]:
            h[3, 3] -= shared * shared / values[k]
            g[3] -= shared * (d0 * g[0] + d1 * g[1] + d2 * g[2]) / values[k]
        for b in range(4):
            dot = d0 * h[0, b] + d1 * h[1, b] + d2 * h[2, b]
            h[0, b] -= e0 * dot
            h[1, b] -= e1 * dot
            h[2, b] -= e2 * dot
        for b in range(4):
            dot = d0 * h[b, 0] + d1 * h[b, 1] + d2 * h[b, 2]
            h[b, 0] -= e0 * dot
            h[b, 1] -= e1 * dot
            h[b, 2] -= e2 * dot
        dot = d0 * g[0] + d1 * g[1] + d2 * g[2]
        g[0] -= e0 * dot
        g[1] -= e1 * dot
        g[2] -= e2 * dot
    return kept


@jit
def solve4(a, b, x):
    """Solve the symmetric positive definite a (4, 4) x = b by Cholesky, in place of `a`; False when it is not definite."""
    for i in range(4):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            if i == j:
                if total <= 0.0:
                    return False
                a[i, i] = math.sqrt(total)
            else:
                a[i, j] = total / a[j, j]
    for i in range(4):
        total = b[i]
        for k in range(i):
            total -= a[i, k] * x[k]
        x[i] = total / a[i, i]
    for r in range(4):
        i = 3 - r
        total = x[i]
        for k in range(i + 1, 4):
            total -= a[k, i] * x[k]
        x[i] = total / a[i, i]
    return True


@jit
def descend(nearest, surfaces, frame, points, state, anchor, stiffness, scales, limits, iterations, h, g, info):
    """Move `state` float64 (4,) in place to the robust minimum near it; returns how many pose directions the points determine.

    `anchor`, `stiffness` float64 (4,): a weak pull (in weighted points) to a state, which only matters where the points say
    nothing. `scales` (first, last): width of the robust loss, halved in every iteration. `limits` (lever, min_ratio, min_weight).
    `h`, `g`, `info` end as in `accumulate` at the solution with the last scale, not projected.
    """
    work, vectors = np.empty((3, 3)), np.empty((3, 3))
    values = np.empty(3)
    system, rhs, step = np.empty((4, 4)), np.empty(4), np.empty(4)
    scale = scales[0]
    kept = 0
    for _ in range(iterations):
        accumulate(nearest, surfaces, frame, points, state, scale, 4.0 * scale, h, g, info)
        system[:, :] = h
        rhs[:] = g
        kept = project(system, rhs, limits[0], limits[1], limits[2], work, values, vectors)
        for a in range(4):
            system[a, a] += stiffness[a]
            rhs[a] = -(rhs[a] + stiffness[a] * (state[a] - anchor[a]))
        if not solve4(system, rhs, step):
            break
        size = math.sqrt(step[0] * step[0] + step[1] * step[1]) + abs(step[2]) * limits[0]
        shrink = min(1.0, 4.0 * scale / max(size, 1e-12))
        for a in range(4):
            state[a] += shrink * step[a]
        if scale <= scales[1] and size < 1e-4:
            break
        scale = max(scales[1], 0.5 * scale)
    accumulate(nearest, surfaces, frame, points, state, scales[1], 4.0 * scales[1], h, g, info)
    return kept


@jit
def patch_statistics(nearest, surfaces, frame, points, state, scale, patch, sums, out, totals):
    """Group pairs by the wall and by the stretch of wall they meet, to tell errors that a wall's beams share from noise.

    A wall: normal within 15°, offset within 0.15 m; a stretch: `patch` metres of it. `sums` float64 (2, B, 6) is scratch. Writes
    `out` float64 (4, 4) = mean over both groupings of sum (sum w J)(sum w J)^T and `totals` float64 (7,): walls, stretches, and over
    stretches the sums of a, a mean^2, a / weight, squares within, weights; a = (weight / (weight + 10))^2 trusts long stretches.
    """
    buckets = sums.shape[1]
    sums[:, :, :] = 0.0
    c, s = math.cos(state[2]), math.sin(state[2])
    beside = 2.0 * frame[0] + 2.0 * scale
    for i in range(points.shape[0]):
        rx = c * points[i, 0] - s * points[i, 1]
        ry = s * points[i, 0] + c * points[i, 1]
        x, y = rx + state[0], ry + state[1]
        k = find_surface(nearest, surfaces, frame, x, y, rx, ry)
        if k < 0:
            continue
        sx, sy, nx, ny = surfaces[k, 0], surfaces[k, 1], surfaces[k, 2], surfaces[k, 3]
        dx, dy = x - sx, y - sy
        r = dx * nx + dy * ny + state[3]
        if abs(r) > 4.0 * scale or abs(dy * nx - dx * ny) > beside:
            continue
        q = r * r / (scale * scale)
        w = 1.0 / ((1.0 + q) * (1.0 + q))
        angle = int(math.floor(math.atan2(ny, nx) * (12.0 / math.pi) + 0.5)) % 24
        offset = int(math.floor((sx * nx + sy * ny) / 0.15))
        along = int(math.floor((sy * nx - sx * ny) / patch))
        for grouping in range(2):
            b = (angle * 83492791 + offset * 73856093 + grouping * along * 19349663) % buckets
            group = sums[grouping, b]
            group[0] += w
            group[1] += w * r
            group[2] += w * r * r
            group[3] += w * nx
            group[4] += w * ny
            group[5] += w * (rx * ny - ry * nx)
    out[:, :] = 0.0
    totals[:] = 0.0
    jacobian = np.empty(4)
    for grouping in range(2):
        for b in range(buckets):
            group = sums[grouping, b]
            w = group[0]
            if w < 0.5:
                continue
            totals[grouping] += 1.0
            jacobian[0], jacobian[1], jacobian[2], jacobian[3] = group[3], group[4], group[5], w
            for a in range(4):
                for d in range(4):
                    out[a, d] += 0.5 * jacobian[a] * jacobian[d]
            if grouping == 1:
                mean = group[1] / w
                trust = (w / (w + 10.0)) ** 2
                totals[2] += trust
                totals[3] += trust * mean * mean
                totals[4] += trust / w
                totals[5] += max(0.0, group[2] - w * mean * mean)
                totals[6] += w


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    nearest = np.zeros((4, 4, 4), np.int32)
    surfaces = np.array([[2.0, 2.0, -1.0, 0.0]])
    frame = np.array([1.0, 0.0, 0.0])
    points = np.ones((2, 2), np.float32)
    h, g, info = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    state = np.array([1.0, 1.0, 0.0, 0.0])
    descend(nearest, surfaces, frame, points, state, state.copy(), np.ones(4), np.ones(2), np.ones(3), 2, h, g, info)
    patch_statistics(nearest, surfaces, frame, points, state, 1.0, 1.0, np.zeros((2, 16, 6)), h, np.zeros(7))
    work, values, vectors = np.eye(3), np.zeros(3), np.zeros((3, 3))
    eigen3(work, values, vectors)
    project(h, g, 1.0, 0.1, 1.0, work, values, vectors)
    solve4(np.eye(4), g, np.zeros(4))
    find_surface(nearest, surfaces, frame, 1.0, 1.0, 1.0, 0.0)
    accumulate(nearest, surfaces, frame, points, state, 1.0, 1.0, h, g, info)
