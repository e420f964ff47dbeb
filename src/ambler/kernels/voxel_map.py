"""A hash of voxels that hold a few map points each, in flat arrays: insert, nearest neighbours with a plane through them, eviction.

`table_keys` int64 (T,) (EMPTY: free) and `table_slots` int32 (T,) are an open-addressing table, T a power of two at least four times
the voxels; `slot_keys` int64 (V,), `counts` int32 (V,) and `points` float32 (V, N, 3), metres in the map frame, are the voxels in the order in which they came;
`weights` float32 (V, N) is how many returns a point is the mean of, `used` int64 (1,) how many voxels there are.
Keys pack three signed cell numbers of 21 bits. Nothing is ever deleted singly: `evict` compacts what stays and builds the table again.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit, jit_fused, read_only

EMPTY = -1
HALF = 1 << 20
FARTHEST = 1e5  # metres; a point farther out is no point of a map
NEIGHBOURS = 5
# Cells visited for a query, the centre first, then those that share a face (7 in all), then those that share an edge (19).
OFFSETS = np.array(
    sorted(
        [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)],
        key=lambda c: (abs(c[0]) + abs(c[1]) + abs(c[2]), c),
    ),
    np.int64,
)


@jit
def cell_key(x, y, z, size):
    """Pack the cell of a point; EMPTY for points that no map holds."""
    if not (abs(x) < FARTHEST and abs(y) < FARTHEST and abs(z) < FARTHEST):
        return np.int64(EMPTY)
    ix, iy, iz = math.floor(x / size), math.floor(y / size), math.floor(z / size)
    if abs(ix) >= HALF - 1 or abs(iy) >= HALF - 1 or abs(iz) >= HALF - 1:
        return np.int64(EMPTY)
    return ((np.int64(ix) + HALF) << 42) | ((np.int64(iy) + HALF) << 21) | (np.int64(iz) + HALF)


@jit
def _place(key, mask):
    """Where the search for a key begins (multiplicative hash)."""
    h = np.uint64(key)
    h ^= h >> np.uint64(32)
    h *= np.uint64(0x9E3779B97F4A7C15)
    h ^= h >> np.uint64(29)
    return np.int64(h & np.uint64(mask))


@jit
def find(table_keys, table_slots, key):
    """Return the slot of a voxel, EMPTY if there is none."""
    mask = table_keys.shape[0] - 1
    at = _place(key, mask)
    while table_keys[at] != EMPTY:
        if table_keys[at] == key:
            return np.int64(table_slots[at])
        at = (at + 1) & mask
    return np.int64(EMPTY)


@jit
def _find_or_add(table_keys, table_slots, slot_keys, counts, used, key):
    """Return the slot of a voxel, made if need be; EMPTY if there is no room."""
    mask = table_keys.shape[0] - 1
    at = _place(key, mask)
    while table_keys[at] != EMPTY:
        if table_keys[at] == key:
            return np.int64(table_slots[at])
        at = (at + 1) & mask
    slot = used[0]
    if slot >= slot_keys.shape[0]:
        return np.int64(EMPTY)
    table_keys[at], table_slots[at] = key, slot
    slot_keys[slot], counts[slot] = key, 0
    used[0] = slot + 1
    return slot


@jit
def insert(table_keys, table_slots, slot_keys, counts, points, weights, used, new, size, spacing, merge, most):
    """Add points float64 (M, 3); returns how many found no room.

    A point nearer than `spacing` to one of its voxel is not added; nearer than `merge`, it moves that one to the mean of all its returns, of
    which at most `most` count.
    """
    lost = 0
    capacity = points.shape[1]
    for k in range(new.shape[0]):
        x, y, z = new[k, 0], new[k, 1], new[k, 2]
        key = cell_key(x, y, z, size)
        if key == EMPTY:
            continue
        slot = _find_or_add(table_keys, table_slots, slot_keys, counts, used, key)
        if slot == EMPTY:
            lost += 1
            continue
        nearest, at = np.inf, -1
        for i in range(counts[slot]):
            dx, dy, dz = points[slot, i, 0] - x, points[slot, i, 1] - y, points[slot, i, 2] - z
            d = dx * dx + dy * dy + dz * dz
            if d < nearest:
                nearest, at = d, i
        if nearest < merge * merge:
            w = weights[slot, at]
            if w < most:
                points[slot, at, 0] += np.float32((x - points[slot, at, 0]) / (w + 1.0))
                points[slot, at, 1] += np.float32((y - points[slot, at, 1]) / (w + 1.0))
                points[slot, at, 2] += np.float32((z - points[slot, at, 2]) / (w + 1.0))
                weights[slot, at] = w + np.float32(1.0)
        elif nearest >= spacing * spacing and counts[slot] < capacity:
            i = counts[slot]
            points[slot, i, 0], points[slot, i, 1], points[slot, i, 2] = x, y, z
            weights[slot, i] = 1.0
            counts[slot] = i + 1
    return lost


@jit
def evict(table_keys, table_slots, slot_keys, counts, points, weights, used, center, radius, size):
    """Keep the voxels whose middle lies within `radius` of `center` (3,) and build the table again."""
    kept = 0
    for slot in range(used[0]):
        key = slot_keys[slot]
        x = (float((key >> 42) - HALF) + 0.5) * size - center[0]
        y = (float(((key >> 21) & (2 * HALF - 1)) - HALF) + 0.5) * size - center[1]
        z = (float((key & (2 * HALF - 1)) - HALF) + 0.5) * size - center[2]
        if x * x + y * y + z * z > radius * radius:
            continue
        if kept != slot:
            slot_keys[kept], counts[kept] = key, counts[slot]
            for i in range(counts[slot]):
                weights[kept, i] = weights[slot, i]
                for j in range(3):
                    points[kept, i, j] = points[slot, i, j]
        kept += 1
    used[0] = kept
    mask = table_keys.shape[0] - 1
    table_keys[:] = EMPTY
    for slot in range(kept):
        at = _place(slot_keys[slot], mask)
        while table_keys[at] != EMPTY:
            at = (at + 1) & mask
        table_keys[at], table_slots[at] = slot_keys[slot], slot


@jit_fused
def _nearest(table_keys, table_slots, counts, points, x, y, z, size, offsets, visits, reach, near, distances):
    """Fill `near` (5, 3) and ascending squared `distances` (5,) with the nearest map points; returns how many there are."""
    found = 0
    worst = reach * reach
    cx, cy, cz = math.floor(x / size), math.floor(y / size), math.floor(z / size)
    for v in range(visits):
        ix, iy, iz = cx + offsets[v, 0], cy + offsets[v, 1], cz + offsets[v, 2]
        if found == NEIGHBOURS:
            # The nearest that a point of that cell can be.
            gx = max(ix * size - x, x - (ix + 1) * size, 0.0)
            gy = max(iy * size - y, y - (iy + 1) * size, 0.0)
            gz = max(iz * size - z, z - (iz + 1) * size, 0.0)
            if gx * gx + gy * gy + gz * gz >= worst:
                continue
        key = ((np.int64(ix) + HALF) << 42) | ((np.int64(iy) + HALF) << 21) | (np.int64(iz) + HALF)
        slot = find(table_keys, table_slots, key)
        if slot == EMPTY:
            continue
        for i in range(counts[slot]):
            px, py, pz = float(points[slot, i, 0]), float(points[slot, i, 1]), float(points[slot, i, 2])
            dx, dy, dz = px - x, py - y, pz - z
            d = dx * dx + dy * dy + dz * dz
            if d >= worst:
                continue
            at = found if found < NEIGHBOURS else NEIGHBOURS - 1
            while at > 0 and distances[at - 1] > d:
                distances[at] = distances[at - 1]
                near[at, 0], near[at, 1], near[at, 2] = near[at - 1, 0], near[at - 1, 1], near[at - 1, 2]
                at -= 1
            distances[at] = d
            near[at, 0], near[at, 1], near[at, 2] = px, py, pz
            if found < NEIGHBOURS:
                found += 1
            if found == NEIGHBOURS:
                worst = distances[NEIGHBOURS - 1]
    return found


@jit_fused
def thinnest(xx, xy, xz, yy, yz, zz):
    """Return the direction in which points with this scatter matrix spread least, of any length: the largest column of its adjugate; and the sum of its
    principal minors."""
    ax, ay, az = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    if ax >= ay and ax >= az:
        nx, ny, nz = ax, xz * yz - xy * zz, xy * yz - xz * yy
    elif ay >= az:
        nx, ny, nz = xz * yz - xy * zz, ay, xy * xz - yz * xx
    else:
        nx, ny, nz = xy * yz - xz * yy, xy * xz - yz * xx, az
    return nx, ny, nz, ax + ay + az


@jit_fused
def _plane(near, thickness, flatness, out):
    """Fit a plane n.x + d = 0 to `near` (5, 3), written to `out` (4,); False for a point farther off than `thickness`, and where the
    points lie so nearly on a line that the plane could turn about it.

    `flatness` bounds the sum of the principal minors of the scatter matrix over the square of its trace from below: 0 on a line, a quarter on an
    isotropic plane.
    """
    mx = my = mz = 0.0
    for i in range(NEIGHBOURS):
        mx += near[i, 0]
        my += near[i, 1]
        mz += near[i, 2]
    mx, my, mz = mx / NEIGHBOURS, my / NEIGHBOURS, mz / NEIGHBOURS
    xx = xy = xz = yy = yz = zz = 0.0
    for i in range(NEIGHBOURS):
        x, y, z = near[i, 0] - mx, near[i, 1] - my, near[i, 2] - mz
        xx += x * x
        xy += x * y
        xz += x * z
        yy += y * y
        yz += y * z
        zz += z * z
    trace = xx + yy + zz
    nx, ny, nz, minors = thinnest(xx, xy, xz, yy, yz, zz)
    if not minors >= flatness * trace * trace or trace <= 0.0:
        return False
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length <= 0.0:
        return False
    nx, ny, nz = nx / length, ny / length, nz / length
    d = -(nx * mx + ny * my + nz * mz)
    for i in range(NEIGHBOURS):
        if abs(nx * near[i, 0] + ny * near[i, 1] + nz * near[i, 2] + d) > thickness:
            return False
    out[0], out[1], out[2], out[3] = nx, ny, nz, d
    return True


@jit_fused
def fit_planes(
    table_keys, table_slots, counts, points, size, queries, offsets, visits, reach, thickness, flatness,
    planes, is_plane,
):  # fmt: skip
    """Fit a plane to the five map points nearest to every query float64 (M, 3) within `reach`; writes `planes` float64 (M, 4) and
    `is_plane` bool (M,). `visits` is how many of the cells around are looked into (7, 19 or 27)."""
    near, distances = np.empty((NEIGHBOURS, 3)), np.empty(NEIGHBOURS)
    for k in range(queries.shape[0]):
        x, y, z = queries[k, 0], queries[k, 1], queries[k, 2]
        if not (abs(x) < FARTHEST and abs(y) < FARTHEST and abs(z) < FARTHEST):
            is_plane[k] = False
            continue
        found = _nearest(
            table_keys, table_slots, counts, points, x, y, z, size, offsets, visits, reach, near, distances
        )
        is_plane[k] = found == NEIGHBOURS and _plane(near, thickness, flatness, planes[k])


@jit
def choose_between(points, times, near, far, step, out):
    """Write the numbers of every `step`-th of the points float32 (N, 3) that lie more than `near` and less than `far` m away and whose time float32 (N,) is finite to
    `out` int64 (N,); returns how many."""
    inside, kept = 0, 0
    for k in range(points.shape[0]):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        square = x * x + y * y + z * z
        if near * near < square < far * far and math.isfinite(times[k]):
            if inside % step == 0:
                out[kept] = k
                kept += 1
            inside += 1
    return kept


@jit
def thin_out(points, numbers, size, table_keys, out):
    """Take the first of the points float32 (N, 3) with these `numbers` int64 (M,) in every cell of `size` metres; writes theirs to `out` int64 (M,), which may be
    `numbers`, and returns how many.

    `table_keys` int64 (T,), T a power of two above 2 M, is scratch.
    """
    table_keys[:] = EMPTY
    mask = table_keys.shape[0] - 1
    kept = 0
    for at_number in range(numbers.shape[0]):
        k = numbers[at_number]
        key = cell_key(points[k, 0], points[k, 1], points[k, 2], size)
        if key == EMPTY:
            continue
        at = _place(key, mask)
        while table_keys[at] != EMPTY and table_keys[at] != key:
            at = (at + 1) & mask
        if table_keys[at] == EMPTY:
            table_keys[at] = key
            out[kept] = k
            kept += 1
    return kept


def warm_up() -> None:
    """Compile or load every kernel with its real argument types."""
    table = (np.full(16, EMPTY, np.int64), np.zeros(16, np.int32))
    voxels = (np.zeros(4, np.int64), np.zeros(4, np.int32))
    points, weights, used = np.zeros((4, 8, 3), np.float32), np.zeros((4, 8), np.float32), np.zeros(1, np.int64)
    new = np.zeros((1, 3))
    insert(*table, *voxels, points, weights, used, new, 1.0, 0.45, 0.2, 10.0)
    evict(*table, *voxels, points, weights, used, np.zeros(3), 1.0, 1.0)
    find(*table, np.int64(0))
    fit_planes(
        *(*table, voxels[1], points, 1.0, new, OFFSETS, 7, 2.0, 0.1, 0.04),
        *(np.empty((1, 4)), np.empty(1, np.bool_)),
    )
    numbers, times = np.zeros(1, np.int64), np.zeros(1, np.float32)
    choose_between(np.zeros((1, 3), np.float32), times, 0.5, 1.0, 1, numbers)
    choose_between(read_only(np.zeros((1, 3), np.float32)), read_only(times), 0.5, 1.0, 1, numbers)
    for points in (np.zeros((1, 3), np.float32), read_only(np.zeros((1, 3), np.float32))):
        thin_out(points, numbers, 0.5, np.empty(16, np.int64), numbers)
