"""Rays against oriented boxes, cylinders and triangles in a bounding volume hierarchy, for the simulator's sensors only.

A primitive is a row of `prims` float64 (P, 15): centre (3), half extents (3), rotation world_from_local row by row (9); a
cylinder stands along its local z with radius half[0]. `kinds` uint8 (P,): 0 box, 1 cylinder, 2 glass box, which a ray passes
unless it meets it almost squarely, 3 triangle: corners (9), unit normal (3), three zeros. A node's `bounds` float64 (N, 6)
are (lower, upper); `counts` > 0 marks a leaf with primitives `firsts ... firsts + counts - 1`, else its children are
`firsts` and `firsts + 1`. Floor and ceiling are planes of their own.

Rays travel in packets of 16 neighbours (one column of a 16-ring scanner): a node is opened if any of them enters it, and all
are tested at once (Wald et al. 2001). Slab test after Kay and Kajiya 1986. Triangles have two sides; their test is watertight (Woop, Benthin
and Wald 2013): a ray through an edge or a corner that triangles share meets at least one of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit, jit_ieee

STACK = 64
PACKET = 16
NOTHING = -1
FLOOR = -2
CEILING = -3
GLASS = 2
TRIANGLE = 3
GLASS_COSINE = math.cos(math.radians(12.0))  # beyond this angle a pane sends the light elsewhere
GLASS_DIFFUSE = 0.1  # share of a pane's albedo that dust on it scatters back
SPECULAR = 4.0  # intensity of a pane met squarely; white paint has 1
SPECULAR_SIGMA = math.radians(2.5)  # width of that peak, from the divergence of the beam and the receiver's aperture
TINY = 1e-12
# Rows of a packet float64 (ROWS, PACKET): origin, direction, 1 / direction, nearest distance so far, cosine of incidence, and
# from SHEAR on a matrix row by row, that turns the direction into (0, 0, 1).
OX, OY, OZ, DX, DY, DZ, IX, IY, IZ, BEST, COSINE = range(11)
SHEAR = 11
ROWS = 20


class Solids(NamedTuple):
    """What stands still: the hierarchy, its primitives, and the heights of floor and ceiling. `albedos` are those of the primitives, floor, ceiling and
    of what moves."""

    bounds: NDArray[np.float64]
    firsts: NDArray[np.int32]
    counts: NDArray[np.int32]
    prims: NDArray[np.float64]
    kinds: NDArray[np.uint8]
    albedos: NDArray[np.float64]
    floor: float
    ceiling: float


class MovingSolids(NamedTuple):
    """Primitives (D, 15) outside of the hierarchy, as they are when a scan begins, their kinds (D,), and velocities (D, 2)."""

    prims: NDArray[np.float64]
    kinds: NDArray[np.uint8]
    rates: NDArray[np.float64]


class Track(NamedTuple):
    """Poses of a sensor in the world: `times` (K,), `positions` (K, 3), `quaternions` (K, 4, wxyz), K >= 2."""

    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]


class Returns(NamedTuple):
    """What rays meet, float32 (C, R): exact distance (inf: nothing), cosine of incidence, and intensity (1: white paint met squarely)."""

    distance: NDArray[np.float32]
    cosine: NDArray[np.float32]
    intensity: NDArray[np.float32]


class RangeNoise(NamedTuple):
    """What a scanner makes of exact distances, see `corrupt_ranges`."""

    sigma_0: float
    sigma_1: float
    dropout: float
    grazing_cosine: float
    grazing_dropout: float
    mixed: float
    mixed_min: float
    mixed_max: float
    range_min: float
    range_max: float


@jit_ieee
def _away_from_zero(d):
    return d if abs(d) > TINY else (TINY if d >= 0.0 else -TINY)


@jit_ieee
def _count_entering(bounds, node, packet):
    """How many rays of the packet enter a node's bounds before their nearest hit so far."""
    x0, y0, z0 = bounds[node, 0], bounds[node, 1], bounds[node, 2]
    x1, y1, z1 = bounds[node, 3], bounds[node, 4], bounds[node, 5]
    count = 0
    for r in range(PACKET):
        ax = (x0 - packet[OX, r]) * packet[IX, r]
        bx = (x1 - packet[OX, r]) * packet[IX, r]
        ay = (y0 - packet[OY, r]) * packet[IY, r]
        by = (y1 - packet[OY, r]) * packet[IY, r]
        az = (z0 - packet[OZ, r]) * packet[IZ, r]
        bz = (z1 - packet[OZ, r]) * packet[IZ, r]
        near = max(min(ax, bx), min(ay, by), min(az, bz), 0.0)
        far = min(max(ax, bx), max(ay, by), max(az, bz), packet[BEST, r])
        count += 1 if near <= far else 0
    return count


