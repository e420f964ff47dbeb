"""Kernels that turn an occupancy grid into surface elements: the faces of occupied cells that can be seen from free space.

A face lies where the occupancy, interpolated between the centres of the free and the occupied cell, crosses 50. Each face is
smoothed to a surface element by a local line fit over faces that look the same way, so that walls at any angle become straight
and the two sides of a thin wall stay apart. Facings: 0 +x, 1 -x, 2 +y, 3 -y (the side on which the free space lies).
"""

import math

import numpy as np

from ambler.kernels.jit import jit

WEAK, STRONG = 5, 6  # faces that support one that is not known to belong to any line, and one that is
ASIDE = 2.0  # cells from a wall within which a speck is of it
DX = np.array([1, -1, 0, 0])
DY = np.array([0, 0, 1, -1])


@jit
def count_faces(cells, threshold):
    """Return how many faces separate an occupied cell (>= threshold) of `cells` int8 (H, W) from a free one (known, below)."""
    height, width = cells.shape
    count = 0
    for iy in range(height):
        for ix in range(width):
            if cells[iy, ix] >= threshold:
                for f in range(4):
                    jy, jx = iy + DY[f], ix + DX[f]
                    if 0 <= jy < height and 0 <= jx < width and 0 <= cells[jy, jx] < threshold:
                        count += 1
    return count


@jit
def extract_faces(cells, threshold, frame, positions, facings, owners):
    """Write every face: `positions` float64 (N, 2) in metres, `facings` int8 (N,), `owners` int32 (4, H, W): face of a cell or -1.

    `frame` float64 (3,): resolution and outer corner of cell [0, 0].
    """
    height, width = cells.shape
    owners[:, :, :] = -1
    n = 0
    for iy in range(height):
        for ix in range(width):
            if cells[iy, ix] < threshold:
                continue
            for f in range(4):
                jy, jx = iy + DY[f], ix + DX[f]
                if not (0 <= jy < height and 0 <= jx < width and 0 <= cells[jy, jx] < threshold):
                    continue
                occupied, free = float(cells[iy, ix]), float(cells[jy, jx])
                reach = (occupied - 50.0) / (occupied - free)
                reach = min(1.0, max(0.0, reach))
                positions[n, 0] = frame[1] + frame[0] * (ix + 0.5 + reach * DX[f])
                positions[n, 1] = frame[2] + frame[0] * (iy + 0.5 + reach * DY[f])
                facings[n] = f
                owners[f, iy, ix] = n
                n += 1


@jit
def _fit_line(i, cell_x, cell_y, positions, owners, frame, radius, line):
    """Fit a line to the faces around face i that look along the current normal line[2:4]; returns the number of faces used."""
    height, width = owners.shape[1], owners.shape[2]
    res = frame[0]
    sigma2 = 2.0 * (0.5 * radius * res) ** 2
    nx, ny = line[2], line[3]
    sw = sx = sy = sxx = sxy = syy = 0.0
    used = 0
    for f in range(4):
        if DX[f] * nx + DY[f] * ny < 0.35:
            continue
        for jy in range(max(0, cell_y - radius), min(height, cell_y + radius + 1)):
            for jx in range(max(0, cell_x - radius), min(width, cell_x + radius + 1)):
                j = owners[f, jy, jx]
                if j < 0:
                    continue
                ex, ey = positions[j, 0] - line[0], positions[j, 1] - line[1]
                if abs(ex * nx + ey * ny) > 1.05 * res:
                    continue
                dx, dy = positions[j, 0] - positions[i, 0], positions[j, 1] - positions[i, 1]
                w = math.exp(-(dx * dx + dy * dy) / sigma2)
                sw += w
                sx += w * dx
                sy += w * dy
                sxx += w * dx * dx
                sxy += w * dx * dy
                syy += w * dy * dy
                used += 1
    if used < 3:
        return used
    mx, my = sx / sw, sy / sw
    a, b, d = sxx / sw - mx * mx, sxy / sw - mx * my, syy / sw - my * my
    angle = 0.5 * math.atan2(2.0 * b, a - d)
    tx, ty = -math.sin(angle), math.cos(angle)
    if tx * nx + ty * ny < 0.0:
        tx, ty = -tx, -ty
    line[0] = positions[i, 0] + mx
    line[1] = positions[i, 1] + my
    line[2], line[3] = tx, ty
    return used


