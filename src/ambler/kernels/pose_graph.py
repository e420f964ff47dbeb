"""Pose graphs of the plane: linearization, and a sparse Cholesky factorization in blocks of 3 x 3.

Poses are (x, y, yaw); increments are added to them, so that an edge's residual is
    e = (R(yaw_i + yaw_z)^T (t_j - t_i) - R(yaw_z)^T t_z, wrap(yaw_j - yaw_i - yaw_z))
with the Jacobians J_j = diag(R(yaw_i + yaw_z)^T, 1) and J_i = -J_j A, A = [[1, 0, -dy], [0, 1, dx], [0, 0, 1]], d = t_j - t_i.
The normal matrix lies in permuted order: `diagonal` (n, 9) and the blocks below it, `lower` (m, 9), row-major. The factorization
is the up-looking one of sparse direct methods, along the elimination tree, with every scalar replaced by a 3 x 3 block.
"""

import math

import numpy as np

from ambler.kernels.jit import jit

NO_KERNEL, HUBER, DCS, GEMAN_MCCLURE = 0, 1, 2, 3


@jit
def robust_cost_weight(chi2, kernel, width):
    """Return (rho, d rho) of a squared, whitened error; `width` is the whitened error at which the kernel begins."""
    w2 = width * width
    if kernel == HUBER and chi2 > w2:
        chi = math.sqrt(chi2)
        return 2.0 * width * chi - w2, width / chi
    if kernel == DCS and chi2 > w2:
        s = 2.0 * w2 / (w2 + chi2)
        return w2 * (3.0 * chi2 - w2) / (chi2 + w2), s * s
    if kernel == GEMAN_MCCLURE:
        s = w2 / (w2 + chi2)
        return chi2 * s, s * s
    return chi2, 1.0


@jit
def edge_residual(poses, i, j, z, out):
    """Write the residual (3,) of edge i -> j with measurement z (3,); returns cosine and sine of yaw_i + yaw_z."""
    c, s = math.cos(poses[i, 2] + z[2]), math.sin(poses[i, 2] + z[2])
    cz, sz = math.cos(z[2]), math.sin(z[2])
    dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
    out[0] = c * dx + s * dy - (cz * z[0] + sz * z[1])
    out[1] = -s * dx + c * dy - (-sz * z[0] + cz * z[1])
    a = poses[j, 2] - poses[i, 2] - z[2]
    out[2] = a - 2.0 * math.pi * math.floor((a + math.pi) / (2.0 * math.pi))
    return c, s


@jit
def _quadratic(info, e):
    return (
        info[0, 0] * e[0] * e[0]
        + info[1, 1] * e[1] * e[1]
        + info[2, 2] * e[2] * e[2]
        + 2.0 * (info[0, 1] * e[0] * e[1] + info[0, 2] * e[0] * e[2] + info[1, 2] * e[1] * e[2])
    )


@jit
def edge_chi2(poses, edge_from, edge_to, measurements, information, out):
    """Write e^T Omega e of every edge into `out` (E,)."""
    e = np.empty(3)
    for k in range(len(edge_from)):
        edge_residual(poses, edge_from[k], edge_to[k], measurements[k], e)
        out[k] = _quadratic(information[k], e)


@jit
def _add_edge(pa, pb, slot, p, g, dx, dy, diagonal, lower, gradient):
    """Add an edge's blocks: p (3, 3) = J_j^T Omega J_j, g (3,) = J_j^T Omega e, from the positions pa (i) and pb (j)."""
    if pb >= 0:
        for r in range(3):
            gradient[pb, r] += g[r]
            for c in range(3):
                diagonal[pb, 3 * r + c] += p[r, c]
    if pa < 0:
        return
    gradient[pa, 0] -= g[0]
    gradient[pa, 1] -= g[1]
    gradient[pa, 2] -= -dy * g[0] + dx * g[1] + g[2]
    for c in range(3):  # p becomes A^T p, which is -H_ij
        p[2, c] += -dy * p[0, c] + dx * p[1, c]
    if pb >= 0:
        for r in range(3):
            for c in range(3):
                if pa > pb:
                    lower[slot, 3 * r + c] -= p[r, c]
                else:
                    lower[slot, 3 * c + r] -= p[r, c]
    for r in range(3):  # and A^T p A, which is H_ii
        p[r, 2] += -dy * p[r, 0] + dx * p[r, 1]
        for c in range(3):
            diagonal[pa, 3 * r + c] += p[r, c]