@jit_ieee
def _hit_box(prims, k, least_cosine, packet, hit):
    """Test all rays of the packet against a box; from inside, a ray hits where it leaves. Flatter rays than `least_cosine` pass."""
    cx, cy, cz, hx, hy, hz = prims[k, 0], prims[k, 1], prims[k, 2], prims[k, 3], prims[k, 4], prims[k, 5]
    r00, r01, r02 = prims[k, 6], prims[k, 7], prims[k, 8]
    r10, r11, r12 = prims[k, 9], prims[k, 10], prims[k, 11]
    r20, r21, r22 = prims[k, 12], prims[k, 13], prims[k, 14]
    for r in range(PACKET):
        rx, ry, rz = packet[OX, r] - cx, packet[OY, r] - cy, packet[OZ, r] - cz
        dx = _away_from_zero(r00 * packet[DX, r] + r10 * packet[DY, r] + r20 * packet[DZ, r])
        dy = _away_from_zero(r01 * packet[DX, r] + r11 * packet[DY, r] + r21 * packet[DZ, r])
        dz = _away_from_zero(r02 * packet[DX, r] + r12 * packet[DY, r] + r22 * packet[DZ, r])
        mx = -(r00 * rx + r10 * ry + r20 * rz) / dx
        my = -(r01 * rx + r11 * ry + r21 * rz) / dy
        mz = -(r02 * rx + r12 * ry + r22 * rz) / dz
        kx, ky, kz = hx / abs(dx), hy / abs(dy), hz / abs(dz)
        near = max(mx - kx, my - ky, mz - kz)
        far = min(mx + kx, my + ky, mz + kz)
        t = near if near >= 0.0 else far
        on_x = (t == mx - kx) | (t == mx + kx)
        on_y = (t == my - ky) | (t == my + ky)
        cosine = abs(dx) if on_x else (abs(dy) if on_y else abs(dz))
        is_hit = (near <= far) & (t >= 0.0) & (t < packet[BEST, r]) & (cosine >= least_cosine)
        packet[BEST, r] = t if is_hit else packet[BEST, r]
        packet[COSINE, r] = cosine if is_hit else packet[COSINE, r]
        hit[r] = k if is_hit else hit[r]


@jit_ieee
def _hit_cylinder(prims, k, packet, hit):
    """Test all rays of the packet against a capped cylinder along its local z."""
    radius, half = prims[k, 3], prims[k, 5]
    for r in range(PACKET):
        rx, ry, rz = packet[OX, r] - prims[k, 0], packet[OY, r] - prims[k, 1], packet[OZ, r] - prims[k, 2]
        px = prims[k, 6] * rx + prims[k, 9] * ry + prims[k, 12] * rz
        py = prims[k, 7] * rx + prims[k, 10] * ry + prims[k, 13] * rz
        pz = prims[k, 8] * rx + prims[k, 11] * ry + prims[k, 14] * rz
        dx = prims[k, 6] * packet[DX, r] + prims[k, 9] * packet[DY, r] + prims[k, 12] * packet[DZ, r]
        dy = prims[k, 7] * packet[DX, r] + prims[k, 10] * packet[DY, r] + prims[k, 13] * packet[DZ, r]
        dz = prims[k, 8] * packet[DX, r] + prims[k, 11] * packet[DY, r] + prims[k, 14] * packet[DZ, r]
        best, cosine = packet[BEST, r], packet[COSINE, r]
        a = dx * dx + dy * dy
        b = px * dx + py * dy
        disc = b * b - a * (px * px + py * py - radius * radius)
        if a > TINY and disc >= 0.0:
            root = math.sqrt(disc)
            t = (-b - root) / a
            if t < 0.0:
                t = (-b + root) / a
            if 0.0 <= t < best and abs(pz + t * dz) <= half:
                best, cosine = t, root / radius
        if abs(dz) > TINY:
            for side in (-half, half):
                t = (side - pz) / dz
                x, y = px + t * dx, py + t * dy
                if 0.0 <= t < best and x * x + y * y <= radius * radius:
                    best, cosine = t, abs(dz)
        if best < packet[BEST, r]:
            packet[BEST, r], packet[COSINE, r] = best, cosine
            hit[r] = k