@jit
def _mean_normal(cell_x, cell_y, owners, f, line):
    """Point the line's normal along the mean of the facings within 3 cells that do not look away from facing f."""
    nx = ny = 0.0
    for g in range(4):
        if DX[f] * DX[g] + DY[f] * DY[g] < 0:
            continue
        for jy in range(max(0, cell_y - 3), min(owners.shape[1], cell_y + 4)):
            for jx in range(max(0, cell_x - 3), min(owners.shape[2], cell_x + 4)):
                if owners[g, jy, jx] >= 0:
                    nx += DX[g]
                    ny += DY[g]
    norm = math.sqrt(nx * nx + ny * ny)
    line[2], line[3] = nx / norm, ny / norm


@jit
def smooth_faces(positions, facings, owners, frame, radius, surfaces):
    """Write `surfaces` float64 (N, 4): point (x, y) and unit normal towards free space of every face, from fits over +-radius cells.
    Faces that are steps and specks of a wall (`_join_walls`) leave `owners` or become parts of it."""
    height, width = owners.shape[1], owners.shape[2]
    support = np.zeros(positions.shape[0], np.int32)
    line = np.empty(4)
    for iy in range(height):
        for ix in range(width):
            for f in range(4):
                i = owners[f, iy, ix]
                if i < 0:
                    continue
                line[0], line[1] = positions[i, 0], positions[i, 1]
                line[2], line[3] = float(DX[f]), float(DY[f])
                used = 0
                for attempt in range(2):
                    if attempt == 1:
                        _mean_normal(ix, iy, owners, f, line)
                    for _ in range(4):
                        used = _fit_line(i, ix, iy, positions, owners, frame, radius, line)
                        if used < 3:
                            break
                    if used >= 3:
                        break
                if used < 3:
                    line[0], line[1] = positions[i, 0], positions[i, 1]
                    line[2], line[3] = float(DX[f]), float(DY[f])
                e = (positions[i, 0] - line[0]) * line[2] + (positions[i, 1] - line[1]) * line[3]
                surfaces[i, 0] = positions[i, 0] - e * line[2]
                surfaces[i, 1] = positions[i, 1] - e * line[3]
                surfaces[i, 2], surfaces[i, 3] = line[2], line[3]
                support[i] = used
    _join_walls(positions, owners, frame, radius, support, surfaces)