@jit
def linearize(
    poses,
    edge_from,
    edge_to,
    measurements,
    information,
    is_robust,
    kernel,
    width,
    translation_only,
    position,
    slot,
    diagonal,
    lower,
    gradient,
):
    """Fill the normal equations at `poses` (N, 3) and return the robust cost (no factor 1/2).

    `position` (N,) is each pose's place in the permuted system or -1 when it is fixed, `slot` (E,) each edge's block in `lower`.
    With `translation_only` the yaws are held: the solution is then the exact optimum of the translations.
    """
    diagonal[:] = 0.0
    lower[:] = 0.0
    gradient[:] = 0.0
    if translation_only:
        diagonal[:, 8] = 1.0
    e = np.empty(3)
    g = np.empty(3)
    p = np.empty((3, 3))
    cost = 0.0
    for k in range(len(edge_from)):
        i, j = edge_from[k], edge_to[k]
        z, omega = measurements[k], information[k]
        c, s = edge_residual(poses, i, j, z, e)
        edge_cost, w = robust_cost_weight(_quadratic(omega, e), kernel if is_robust[k] else NO_KERNEL, width)
        cost += edge_cost
        g0 = w * (omega[0, 0] * e[0] + omega[0, 1] * e[1] + omega[0, 2] * e[2])
        g1 = w * (omega[0, 1] * e[0] + omega[1, 1] * e[1] + omega[1, 2] * e[2])
        g[0], g[1] = c * g0 - s * g1, s * g0 + c * g1
        g[2] = w * (omega[0, 2] * e[0] + omega[1, 2] * e[1] + omega[2, 2] * e[2])
        a, b, d = omega[0, 0], omega[0, 1], omega[1, 1]
        p[0, 0] = w * (c * c * a - 2.0 * c * s * b + s * s * d)
        p[1, 1] = w * (s * s * a + 2.0 * c * s * b + c * c * d)
        p[0, 1] = w * (c * s * (a - d) + (c * c - s * s) * b)
        p[0, 2] = w * (c * omega[0, 2] - s * omega[1, 2])
        p[1, 2] = w * (s * omega[0, 2] + c * omega[1, 2])
        p[1, 0], p[2, 0], p[2, 1], p[2, 2] = p[0, 1], p[0, 2], p[1, 2], w * omega[2, 2]
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        if translation_only:
            p[0, 2] = p[1, 2] = p[2, 0] = p[2, 1] = p[2, 2] = g[2] = dx = dy = 0.0
            if position[i] >= 0:
                gradient[position[i], 2] = 0.0
        _add_edge(position[i], position[j], slot[k], p, g, dx, dy, diagonal, lower, gradient)
    return cost


@jit
def linearize_chordal(directions, edge_from, edge_to, yaws, weights, position, slot, diagonal, lower, gradient):
    """Fill the linear least squares of w |r_j - R(yaw) r_i|^2 over unit vectors r, the chordal relaxation of rotations.

    `directions` (N, 2) holds the fixed poses' vectors and zeros elsewhere; the third unknown of every block is a dummy.
    """
    diagonal[:] = 0.0
    lower[:] = 0.0
    gradient[:] = 0.0
    diagonal[:, 8] = 1.0
    for k in range(len(edge_from)):
        i, j, w = edge_from[k], edge_to[k], weights[k]
        c, s = math.cos(yaws[k]), math.sin(yaws[k])
        e0 = directions[j, 0] - (c * directions[i, 0] - s * directions[i, 1])
        e1 = directions[j, 1] - (s * directions[i, 0] + c * directions[i, 1])
        pa, pb = position[i], position[j]
        if pb >= 0:
            diagonal[pb, 0] += w
            diagonal[pb, 4] += w
            gradient[pb, 0] += w * e0
            gradient[pb, 1] += w * e1
        if pa >= 0:
            diagonal[pa, 0] += w
            diagonal[pa, 4] += w
            gradient[pa, 0] -= w * (c * e0 + s * e1)
            gradient[pa, 1] -= w * (-s * e0 + c * e1)
        if pa >= 0 and pb >= 0:
            h = lower[slot[k]]
            turn = s if pa < pb else -s  # below the diagonal lies H_ji = -w R when j comes later, else H_ij = -w R^T
            h[0] -= w * c
            h[1] += w * turn
            h[3] -= w * turn
            h[4] -= w * c


