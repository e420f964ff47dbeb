"""Rays against oriented boxes and cylinders in a bounding volume hierarchy, for the simulator's sensors only.

A primitive is a row of `prims` float64 (P, 15): centre (3), half extents (3), rotation world_from_local row by row (9); a
cylinder stands along its local z with radius half[0]. `kinds` uint8 (P,): 0 box, 1 cylinder. A node's `bounds` float64 (N, 6)
are (lower, upper); `counts` > 0 marks a leaf with primitives `firsts ... firsts + counts - 1`, else its children are
`firsts` and `firsts + 1`. Floor and ceiling are planes of their own. Slab test after Kay and Kajiya 1986.
"""

from __future__ import annotations

import math

import numpy as np

from ambler.kernels.jit import jit

STACK = 64
NOTHING = -1
FLOOR = -2
CEILING = -3
TINY = 1e-12


@jit
def _away_from_zero(d):
    if abs(d) < TINY:
        return TINY if d >= 0.0 else -TINY
    return d


@jit
def _entry(bounds, node, ox, oy, oz, ix, iy, iz, best):
    """Distance at which the ray enters a node's bounds, or inf if it misses them before `best`."""
    ax = (bounds[node, 0] - ox) * ix
    bx = (bounds[node, 3] - ox) * ix
    ay = (bounds[node, 1] - oy) * iy
    by = (bounds[node, 4] - oy) * iy
    az = (bounds[node, 2] - oz) * iz
    bz = (bounds[node, 5] - oz) * iz
    near = max(min(ax, bx), min(ay, by), min(az, bz), 0.0)
    far = min(max(ax, bx), max(ay, by), max(az, bz), best)
    return near if near <= far else np.inf


@jit
def _hit_box(hx, hy, hz, px, py, pz, dx, dy, dz):
    """Distance and cosine of incidence on a box about the origin; from inside, of the way out."""
    dx, dy, dz = _away_from_zero(dx), _away_from_zero(dy), _away_from_zero(dz)
    ix, iy, iz = 1.0 / dx, 1.0 / dy, 1.0 / dz
    mx, my, mz = -px * ix, -py * iy, -pz * iz
    kx, ky, kz = abs(ix) * hx, abs(iy) * hy, abs(iz) * hz
    near = max(mx - kx, my - ky, mz - kz)
    far = min(mx + kx, my + ky, mz + kz)
    if near > far or far < 0.0:
        return np.inf, 0.0
    if near >= 0.0:
        if near == mx - kx:
            return near, abs(dx)
        if near == my - ky:
            return near, abs(dy)
        return near, abs(dz)
    if far == mx + kx:
        return far, abs(dx)
    if far == my + ky:
        return far, abs(dy)
    return far, abs(dz)


@jit
def _hit_cylinder(radius, half, px, py, pz, dx, dy, dz):
    """Distance and cosine of incidence on a capped cylinder along z about the origin."""
    best, cosine = np.inf, 0.0
    a = dx * dx + dy * dy
    if a > TINY:
        b = px * dx + py * dy
        disc = b * b - a * (px * px + py * py - radius * radius)
        if disc >= 0.0:
            root = math.sqrt(disc)
            t = (-b - root) / a
            if t < 0.0:
                t = (-b + root) / a
            if t >= 0.0 and abs(pz + t * dz) <= half:
                best, cosine = t, root / radius
    if abs(dz) > TINY:
        for side in (-1.0, 1.0):
            t = (side * half - pz) / dz
            if 0.0 <= t < best:
                x, y = px + t * dx, py + t * dy
                if x * x + y * y <= radius * radius:
                    best, cosine = t, abs(dz)
    return best, cosine


@jit
def _hit_primitive(prims, kinds, k, ox, oy, oz, dx, dy, dz):
    rx, ry, rz = ox - prims[k, 0], oy - prims[k, 1], oz - prims[k, 2]
    px = prims[k, 6] * rx + prims[k, 9] * ry + prims[k, 12] * rz
    py = prims[k, 7] * rx + prims[k, 10] * ry + prims[k, 13] * rz
    pz = prims[k, 8] * rx + prims[k, 11] * ry + prims[k, 14] * rz
    ex = prims[k, 6] * dx + prims[k, 9] * dy + prims[k, 12] * dz
    ey = prims[k, 7] * dx + prims[k, 10] * dy + prims[k, 13] * dz
    ez = prims[k, 8] * dx + prims[k, 11] * dy + prims[k, 14] * dz
    if kinds[k] == 0:
        return _hit_box(prims[k, 3], prims[k, 4], prims[k, 5], px, py, pz, ex, ey, ez)
    return _hit_cylinder(prims[k, 3], prims[k, 5], px, py, pz, ex, ey, ez)


