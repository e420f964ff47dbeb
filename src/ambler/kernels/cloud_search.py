"""Kernels of the search in a saved cloud: a hash of cells that know which way the surface in them faces, shares of a scan's points that find a
surface of their kind, and rays that end behind surfaces of the map.

Cells are those of `kernels.voxel_map.cell_key`; `table_keys` int64 (T,) and `table_slots` int32 (T,) as there; `kinds` uint8 (V,) holds
the bits `WALL` and `FLAT` of a cell and `planes` float64 (V, 4) a plane n.x + d = 0 in it.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit
from ambler.kernels.voxel_map import EMPTY, _place, cell_key, find

WALL, FLAT = 1, 2


@jit
def fill_cells(table_keys, table_slots, points, of_point, planes_of_point, size, kinds, planes):
    """Enter points float64 (M, 3) with their kind uint8 (M,) and plane float64 (M, 4); the first of a cell gives it its plane. Returns the
    number of cells. `table_keys` must be EMPTY throughout."""
    mask = table_keys.shape[0] - 1
    used = 0
    for k in range(points.shape[0]):
        if of_point[k] == 0:
            continue
        key = cell_key(points[k, 0], points[k, 1], points[k, 2], size)
        if key == EMPTY:
            continue
        at = _place(key, mask)
        while table_keys[at] != EMPTY and table_keys[at] != key:
            at = (at + 1) & mask
        if table_keys[at] == EMPTY:
            table_keys[at], table_slots[at] = key, used
            kinds[used] = 0
            for i in range(4):
                planes[used, i] = planes_of_point[k, i]
            used += 1
        kinds[table_slots[at]] |= of_point[k]
    return used


@jit
def score_heights(table_keys, table_slots, kinds, size, points, of_point, pose, low, step, shares):
    """Write `shares` float64 (H, 2): for each height low + h step of the sensor the share of the walls and of the flats among points float64
    (N, 3), `of_point` uint8 (N,), that lie in a cell of their kind; `pose` float64 (3,): x, y, yaw."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    walls = flats = 0
    shares[:] = 0.0
    for k in range(points.shape[0]):
        kind = of_point[k]
        if kind == 0:
            continue
        x = c * points[k, 0] - s * points[k, 1] + pose[0]
        y = s * points[k, 0] + c * points[k, 1] + pose[1]
        column = 0 if kind == WALL else 1
        walls += 1 - column
        flats += column
        for h in range(shares.shape[0]):
            slot = find(table_keys, table_slots, cell_key(x, y, points[k, 2] + low + h * step, size))
            if slot != EMPTY and kinds[slot] & kind:
                shares[h, column] += 1.0
    for h in range(shares.shape[0]):
        shares[h, 0] /= max(walls, 1)
        shares[h, 1] /= max(flats, 1)


@jit
def count_blocked(table_keys, table_slots, planes, size, origins, ends, clear, least_cosine):
    """Return how many rays from origins to ends, float64 (N, 3) each, pass through a plane of a cell on their way: both ends at least
    `clear` metres off it, on different sides, and the ray meets it within the cell and not flatter than `least_cosine`."""
    blocked = 0
    for k in range(ends.shape[0]):
        dx, dy, dz = ends[k, 0] - origins[k, 0], ends[k, 1] - origins[k, 1], ends[k, 2] - origins[k, 2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not length > 2.0 * clear:
            continue
        steps = int(math.ceil(2.0 * length / size))
        last = np.int64(EMPTY)
        for j in range(1, steps):
            t = j / steps
            key = cell_key(origins[k, 0] + t * dx, origins[k, 1] + t * dy, origins[k, 2] + t * dz, size)
            if key == last:
                continue
            last = key
            slot = find(table_keys, table_slots, key)
            if slot == EMPTY:
                continue
            nx, ny, nz, d = planes[slot, 0], planes[slot, 1], planes[slot, 2], planes[slot, 3]
            before = nx * origins[k, 0] + ny * origins[k, 1] + nz * origins[k, 2] + d
            after = nx * ends[k, 0] + ny * ends[k, 1] + nz * ends[k, 2] + d
            if before * after >= 0.0 or abs(before) < clear or abs(after) < clear:
                continue
            if abs(before - after) < least_cosine * length:
                continue
            u = before / (before - after)
            met = cell_key(origins[k, 0] + u * dx, origins[k, 1] + u * dy, origins[k, 2] + u * dz, size)
            if met == key:
                blocked += 1
                break
    return blocked


def warm_up() -> None:
    """Compile or load every kernel with its real argument types."""
    table = (np.full(16, EMPTY, np.int64), np.zeros(16, np.int32))
    kinds, planes = np.zeros(4, np.uint8), np.zeros((4, 4))
    points, of_point = np.zeros((1, 3)), np.ones(1, np.uint8)
    fill_cells(*table, points, of_point, np.zeros((1, 4)), 0.5, kinds, planes)
    score_heights(*table, kinds, 0.5, points, of_point, np.zeros(3), 0.0, 0.25, np.empty((2, 2)))
    count_blocked(*table, planes, 0.5, points, points + 3.0, 0.5, 0.2)