@jit_ieee
def _shear(packet):
    """Write every ray's matrix: a permutation that makes the longest part of the direction the third, and a shear."""
    for r in range(PACKET):
        ax, ay, az = abs(packet[DX, r]), abs(packet[DY, r]), abs(packet[DZ, r])
        kz = 2 if (az >= ax and az >= ay) else (1 if ay >= ax else 0)
        kx = kz + 1 if kz < 2 else 0
        ky = kx + 1 if kx < 2 else 0
        for j in range(9):
            packet[SHEAR + j, r] = 0.0
        scale = 1.0 / packet[DX + kz, r]
        packet[SHEAR + kx, r] = 1.0
        packet[SHEAR + kz, r] = -packet[DX + kx, r] * scale
        packet[SHEAR + 3 + ky, r] = 1.0
        packet[SHEAR + 3 + kz, r] = -packet[DX + ky, r] * scale
        packet[SHEAR + 6 + kz, r] = scale


@jit_ieee
def _hit_triangle(prims, k, packet, hit):
    """Test all rays of the packet against a triangle, from either side; one that is seen edge-on is not met.

    A corner's place across the ray depends on nothing but corner and ray, and the sign of an edge function is right or 0, so
    two triangles with a common edge never both leave a ray out.
    """
    p = prims[k]
    for r in range(PACKET):
        ox, oy, oz = packet[OX, r], packet[OY, r], packet[OZ, r]
        sx, sy, sz = packet[SHEAR, r], packet[SHEAR + 1, r], packet[SHEAR + 2, r]
        tx, ty, tz = packet[SHEAR + 3, r], packet[SHEAR + 4, r], packet[SHEAR + 5, r]
        ux, uy, uz = packet[SHEAR + 6, r], packet[SHEAR + 7, r], packet[SHEAR + 8, r]
        ax, ay, az = p[0] - ox, p[1] - oy, p[2] - oz
        bx, by, bz = p[3] - ox, p[4] - oy, p[5] - oz
        cx, cy, cz = p[6] - ox, p[7] - oy, p[8] - oz
        x0, y0 = sx * ax + sy * ay + sz * az, tx * ax + ty * ay + tz * az
        x1, y1 = sx * bx + sy * by + sz * bz, tx * bx + ty * by + tz * bz
        x2, y2 = sx * cx + sy * cy + sz * cz, tx * cx + ty * cy + tz * cz
        u, v, w = x2 * y1 - y2 * x1, x0 * y2 - y0 * x2, x1 * y0 - y1 * x0
        det = u + v + w
        z0, z1, z2 = ux * ax + uy * ay + uz * az, ux * bx + uy * by + uz * bz, ux * cx + uy * cy + uz * cz
        t = (u * z0 + v * z1 + w * z2) / det
        is_inside = ((u >= 0.0) & (v >= 0.0) & (w >= 0.0)) | ((u <= 0.0) & (v <= 0.0) & (w <= 0.0))
        is_hit = is_inside & (det != 0.0) & (t >= 0.0) & (t < packet[BEST, r])
        cosine = abs(p[9] * packet[DX, r] + p[10] * packet[DY, r] + p[11] * packet[DZ, r])
        packet[BEST, r] = t if is_hit else packet[BEST, r]
        packet[COSINE, r] = cosine if is_hit else packet[COSINE, r]
        hit[r] = k if is_hit else hit[r]


@jit_ieee
def _hit_planes(floor, ceiling, packet, hit):
    for r in range(PACKET):
        oz, dz = packet[OZ, r], packet[DZ, r]
        plane = floor if dz < 0.0 else ceiling
        t = (plane - oz) * packet[IZ, r]
        if abs(dz) > TINY and floor < oz < ceiling and t < packet[BEST, r]:
            packet[BEST, r], packet[COSINE, r] = t, abs(dz)
            hit[r] = FLOOR if dz < 0.0 else CEILING