@jit
def elimination_tree(row_start, columns, parent, count):
    """Fill the elimination tree `parent` (n,) and the number of blocks below the diagonal in every column, `count` (n,).

    Row k of the lower triangle has its columns in columns[row_start[k] : row_start[k + 1]]. Returns the blocks of the factor.
    """
    n = len(parent)
    ancestor = np.full(n, -1, np.int64)
    mark = np.full(n, -1, np.int64)
    total = 0
    count[:] = 0
    for k in range(n):
        parent[k] = -1
        for p in range(row_start[k], row_start[k + 1]):
            i = columns[p]
            while i != -1 and i < k:
                above = ancestor[i]
                ancestor[i] = k
                if above == -1:
                    parent[i] = k
                i = above
        mark[k] = k
        for p in range(row_start[k], row_start[k + 1]):
            i = columns[p]
            while mark[i] != k:
                mark[i] = k
                count[i] += 1
                total += 1
                i = parent[i]
    return total


@jit
def factor_rows(row_start, columns, parent, factor_start, factor_columns):
    """Fill the pattern of every row of the factor, descendants first, into `factor_columns`, with starts (n + 1,)."""
    n = len(parent)
    mark = np.full(n, -1, np.int64)
    path = np.empty(n, np.int64)
    stack = np.empty(n, np.int64)
    end = 0
    for k in range(n):
        factor_start[k] = end
        top = n
        mark[k] = k
        for p in range(row_start[k], row_start[k + 1]):
            i = columns[p]
            length = 0
            while mark[i] != k:
                path[length] = i
                length += 1
                mark[i] = k
                i = parent[i]
            while length > 0:
                length -= 1
                top -= 1
                stack[top] = path[length]
        for q in range(top, n):
            factor_columns[end] = stack[q]
            end += 1
    factor_start[n] = end


@jit
def factorize(
    diagonal,
    lower,
    row_start,
    columns,
    damping,
    factor_start,
    factor_columns,
    column_start,
    column_end,
    factor_rows_out,
    factor,
    inverse,
):
    """Factor H + damping diag(H) = L L^T; `factor` (m, 9) by columns, `inverse` (n, 9) holds the inverted diagonal blocks of L.

    `column_end` (n,) is scratch. Returns False when the matrix is not positive definite.
    """
    n = len(diagonal)
    y = np.zeros((n, 9))
    for k in range(n):
        column_end[k] = column_start[k]
    for k in range(n):
        for p in range(row_start[k], row_start[k + 1]):
            i = columns[p]
            for q in range(9):
                y[i, q] = lower[p, q]
        grow = 1.0 + damping
        d0, d4, d8 = diagonal[k, 0] * grow, diagonal[k, 4] * grow, diagonal[k, 8] * grow
        d3, d6, d7 = diagonal[k, 3], diagonal[k, 6], diagonal[k, 7]
        for q in range(factor_start[k], factor_start[k + 1]):
            i = factor_columns[q]
            # x = y_i L_ii^-T, with the inverse of L_ii lower triangular
            v = inverse[i]
            w = y[i]
            x0 = w[0] * v[0]
            x1 = w[0] * v[3] + w[1] * v[4]
            x2 = w[0] * v[6] + w[1] * v[7] + w[2] * v[8]
            x3 = w[3] * v[0]
            x4 = w[3] * v[3] + w[4] * v[4]
            x5 = w[3] * v[6] + w[4] * v[7] + w[5] * v[8]
            x6 = w[6] * v[0]
            x7 = w[6] * v[3] + w[7] * v[4]
            x8 = w[6] * v[6] + w[7] * v[7] + w[8] * v[8]
            for r in range(9):
                w[r] = 0.0
            end = column_end[i]
            for p in range(column_start[i], end):
                t = y[factor_rows_out[p]]
                l = factor[p]
                t[0] -= x0 * l[0] + x1 * l[1] + x2 * l[2]
                t[1] -= x0 * l[3] + x1 * l[4] + x2 * l[5]
                t[2] -= x0 * l[6] + x1 * l[7] + x2 * l[8]
                t[3] -= x3 * l[0] + x4 * l[1] + x5 * l[2]
                t[4] -= x3 * l[3] + x4 * l[4] + x5 * l[5]
                t[5] -= x3 * l[6] + x4 * l[7] + x5 * l[8]
                t[6] -= x6 * l[0] + x7 * l[1] + x8 * l[2]
                t[7] -= x6 * l[3] + x7 * l[4] + x8 * l[5]
                t[8] -= x6 * l[6] + x7 * l[7] + x8 * l[8]
            d0 -= x0 * x0 + x1 * x1 + x2 * x2
            d3 -= x3 * x0 + x4 * x1 + x5 * x2
            d4 -= x3 * x3 + x4 * x4 + x5 * x5
            d6 -= x6 * x0 + x7 * x1 + x8 * x2
            d7 -= x6 * x3 + x7 * x4 + x8 * x5
            d8 -= x6 * x6 + x7 * x7 + x8 * x8
            l = factor[end]
            l[0], l[1], l[2], l[3], l[4], l[5], l[6], l[7], l[8] = x0, x1, x2, x3, x4, x5, x6, x7, x8
            factor_rows_out[end] = k
            column_end[i] = end + 1
        if not d0 > 0.0:
            return False
        a = math.sqrt(d0)
        b, d = d3 / a, d6 / a
        c2 = d4 - b * b
        if not c2 > 0.0:
            return False
        c = math.sqrt(c2)
        f = (d7 - d * b) / c
        g2 = d8 - d * d - f * f
        if not g2 > 0.0:
            return False
        g = math.sqrt(g2)
        v = inverse[k]
        v[0], v[4], v[8] = 1.0 / a, 1.0 / c, 1.0 / g
        v[3] = -b / (a * c)
        v[7] = -f / (c * g)
        v[6] = (b * f - c * d) / (a * c * g)
    return True