@jit
def _nearest(bounds, firsts, counts, prims, kinds, floor, ceiling, ox, oy, oz, dx, dy, dz, reach, stack):
    """Nearest surface along a unit ray: (distance or inf, primitive or NOTHING, FLOOR, CEILING; cosine of incidence)."""
    best, hit, cosine = reach, NOTHING, 0.0
    if dz < -TINY and oz > floor:
        t = (floor - oz) / dz
        if t < best:
            best, hit, cosine = t, FLOOR, -dz
    if dz > TINY and oz < ceiling:
        t = (ceiling - oz) / dz
        if t < best:
            best, hit, cosine = t, CEILING, dz
    ix, iy, iz = 1.0 / _away_from_zero(dx), 1.0 / _away_from_zero(dy), 1.0 / _away_from_zero(dz)
    top = 0
    node = np.int32(0)
    if _entry(bounds, node, ox, oy, oz, ix, iy, iz, best) == np.inf:
        node = np.int32(-1)
    while node >= 0:
        if counts[node] > 0:
            for k in range(firsts[node], firsts[node] + counts[node]):
                t, c = _hit_primitive(prims, kinds, k, ox, oy, oz, dx, dy, dz)
                if t < best:
                    best, hit, cosine = t, k, c
            node = np.int32(-1)
        else:
            left = firsts[node]
            a = _entry(bounds, left, ox, oy, oz, ix, iy, iz, best)
            b = _entry(bounds, left + 1, ox, oy, oz, ix, iy, iz, best)
            if a <= b:
                node = left if a < np.inf else np.int32(-1)
                if b < np.inf:
                    stack[top] = left + 1
                    top += 1
            else:
                node = np.int32(left + 1)
                if a < np.inf:
                    stack[top] = left
                    top += 1
        while node < 0 and top > 0:
            top -= 1
            node = stack[top]
            if _entry(bounds, node, ox, oy, oz, ix, iy, iz, best) == np.inf:
                node = np.int32(-1)
    if hit == NOTHING:
        return np.inf, hit, cosine
    return best, hit, cosine


@jit
def cast_rays(
    bounds, firsts, counts, prims, kinds, floor, ceiling, origins, directions, reach, out_distance, out_hit, out_cosine
):
    """Cast N rays of their own origins (N, 3) and unit directions (N, 3) up to `reach` metres.

    Writes distance float64 (N,) (inf: nothing), the primitive hit int32 (N,) and the cosine of incidence float64 (N,).
    """
    stack = np.empty(STACK, np.int32)
    for i in range(origins.shape[0]):
        t, hit, cosine = _nearest(
            *(bounds, firsts, counts, prims, kinds, floor, ceiling),
            *(origins[i, 0], origins[i, 1], origins[i, 2]),
            *(directions[i, 0], directions[i, 1], directions[i, 2], reach, stack),
        )
        out_distance[i] = t
        out_hit[i] = hit
        out_cosine[i] = cosine


@jit
def _pose_at(times, positions, quaternions, t, start, rotation, origin):
    """Interpolate knots at time t into rotation (3, 3) and origin (3,); returns the knot to start the next search from."""
    k = start
    while k < times.shape[0] - 2 and times[k + 1] <= t:
        k += 1
    span = times[k + 1] - times[k]
    s = min(max((t - times[k]) / span, 0.0), 1.0)
    for j in range(3):
        origin[j] = (1.0 - s) * positions[k, j] + s * positions[k + 1, j]
    dot = 0.0
    for j in range(4):
        dot += quaternions[k, j] * quaternions[k + 1, j]
    far = s if dot >= 0.0 else -s
    w = (1.0 - s) * quaternions[k, 0] + far * quaternions[k + 1, 0]
    x = (1.0 - s) * quaternions[k, 1] + far * quaternions[k + 1, 1]
    y = (1.0 - s) * quaternions[k, 2] + far * quaternions[k + 1, 2]
    z = (1.0 - s) * quaternions[k, 3] + far * quaternions[k + 1, 3]
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * n, x * n, y * n, z * n
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return k