@jit_ieee
def _cast_packet(solids, packet, hit, stack):
    """Find the nearest surface of every ray; BEST must hold its reach (negative: no ray). Nearer children go first."""
    bounds, firsts, counts, prims, kinds = solids.bounds, solids.firsts, solids.counts, solids.prims, solids.kinds
    for r in range(PACKET):
        hit[r] = NOTHING
        packet[COSINE, r] = 0.0
        packet[IX, r] = 1.0 / _away_from_zero(packet[DX, r])
        packet[IY, r] = 1.0 / _away_from_zero(packet[DY, r])
        packet[IZ, r] = 1.0 / _away_from_zero(packet[DZ, r])
    _hit_planes(solids.floor, solids.ceiling, packet, hit)
    is_sheared = False
    top = 1
    stack[0] = 0
    while top > 0:
        top -= 1
        node = stack[top]
        if _count_entering(bounds, node, packet) == 0:
            continue
        first = firsts[node]
        if counts[node] > 0:
            for k in range(first, first + counts[node]):
                if kinds[k] == 1:
                    _hit_cylinder(prims, k, packet, hit)
                elif kinds[k] == TRIANGLE:
                    if not is_sheared:
                        _shear(packet)
                        is_sheared = True
                    _hit_triangle(prims, k, packet, hit)
                else:
                    _hit_box(prims, k, GLASS_COSINE if kinds[k] == GLASS else 0.0, packet, hit)
            continue
        along = 0.0
        for j in range(3):
            step = bounds[first, j] + bounds[first, j + 3] - bounds[first + 1, j] - bounds[first + 1, j + 3]
            along += step * packet[DX + j, 0]
        nearer = first if along < 0.0 else first + 1
        stack[top] = 2 * first + 1 - nearer
        stack[top + 1] = nearer
        top += 2


@jit
def cast_rays(solids, origins, directions, reach, out_distance, out_hit, out_cosine):
    """Cast N rays of their own origins (N, 3) and unit directions (N, 3) up to `reach` metres.

    Writes distance float64 (N,) (inf: nothing), the primitive hit int64 (N,) and the cosine of incidence float64 (N,).
    """
    packet, hit, stack = np.empty((ROWS, PACKET)), np.empty(PACKET, np.int64), np.empty(STACK, np.int32)
    n = origins.shape[0]
    for start in range(0, n, PACKET):
        for r in range(PACKET):
            i = min(start + r, n - 1)
            for j in range(3):
                packet[OX + j, r] = origins[i, j]
                packet[DX + j, r] = directions[i, j]
            packet[BEST, r] = reach if start + r < n else -1.0
        _cast_packet(solids, packet, hit, stack)
        for r in range(min(PACKET, n - start)):
            out_distance[start + r] = packet[BEST, r] if hit[r] != NOTHING else np.inf
            out_hit[start + r] = hit[r]
            out_cosine[start + r] = packet[COSINE, r]


@jit
def _pose_at(track, t, start, rotation, origin):
    """Interpolate knots at time t into rotation (3, 3) and origin (3,); returns the knot to start the next search from."""
    times, positions, quaternions = track.times, track.positions, track.quaternions
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


@jit_ieee
def _cast_movers(movers, time, base, moved, packet, mover_hit, hit):
    """Test the packet against primitives that move: where they are `time` seconds after the scan began. Mover d is surface
    `base` + d."""
    for d in range(movers.prims.shape[0]):
        for j in range(15):
            moved[d, j] = movers.prims[d, j]
        moved[d, 0] += movers.rates[d, 0] * time
        moved[d, 1] += movers.rates[d, 1] * time
        for r in range(PACKET):
            mover_hit[r] = NOTHING
        if movers.kinds[d] == 1:
            _hit_cylinder(moved, d, packet, mover_hit)
        else:
            _hit_box(moved, d, 0.0, packet, mover_hit)
        for r in range(PACKET):
            if mover_hit[r] != NOTHING:
                hit[r] = base + d


@jit_ieee
def _returned(kind, albedo, cosine):
    """Intensity of a return: Lambert's cosine law, and of glass a narrow specular peak over little diffuse light."""
    if kind != GLASS:
        return albedo * cosine
    off = math.acos(min(1.0, cosine)) / SPECULAR_SIGMA
    return GLASS_DIFFUSE * albedo * cosine + SPECULAR * math.exp(-0.5 * off * off)