@jit
def solve_factored(column_start, rows, factor, inverse, x):
    """Replace the right-hand side x (n, 3) by the solution of L L^T x = b."""
    n = len(inverse)
    for k in range(n):
        v = inverse[k]
        x2 = v[6] * x[k, 0] + v[7] * x[k, 1] + v[8] * x[k, 2]
        x1 = v[3] * x[k, 0] + v[4] * x[k, 1]
        x0 = v[0] * x[k, 0]
        x[k, 0], x[k, 1], x[k, 2] = x0, x1, x2
        for p in range(column_start[k], column_start[k + 1]):
            i, l = rows[p], factor[p]
            x[i, 0] -= l[0] * x0 + l[1] * x1 + l[2] * x2
            x[i, 1] -= l[3] * x0 + l[4] * x1 + l[5] * x2
            x[i, 2] -= l[6] * x0 + l[7] * x1 + l[8] * x2
    for k in range(n - 1, -1, -1):
        x0, x1, x2 = x[k, 0], x[k, 1], x[k, 2]
        for p in range(column_start[k], column_start[k + 1]):
            i, l = rows[p], factor[p]
            x0 -= l[0] * x[i, 0] + l[3] * x[i, 1] + l[6] * x[i, 2]
            x1 -= l[1] * x[i, 0] + l[4] * x[i, 1] + l[7] * x[i, 2]
            x2 -= l[2] * x[i, 0] + l[5] * x[i, 1] + l[8] * x[i, 2]
        v = inverse[k]
        x[k, 0] = v[0] * x0 + v[3] * x1 + v[6] * x2
        x[k, 1] = v[4] * x1 + v[7] * x2
        x[k, 2] = v[8] * x2


