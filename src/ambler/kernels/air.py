"""Which returns of a cloud stand for a surface, by what lies around them in the same cloud; and which places were hit again in other clouds.

Returns are sorted into cells of azimuth and of the sine of elevation, which are equal in solid angle.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit, read_only
from ambler.kernels.voxel_map import cell_key, thinnest

SURFACE, LONELY, CLOUDY = 0, 1, 2  # verdicts
LEAST = 6  # neighbours of a surface: dust has one or two, a ring of sixteen on the floor ten or more
SIDE = 2  # cells to each side that are looked at
EDGE = 1.5  # edge of a cell in mean distances between beams
OFF = 0.1  # m from the scanner at which a plane passes it
MEMORY = 16  # scans that a place is remembered for: the bits of its mask


@jit
def count_patches(points, step, columns, rows, is_seen):
    """Return how many of `columns` x `rows` patches of the sphere every `step`-th return float32 (N, 3) meets; `is_seen` bool (columns * rows,) is scratch."""
    is_seen[:] = False
    count = 0
    for i in range(0, points.shape[0], step):
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        r = math.sqrt(x * x + y * y + z * z)
        if not math.isfinite(r):
            continue
        c = int((math.atan2(y, x) / (2.0 * math.pi) + 0.5) * (columns - 1))
        q = int((0.5 * z / max(r, 1e-6) + 0.5) * (rows - 1))
        if not is_seen[q * columns + c]:
            is_seen[q * columns + c] = True
            count += 1
    return count


@jit
def sort_cells(points, intensity, reach, dim_below, columns, rows, cell_of, begins, order, near, is_dim):
    """Sort the returns float32 (N, 3) that are nearer than `reach` m into `columns` x `rows` cells; returns how many these are, M.

    Of every return `cell_of` int64 (N,) tells its cell, -1 for the others; `begins` int64 (columns * rows + 1,) where a cell begins among the first M of `order`
    int64 (N,), the numbers of the returns cell by cell, `near` float32 (N, 3), where they are, and `is_dim` bool (N,), whether their `intensity` (N,) is below `dim_below`.
    """
    n, count = points.shape[0], 0
    begins[:] = 0
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        square = x * x + y * y + z * z
        if not square < reach * reach:
            cell_of[i] = -1
            continue
        r = math.sqrt(square)
        c = int((math.atan2(y, x) / (2.0 * math.pi) + 0.5) * columns)
        q = int((0.5 * z / max(r, 1e-6) + 0.5) * rows)
        cell_of[i] = min(max(q, 0), rows - 1) * columns + min(max(c, 0), columns - 1)
        begins[cell_of[i] + 1] += 1
        count += 1
    for k in range(columns * rows):
        begins[k + 1] += begins[k]
    # Filled from the back, each cell's end runs down to its begin.
    for i in range(n - 1, -1, -1):
        if cell_of[i] < 0:
            continue
        begins[cell_of[i] + 1] -= 1
        at = begins[cell_of[i] + 1]
        order[at] = i
        near[at, 0], near[at, 1], near[at, 2] = points[i, 0], points[i, 1], points[i, 2]
        is_dim[at] = intensity[i] < dim_below
    for k in range(columns * rows):
        begins[k] = begins[k + 1]
    begins[columns * rows] = count
    return count


@jit
def judge(
    cloud, points, is_dim, asked, columns, rows, cell_of, begins, order, spacing, depth, thickness, share, verdicts
):
    """Judge the returns `asked` int64 (M,) of a `cloud` float32 (N, 3) that `sort_cells` has sorted, all of them nearer than its reach: `verdicts` uint8 (M,).

    Neighbours lie within three beams' distances (`spacing` rad) beside a return and max(0.2 m, `depth` * range) before or behind it. Fewer than LEAST: LONELY. When `share`
    of them lie within `thickness` (plus 3 mm per metre of range) of one plane, the return is a SURFACE if it does so too, else LONELY. In a plane through the scanner, such as
    that of a ring, all that the ring sees lies: there they must lie on a line, and not along the beam. Neighbours that do not are CLOUDY where `share` of them are dim, else
    leaves: a SURFACE.
    """
    near = np.empty((128, 3))
    for k in range(asked.shape[0]):
        i = asked[k]
        x, y, z = float(cloud[i, 0]), float(cloud[i, 1]), float(cloud[i, 2])
        r = math.sqrt(x * x + y * y + z * z)
        bx, by, bz = x / r, y / r, z / r
        aside, along = 3.0 * spacing * r, max(0.2, depth * r)
        row, column = cell_of[i] // columns, cell_of[i] % columns
        level = max(math.sqrt(x * x + y * y) / r, 0.2)
        wide = min(int(math.ceil(SIDE / level)), columns // 2 - 1)
        found, dim = 0, 0
        mx = my = mz = 0.0
        for q in range(max(row - SIDE, 0), min(row + SIDE + 1, rows)):
            # Columns go round: those before the first one and behind the last one are a second run of cells.
            for run in range(2):
                first, last = max(column - wide, 0), min(column + wide, columns - 1)
                if column - wide < 0 and run == 0:
                    first, last = column - wide + columns, columns - 1
                elif column + wide >= columns and run == 1:
                    first, last = 0, column + wide - columns
                elif column - wide >= 0 and run == 1:
                    break
                for at in range(begins[q * columns + first], begins[q * columns + last + 1]):
                    dx, dy, dz = points[at, 0] - x, points[at, 1] - y, points[at, 2] - z
                    ahead = dx * bx + dy * by + dz * bz
                    beside = dx * dx + dy * dy + dz * dz - ahead * ahead
                    if order[at] == i or abs(ahead) > along or beside > aside * aside or found == near.shape[0]:
                        continue
                    near[found, 0], near[found, 1], near[found, 2] = dx, dy, dz
                    mx += dx
                    my += dy
                    mz += dz
                    dim += is_dim[at]
                    found += 1
        if found < LEAST:
            verdicts[k] = LONELY
            continue
        mx, my, mz = mx / found, my / found, mz / found
        nx, ny, nz = _normal(near, found, mx, my, mz)
        thick = thickness + 0.003 * r
        thin = 0
        for j in range(found):
            off = nx * (near[j, 0] - mx) + ny * (near[j, 1] - my) + nz * (near[j, 2] - mz)
            thin += abs(off) <= thick
        is_dim_about = dim >= share * found
        if thin < share * found:
            verdicts[k] = CLOUDY if is_dim_about else SURFACE
        elif abs(nx * mx + ny * my + nz * mz) > thick:
            verdicts[k] = LONELY
        elif abs(nx * (mx + x) + ny * (my + y) + nz * (mz + z)) > OFF or _is_line(
            near, found, mx, my, mz, nx, ny, nz, bx, by, bz, thick, share
        ):
            verdicts[k] = SURFACE
        else:
            verdicts[k] = CLOUDY if is_dim_about else LONELY


@jit
def _is_line(near, found, mx, my, mz, nx, ny, nz, bx, by, bz, thick, share):
    """Say whether `share` of points (N, 3) in a plane of normal n lie within `thick` of one line that is not along the beam b."""
    # Axes in the plane: u as far along the beam as the plane allows, v across.
    along = nx * bx + ny * by + nz * bz
    ux, uy, uz = bx - along * nx, by - along * ny, bz - along * nz
    norm = math.sqrt(ux * ux + uy * uy + uz * uz)
    if norm < 1e-6:
        return True
    ux, uy, uz = ux / norm, uy / norm, uz / norm
    vx, vy, vz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
    uu = uv = vv = 0.0
    for j in range(found):
        x, y, z = near[j, 0] - mx, near[j, 1] - my, near[j, 2] - mz
        u, v = x * ux + y * uy + z * uz, x * vx + y * vy + z * vz
        uu += u * u
        uv += u * v
        vv += v * v
    angle = 0.5 * math.atan2(2.0 * uv, uu - vv)
    cu, cv = math.cos(angle), math.sin(angle)
    if abs(cu) > 0.95:
        return False
    thin = 0
    for j in range(found):
        x, y, z = near[j, 0] - mx, near[j, 1] - my, near[j, 2] - mz
        thin += abs(cu * (x * vx + y * vy + z * vz) - cv * (x * ux + y * uy + z * uz)) <= thick
    return thin >= share * found


@jit
def _normal(near, found, mx, my, mz):
    """Return the direction in which points (N, 3) about their mean spread least."""
    xx = xy = xz = yy = yz = zz = 0.0
    for j in range(found):
        x, y, z = near[j, 0] - mx, near[j, 1] - my, near[j, 2] - mz
        xx += x * x
        xy += x * y
        xz += x * z
        yy += y * y
        yz += y * z
        zz += z * z
    nx, ny, nz, _ = thinnest(xx, xy, xz, yy, yz, zz)
    norm = math.sqrt(nx * nx + ny * ny + nz * nz)
    if norm < 1e-12:
        return 0.0, 0.0, 1.0
    return nx / norm, ny / norm, nz / norm


@jit
def remember(keys, masks, seen, scan, places, size, again, is_lasting):
    """Note places (M, 3) of a map as hit in scan number `scan`; `is_lasting` (M,) says of each whether its cell of `size` m was hit in `again` of the scans before.

    `keys` int64 (T,), `masks` uint16 (T,) (a bit per scan, the newest lowest) and `seen` int64 (T,) (scan of the last hit) are a table, T a power of two, in which a
    newcomer takes the place of another cell.
    """
    fold = keys.shape[0] - 1
    for k in range(places.shape[0]):
        key = cell_key(places[k, 0], places[k, 1], places[k, 2], size)
        h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
        at = np.int64((h >> np.uint64(32)) & np.uint64(fold))
        if keys[at] != key:
            keys[at], masks[at], seen[at] = key, 0, scan
        late = scan - seen[at]
        mask = np.int64(masks[at]) << late if late < MEMORY else np.int64(0)
        mask = (mask | 1) & 0xFFFF
        masks[at], seen[at] = np.uint16(mask), scan
        before, count = mask >> 1, 0
        while before:
            before &= before - 1
            count += 1
        is_lasting[k] = count >= again


def warm_up() -> None:
    """Compile or load every kernel with its real argument types."""
    points = np.ones((8, 3), np.float32)
    intensity, near, is_dim = np.ones(8, np.float32), np.empty((8, 3), np.float32), np.empty(8, np.bool_)
    cell_of, begins, order = np.zeros(8, np.int64), np.zeros(33, np.int64), np.zeros(8, np.int64)
    asked, verdicts = np.zeros(1, np.int64), np.zeros(1, np.uint8)
    for cloud, bright in ((points, intensity), (read_only(points.copy()), read_only(intensity.copy()))):
        count_patches(cloud, 1, 8, 4, np.zeros(32, np.bool_))
        sort_cells(cloud, bright, 2.0, 0.5, 8, 4, cell_of, begins, order, near, is_dim)
        judge(cloud, near, is_dim, asked, 8, 4, cell_of, begins, order, 0.01, 0.15, 0.04, 0.6, verdicts)
    table = (np.full(16, -1, np.int64), np.zeros(16, np.uint16), np.zeros(16, np.int64))
    remember(*table, 1, np.zeros((1, 3)), 0.2, 3, np.zeros(1, np.bool_))