@jit
def sweep(solids, movers, track, column_times, directions, reach, out):
    """Cast the rays of a moving scanner at `Solids` and `MovingSolids`: column c fires its R rays at `column_times[c]` from the sensor's pose on
    the `Track` at that time. `directions` float64 (C, R, 3) are unit vectors in the sensor frame, `out` the `Returns` to be written.
    """
    moved, mover_hit = np.empty((movers.prims.shape[0], 15)), np.empty(PACKET, np.int64)
    packet, hit, stack = np.empty((ROWS, PACKET)), np.empty(PACKET, np.int64), np.empty(STACK, np.int32)
    rotation, origin = np.empty((3, 3)), np.empty(3)
    rings, count = directions.shape[1], solids.prims.shape[0]
    rays = directions.shape[0] * rings
    knot, column = 0, -1
    for start in range(0, rays, PACKET):
        for r in range(PACKET):
            i = min(start + r, rays - 1)
            c = i // rings
            if c != column:
                knot = _pose_at(track, column_times[c], knot, rotation, origin)
                column = c
            ring = i - c * rings
            for j in range(3):
                packet[OX + j, r] = origin[j]
                packet[DX + j, r] = (
                    rotation[j, 0] * directions[c, ring, 0]
                    + rotation[j, 1] * directions[c, ring, 1]
                    + rotation[j, 2] * directions[c, ring, 2]
                )
            packet[BEST, r] = reach if start + r < rays else -1.0
        _cast_packet(solids, packet, hit, stack)
        time = column_times[start // rings]
        _cast_movers(movers, time, count + 2, moved, packet, mover_hit, hit)
        for r in range(min(PACKET, rays - start)):
            c = (start + r) // rings
            ring = start + r - c * rings
            found = hit[r] != NOTHING
            surface = hit[r] if hit[r] >= 0 else count - hit[r] - 2
            out.distance[c, ring] = packet[BEST, r] if found else np.inf
            out.cosine[c, ring] = packet[COSINE, r]
            kind = solids.kinds[hit[r]] if 0 <= hit[r] < count else 0
            out.intensity[c, ring] = _returned(kind, solids.albedos[surface], packet[COSINE, r]) if found else 0.0


@jit
def corrupt_ranges(distance, cosine, normals, uniforms, noise, out):
    """Turn exact distances float32 (C, R) into measured ones: noise, mixed pixels at edges, losses, the range limits.

    `noise` is `RangeNoise`: noise sigma_0 + sigma_1 * r; a beam is lost (NaN) with probability `dropout` plus up to `grazing_dropout` as its cosine
    of incidence falls from `grazing_cosine` to 0; where the distance jumps between two columns of the same ring by `mixed_min` to
    `mixed_max` metres, one of the two beams, with equal chance either, lies anywhere between them with probability `mixed`: a beam is as wide
    to its left as to its right, and edges that were torn on one side only would turn a map. Nearer than `range_min`: NaN; farther than
    `range_max` or nothing hit: inf. `normals`, `uniforms` float32 (C, R) are the chance.
    """
    for c in range(distance.shape[0]):
        for r in range(distance.shape[1]):
            d = distance[c, r]
            if not d <= noise.range_max:
                out[c, r] = np.inf
                continue
            u = uniforms[c, r]
            lost = noise.dropout
            if cosine[c, r] < noise.grazing_cosine:
                lost += noise.grazing_dropout * (1.0 - cosine[c, r] / noise.grazing_cosine)
            if u < lost or d < noise.range_min:
                out[c, r] = np.nan
                continue
            if u - lost < noise.mixed:
                share = 2.0 * (u - lost) / noise.mixed
                beside = c - 1 if share < 1.0 else c + 1
                jump = distance[beside, r] - d if 0 <= beside < distance.shape[0] else 0.0
                if noise.mixed_min < abs(jump) < noise.mixed_max:
                    d += jump * (share % 1.0)
            d += (noise.sigma_0 + noise.sigma_1 * d) * normals[c, r]
            out[c, r] = d if d <= noise.range_max else np.inf


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
    kinds = np.zeros(1, np.uint8)
    solids = Solids(bounds, firsts, counts, prims, kinds, np.ones(4), 0.0, 3.0)
    rays = np.array([[1.0, 0.0, 0.0]])
    cast_rays(solids, rays, rays, 10.0, np.empty(1), np.empty(1, np.int64), np.empty(1))
    track = Track(np.array([0.0, 0.1]), np.zeros((2, 3)), np.array([[1.0, 0, 0, 0], [1.0, 0, 0, 0]]))
    column_times = np.zeros(1)
    directions = rays.reshape(1, 1, 3)
    distance, cosine, intensity, out = (np.zeros((1, 1), np.float32) for _ in range(4))
    movers = MovingSolids(prims, kinds, np.zeros((1, 2)))
    sweep(solids, movers, track, column_times, directions, 10.0, Returns(distance, cosine, intensity))
    corrupt_ranges(distance, cosine, out, out, RangeNoise(*[0.1] * 8, 0.0, 10.0), out)
    gather_points(
        *(distance, intensity, column_times, directions, np.empty((1, 3), np.float32)),
        *(np.empty(1, np.float32), np.empty(1, np.float32), np.empty(1, np.uint16)),
    )