@jit
def sweep(
    bounds, firsts, counts, prims, kinds, albedos, floor, ceiling,
    times, positions, quaternions, column_times, directions, reach, out_distance, out_cosine, out_intensity,
):  # fmt: skip
    """Cast the rays of a moving scanner: column c fires its R rays at `column_times[c]` from the sensor's pose at that time.

    `times` (K,), `positions` (K, 3), `quaternions` (K, 4, wxyz) are the sensor's poses in the world, K >= 2; `directions`
    float64 (C, R, 3) are unit vectors in the sensor frame. Writes float32 (C, R): exact distance (inf: nothing), cosine of
    incidence, and intensity = albedo * cosine (floor and ceiling: the last two of `albedos`).
    """
    stack = np.empty(STACK, np.int32)
    rotation = np.empty((3, 3))
    origin = np.empty(3)
    knot = 0
    solids = prims.shape[0]
    for c in range(directions.shape[0]):
        knot = _pose_at(times, positions, quaternions, column_times[c], knot, rotation, origin)
        for r in range(directions.shape[1]):
            ex, ey, ez = directions[c, r, 0], directions[c, r, 1], directions[c, r, 2]
            t, hit, cosine = _nearest(
                *(bounds, firsts, counts, prims, kinds, floor, ceiling, origin[0], origin[1], origin[2]),
                rotation[0, 0] * ex + rotation[0, 1] * ey + rotation[0, 2] * ez,
                rotation[1, 0] * ex + rotation[1, 1] * ey + rotation[1, 2] * ez,
                rotation[2, 0] * ex + rotation[2, 1] * ey + rotation[2, 2] * ez,
                *(reach, stack),
            )
            out_distance[c, r] = t
            out_cosine[c, r] = cosine
            surface = hit if hit >= 0 else solids - hit - 2
            out_intensity[c, r] = albedos[surface] * cosine if t < np.inf else 0.0


@jit
def corrupt_ranges(
    distance, cosine, normals, uniforms, sigma_0, sigma_1, dropout, grazing_cosine, grazing_dropout,
    mixed, mixed_min, mixed_max, range_min, range_max, out,
):  # fmt: skip
    """Turn exact distances float32 (C, R) into measured ones: noise, mixed pixels at edges, losses, the range limits.

    Noise sigma_0 + sigma_1 * r; a beam is lost (NaN) with probability `dropout` plus up to `grazing_dropout` as its cosine
    of incidence falls from `grazing_cosine` to 0; where the distance jumps from the previous column of the same ring by
    `mixed_min` to `mixed_max` metres, it lies anywhere between the two with probability `mixed`. Nearer than `range_min`:
    NaN; farther than `range_max` or nothing hit: inf. `normals`, `uniforms` float32 (C, R) are the chance.
    """
    for c in range(distance.shape[0]):
        for r in range(distance.shape[1]):
            d = distance[c, r]
            if not d <= range_max:
                out[c, r] = np.inf
                continue
            u = uniforms[c, r]
            lost = dropout
            if cosine[c, r] < grazing_cosine:
                lost += grazing_dropout * (1.0 - cosine[c, r] / grazing_cosine)
            if u < lost or d < range_min:
                out[c, r] = np.nan
                continue
            if c > 0 and mixed > 0.0:
                jump = distance[c - 1, r] - d
                if mixed_min < abs(jump) < mixed_max and u - lost < mixed:
                    d += jump * (u - lost) / mixed
            d += (sigma_0 + sigma_1 * d) * normals[c, r]
            out[c, r] = d if d <= range_max else np.inf


@jit
def gather_points(distance, intensity, column_times, directions, out_points, out_intensity, out_time, out_ring):
    """Copy every finite measurement (C, R) to points (M, 3), intensity, time, ring in firing order; returns M."""
    m = 0
    for c in range(distance.shape[0]):
        for r in range(distance.shape[1]):
            d = distance[c, r]
            if math.isfinite(d):
                for j in range(3):
                    out_points[m, j] = d * directions[c, r, j]
                out_intensity[m] = intensity[c, r]
                out_time[m] = column_times[c] - column_times[0]
                out_ring[m] = r
                m += 1
    return m


def warm_up() -> None:
    """Compile or load every kernel with its real argument types."""
    bounds = np.array([[-1.0, -1, -1, 1, 1, 1]])
    firsts, counts = np.zeros(1, np.int32), np.ones(1, np.int32)
    prims = np.array([[0.0, 0, 0, 1, 1, 1, 1, 0, 0, 0, 1, 0, 0, 0, 1]])
    scene = (bounds, firsts, counts, prims, np.zeros(1, np.uint8))
    rays = np.array([[1.0, 0.0, 0.0]])
    cast_rays(*scene, 0.0, 3.0, rays, rays, 10.0, np.empty(1), np.empty(1, np.int32), np.empty(1))
    times, column_times = np.array([0.0, 0.1]), np.zeros(1)
    positions, quaternions = np.zeros((2, 3)), np.array([[1.0, 0, 0, 0], [1.0, 0, 0, 0]])
    directions = rays.reshape(1, 1, 3)
    distance, cosine, intensity, out = (np.zeros((1, 1), np.float32) for _ in range(4))
    sweep(
        *(*scene, np.ones(3), 0.0, 3.0, times, positions, quaternions, column_times, directions, 10.0),
        *(distance, cosine, intensity),
    )
    corrupt_ranges(distance, cosine, out, out, *([0.1] * 8), 0.0, 10.0, out)
    gather_points(
        *(distance, intensity, column_times, directions, np.empty((1, 3), np.float32)),
        *(np.empty(1, np.float32), np.empty(1, np.float32), np.empty(1, np.uint16)),
    )