@jit
def _join_walls(positions, owners, frame, radius, support, surfaces):
    """Let faces that hardly any others support be parts of the wall that goes on to both sides of them: the steps that a wall at an angle makes in a
    grid, and specks before one that was drawn twice. They would tell of a place along the wall, wherever the robot is. What looks away from
    that wall is no surface; the end of a wall is one."""
    height, width = owners.shape[1], owners.shape[2]
    res = frame[0]
    for iy in range(height):
        for ix in range(width):
            for f in range(4):
                i = owners[f, iy, ix]
                if i < 0 or support[i] >= WEAK:
                    continue
                wall, best = -1, 1e30
                for g in range(4):
                    for jy in range(max(0, iy - radius), min(height, iy + radius + 1)):
                        for jx in range(max(0, ix - radius), min(width, ix + radius + 1)):
                            j = owners[g, jy, jx]
                            if j < 0 or support[j] < STRONG:
                                continue
                            ex, ey = positions[i, 0] - surfaces[j, 0], positions[i, 1] - surfaces[j, 1]
                            d = ex * ex + ey * ey
                            if d < best and abs(ex * surfaces[j, 2] + ey * surfaces[j, 3]) <= ASIDE * res:
                                best, wall = d, j
                if wall < 0:
                    continue
                nx, ny = surfaces[wall, 2], surfaces[wall, 3]
                left = right = False
                far = 2 * radius
                for g in range(4):
                    for jy in range(max(0, iy - far), min(height, iy + far + 1)):
                        for jx in range(max(0, ix - far), min(width, ix + far + 1)):
                            j = owners[g, jy, jx]
                            if j < 0 or support[j] < WEAK or surfaces[j, 2] * nx + surfaces[j, 3] * ny < 0.8:
                                continue
                            ex, ey = positions[j, 0] - surfaces[wall, 0], positions[j, 1] - surfaces[wall, 1]
                            if abs(ex * nx + ey * ny) > 1.5 * res:
                                continue
                            along = (positions[j, 1] - positions[i, 1]) * nx - (positions[j, 0] - positions[i, 0]) * ny
                            left |= along > res
                            right |= along < -res
                if not (left and right):
                    continue
                if DX[f] * nx + DY[f] * ny < 0.0:
                    owners[f, iy, ix] = -1
                    continue
                e = (positions[i, 0] - surfaces[wall, 0]) * nx + (positions[i, 1] - surfaces[wall, 1]) * ny
                surfaces[i, 0] = positions[i, 0] - e * nx
                surfaces[i, 1] = positions[i, 1] - e * ny
                surfaces[i, 2], surfaces[i, 3] = nx, ny


@jit
def spread_nearest(places, faces, surfaces, frame, limit, squared, nearest):
    """Write `nearest` int32 (H, W): the surface nearest to each cell's centre, for one facing; -1 beyond `limit` metres. `places` int64 (M,) are the cells
    (iy * W + ix) that have a face of it, ascending, and `faces` int32 (M,) which.

    Every surface is stamped on the square around it. `squared` float32 (H, W) ends as the squared distance (limit² where none).
    """
    height, width = nearest.shape
    nearest[:, :] = -1
    squared[:, :] = limit * limit
    radius = int(math.ceil(limit / frame[0])) + 1
    for m in range(places.shape[0]):
        iy, ix, k = places[m] // width, places[m] % width, faces[m]
        sx = (surfaces[k, 0] - frame[1]) - 0.5 * frame[0]
        sy = (surfaces[k, 1] - frame[2]) - 0.5 * frame[0]
        for jy in range(max(0, iy - radius), min(height, iy + radius + 1)):
            dy = jy * frame[0] - sy
            for jx in range(max(0, ix - radius), min(width, ix + radius + 1)):
                dx = jx * frame[0] - sx
                d = dx * dx + dy * dy
                if d < squared[jy, jx]:
                    squared[jy, jx] = d
                    nearest[jy, jx] = k


@jit
def lower_distance(squared, distance):
    """Lower `distance` float32 (H, W) to the root of `squared` (H, W) where that is less."""
    for iy in range(distance.shape[0]):
        for ix in range(distance.shape[1]):
            d = math.sqrt(squared[iy, ix])
            distance[iy, ix] = min(distance[iy, ix], d)


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    cells = np.zeros((5, 5), np.int8)
    cells[2, 1:4] = 100
    frame = np.array([1.0, 0.0, 0.0])
    n = count_faces(cells, 50)
    positions, facings, owners = np.empty((n, 2)), np.empty(n, np.int8), np.empty((4, 5, 5), np.int32)
    extract_faces(cells, 50, frame, positions, facings, owners)
    surfaces = np.empty((n, 4))
    smooth_faces(positions, facings, owners, frame, 4, surfaces)
    nearest = np.empty((4, 5, 5), np.int32)
    squared = np.empty((5, 5), np.float32)
    places = np.flatnonzero(owners[0] >= 0)
    spread_nearest(places, owners[0].ravel()[places], surfaces, frame, 1.0, squared, nearest[0])
    lower_distance(squared, np.ones((5, 5), np.float32))