@jit
def _block_of(column_start, rows, z, i, k, out):
    """Copy block (i, k) of the inverse, whichever triangle it lies in, from its diagonal and the pattern of the factor."""
    a, b = (i, k) if i > k else (k, i)  # row, column
    low, high = column_start[b], column_start[b + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if rows[middle] < a:
            low = middle + 1
        else:
            high = middle
    for r in range(3):
        for c in range(3):
            out[3 * r + c] = z[low, 3 * r + c] if i > k else z[low, 3 * c + r]


@jit
def invert_on_pattern(column_start, rows, factor, inverse, z, z_diagonal):
    """Fill the blocks of (L L^T)^-1 that lie on the pattern of L: `z` (m, 9) below the diagonal, by columns, and `z_diagonal` (n, 9).

    The recursion of Takahashi, Fagan and Chin (1973): Z L = L^-T gives column j from the columns behind it.
    """
    n = len(inverse)
    block = np.empty(9)
    total = np.empty((3, 3))
    for j in range(n - 1, -1, -1):
        v = inverse[j]
        v0, v3, v4, v6, v7, v8 = v[0], v[3], v[4], v[6], v[7], v[8]
        for p in range(column_start[j + 1] - 1, column_start[j] - 1, -1):
            i = rows[p]
            total[:] = 0.0
            for q in range(column_start[j], column_start[j + 1]):
                k, l = rows[q], factor[q]
                if k == i:
                    block[:] = z_diagonal[i]
                else:
                    _block_of(column_start, rows, z, i, k, block)
                for r in range(3):
                    for c in range(3):
                        total[r, c] += block[3 * r] * l[c] + block[3 * r + 1] * l[3 + c] + block[3 * r + 2] * l[6 + c]
            for r in range(3):  # times L_jj^-1, lower triangular
                a, b, c = total[r, 0], total[r, 1], total[r, 2]
                z[p, 3 * r] = -(a * v0 + b * v3 + c * v6)
                z[p, 3 * r + 1] = -(b * v4 + c * v7)
                z[p, 3 * r + 2] = -c * v8
        # Z_jj = (L_jj^-T - sum_k Z_kj^T L_kj) L_jj^-1
        total[0, 0], total[0, 1], total[0, 2] = v0, v3, v6
        total[1, 0], total[1, 1], total[1, 2] = 0.0, v4, v7
        total[2, 0], total[2, 1], total[2, 2] = 0.0, 0.0, v8
        for q in range(column_start[j], column_start[j + 1]):
            l, y = factor[q], z[q]
            for r in range(3):
                for c in range(3):
                    total[r, c] -= y[r] * l[c] + y[3 + r] * l[3 + c] + y[6 + r] * l[6 + c]
        for r in range(3):
            a, b, c = total[r, 0], total[r, 1], total[r, 2]
            z_diagonal[j, 3 * r] = a * v0 + b * v3 + c * v6
            z_diagonal[j, 3 * r + 1] = b * v4 + c * v7
            z_diagonal[j, 3 * r + 2] = c * v8


def warm_up() -> None:
    """Compile every kernel with the types it is used with."""
    poses, z = np.zeros((3, 3)), np.zeros((2, 3))
    a, b = np.array([0, 1]), np.array([1, 2])
    omega = np.repeat(np.eye(3)[None], 2, axis=0)
    flags = np.zeros(2, np.bool_)
    position, slot = np.array([-1, 0, 1]), np.array([-1, 0])
    diagonal, lower, gradient = np.zeros((2, 9)), np.zeros((1, 9)), np.zeros((2, 3))
    edge_chi2(poses, a, b, z, omega, np.zeros(2))
    linearize_chordal(np.zeros((3, 2)), a, b, np.zeros(2), np.ones(2), position, slot, diagonal, lower, gradient)
    linearize(poses, a, b, z, omega, flags, HUBER, 1.0, False, position, slot, diagonal, lower, gradient)
    starts, columns, parent, count = np.array([0, 0, 1]), np.array([0]), np.zeros(2, np.int64), np.zeros(2, np.int64)
    total = elimination_tree(starts, columns, parent, count)
    factor_start, factor_columns = np.zeros(3, np.int64), np.zeros(total, np.int64)
    factor_rows(starts, columns, parent, factor_start, factor_columns)
    column_start = np.concatenate((np.zeros(1, np.int64), np.cumsum(count)))
    rows, factor, inverse = np.zeros(total, np.int64), np.zeros((total, 9)), np.zeros((2, 9))
    factorize(
        *(diagonal, lower, starts, columns, 0.0),
        *(factor_start, factor_columns, column_start, np.zeros(2, np.int64), rows, factor, inverse),
    )
    solve_factored(column_start, rows, factor, inverse, gradient)
    invert_on_pattern(column_start, rows, factor, inverse, np.zeros_like(factor), np.zeros_like(inverse))
