"""Voxels over a costmap's cells, as evidence: what sensors hit grows, what they see through shrinks.

A column has LEVELS voxels, one bit each of `occupied` uint32 [iy, ix] (some evidence) and `marked` (enough of it); `scores` int8 [iy, ix, level]
hold the evidence. A voxel is looked through when a ray from the sensor to its middle would go on: the measured distances of the four
directions around it, of a depth picture or of a cloud drawn as one, are all beyond it. One ray for each voxel that matters, in place of one for
each element that walks through a hundred empty ones.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit

LEVELS = 32
LETHAL, UNKNOWN = 254, 255
LEAST_NEIGHBOURS = 2  # of eight that must lie near an element's depth: an edge's flying ones have none
NEAR_0, NEAR_1 = 0.05, 0.03  # metres, and share of the distance, within which two elements are one surface


@jit
def points_of_depth(depth, fx, fy, cx, cy, near, far, out):
    """Write the points of a depth picture uint16 (H, W), millimetres, between two distances along the axis to `out` float32 (N, 3), in the camera's
    frame; returns how many. Elements that hang alone between two surfaces are left out."""
    height, width = depth.shape
    count = 0
    for v in range(height):
        for u in range(width):
            z = 0.001 * depth[v, u]
            if z < near or z > far:
                continue
            close, limit = 0, NEAR_0 + NEAR_1 * z
            for dv in range(-1, 2):
                for du in range(-1, 2):
                    y, x = v + dv, u + du
                    if (dv != 0 or du != 0) and 0 <= y < height and 0 <= x < width and depth[y, x] > 0:
                        close += 1 if abs(0.001 * depth[y, x] - z) < limit else 0
            if close < LEAST_NEIGHBOURS:
                continue
            out[count, 0], out[count, 1], out[count, 2] = z * (u - cx) / fx, z * (v - cy) / fy, z
            count += 1
    return count


@jit
def view_of_depth(depth, out):
    """Write a depth picture uint16 (H, W), millimetres, as distances float32 (H, W), metres, 0 where there are none."""
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            out[v, u] = 0.001 * depth[v, u]


@jit
def view_of_cloud(points, step, lowest, out):
    """Draw points float32 (N, 3) of a sensor's frame as a picture of the nearest ranges, float32 (rows, columns), `step` rad apart: rows from the
    elevation `lowest` on, columns all around from -pi; 0 where there is nothing."""
    rows, columns = out.shape
    out[:] = 0.0
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        flat = math.sqrt(x * x + y * y)
        v = int(math.floor((math.atan2(z, flat) - lowest) / step))
        u = int(math.floor((math.atan2(y, x) + math.pi) / step)) % columns
        if 0 <= v < rows:
            r = math.sqrt(flat * flat + z * z)
            if out[v, u] == 0.0 or r < out[v, u]:
                out[v, u] = r


class Voxels(NamedTuple):
    """The evidence of each voxel, int8 [iy, ix, iz], and per column the bits of voxels with any and of those with enough, uint32 [iy, ix]."""

    scores: NDArray[np.int8]
    occupied: NDArray[np.uint32]
    marked: NDArray[np.uint32]


class VoxelPlace(NamedTuple):
    """Where voxels lie: `grid` float64 (3,) is its origin and resolution, `level` a voxel's height, `bottom` the lowest one's foot, metres."""

    grid: NDArray[np.float64]
    level: float
    bottom: float


class Band(NamedTuple):
    """Heights that count: from the floor plus a doubt that grows with the distance (`doubt` + `lean` * distance) to `top` above it. The floor is at
    `ground` float32 [iy, ix] where that is known ((0, 0): nowhere, NaN: not there), else at `floor`."""

    floor: float
    ground: NDArray[np.float32]
    doubt: float
    lean: float
    top: float


class Picture(NamedTuple):
    """What a sensor measured, float32 (rows, columns): distances along its axis with `lens` (fx, fy, cx, cy), or ranges all around (`is_round`) with
    `lens` (step, lowest elevation, 0, 0); used from `near` to `far` metres."""

    distances: NDArray[np.float32]
    is_round: bool
    lens: NDArray[np.float64]
    near: float
    far: float


class Weights(NamedTuple):
    """A look goes through a voxel when it ends `margin` metres and `spread` times the squared distance beyond, and takes 1 off its evidence; a hit adds
    `gain` up to `most`; a voxel is marked from `enough` on."""

    margin: float
    spread: float
    gain: int
    most: int
    enough: int


@jit
def mark_hits(points, times, matrices, step, near, far, place, band, hits):
    """Set the bits of the voxels in `hits` uint32 [iy, ix] that hold points float32 (N, 3) of a sensor's frame; returns the box of cells (y0, y1, x0,
    x1) around them, empty without any.

    The sensor's poses are `matrices` float64 (K, 3, 4), `step` seconds apart from the stamp on; `times` float32 (N,) are those of the points,
    which count from `near` to `far` metres and within the `Band`. `place` is a `VoxelPlace`.
    """
    grid, ground = place.grid, band.ground
    height, width = hits.shape
    y0, y1, x0, x1 = height, 0, width, 0
    last = matrices.shape[0] - 1
    for i in range(points.shape[0]):
        px, py, pz = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        squared = px * px + py * py + pz * pz
        if not (near * near <= squared <= far * far):
            continue
        k = min(max(int(times[i] / step + 0.5), 0), last)
        z = matrices[k, 2, 0] * px + matrices[k, 2, 1] * py + matrices[k, 2, 2] * pz + matrices[k, 2, 3]
        x = matrices[k, 0, 0] * px + matrices[k, 0, 1] * py + matrices[k, 0, 2] * pz + matrices[k, 0, 3]
        y = matrices[k, 1, 0] * px + matrices[k, 1, 1] * py + matrices[k, 1, 2] * pz + matrices[k, 1, 3]
        ix, iy = int(math.floor((x - grid[0]) / grid[2])), int(math.floor((y - grid[1]) / grid[2]))
        if not (0 <= ix < width and 0 <= iy < height):
            continue
        over = z - band.floor
        if ground.shape[0] > 0 and not math.isnan(ground[iy, ix]):
            over = z - ground[iy, ix]
        if over > band.top or over < band.doubt + band.lean * math.sqrt(squared):
            continue
        iz = int(math.floor((z - place.bottom) / place.level))
        if 0 <= iz < LEVELS:
            hits[iy, ix] |= np.uint32(1) << np.uint32(iz)
            y0, y1, x0, x1 = min(y0, iy), max(y1, iy + 1), min(x0, ix), max(x1, ix + 1)
    return y0, y1, x0, x1


@jit
def _is_looked_through(picture, px, py, pz, margin, spread):
    """Whether the four directions of the `Picture` around a point of the sensor's frame all go on beyond it, as far as they measured anything (at least
    two of them)."""
    view, lens = picture.distances, picture.lens
    rows, columns = view.shape
    if picture.is_round:
        flat = math.sqrt(px * px + py * py)
        distance = math.sqrt(flat * flat + pz * pz)
        v = (math.atan2(pz, flat) - lens[1]) / lens[0] - 0.5
        u = (math.atan2(py, px) + math.pi) / lens[0] - 0.5
    else:
        if pz <= 0.0:
            return False
        distance = pz
        u, v = lens[2] + lens[0] * px / pz, lens[3] + lens[1] * py / pz
    v0, u0 = int(math.floor(v)), int(math.floor(u))
    if v0 < 0 or v0 + 1 >= rows or (not picture.is_round and (u0 < 0 or u0 + 1 >= columns)):
        return False
    beyond = distance + margin + spread * distance * distance
    told = 0
    for dv in range(2):
        for du in range(2):
            seen = view[v0 + dv, (u0 + du) % columns]
            if seen > 0.0:
                if seen < beyond:
                    return False
                told += 1
    return told >= 2


@jit
def weigh(voxels, hits, box, picture, matrix, place, weights):
    """Raise the evidence of the voxels in `hits` (which is emptied) and lower that of those looked through, within `box` (y0, y1, x0, x1).

    `matrix` float64 (3, 4) is the pose of the sensor that took the `Picture`; `place` is a `VoxelPlace`, `weights` are `Weights`.
    """
    scores, occupied, marked = voxels
    grid, near, far = place.grid, picture.near, picture.far
    for iy in range(box[0], box[1]):
        for ix in range(box[2], box[3]):
            hit = hits[iy, ix]
            both = occupied[iy, ix] | hit
            if both == 0:
                continue
            hits[iy, ix] = np.uint32(0)
            dx = grid[0] + (ix + 0.5) * grid[2] - matrix[0, 3]
            dy = grid[1] + (iy + 0.5) * grid[2] - matrix[1, 3]
            some, sure = np.uint32(0), np.uint32(0)
            for iz in range(LEVELS):
                bit = np.uint32(1) << np.uint32(iz)
                if both & bit == 0:
                    continue
                score = int(scores[iy, ix, iz])
                if hit & bit:
                    score = min(score + weights.gain, weights.most)
                else:
                    dz = place.bottom + (iz + 0.5) * place.level - matrix[2, 3]
                    squared = dx * dx + dy * dy + dz * dz
                    if near * near <= squared <= far * far:
                        px = matrix[0, 0] * dx + matrix[1, 0] * dy + matrix[2, 0] * dz
                        py = matrix[0, 1] * dx + matrix[1, 1] * dy + matrix[2, 1] * dz
                        pz = matrix[0, 2] * dx + matrix[1, 2] * dy + matrix[2, 2] * dz
                        if _is_looked_through(picture, px, py, pz, weights.margin, weights.spread):
                            score -= 1
                scores[iy, ix, iz] = score
                if score > 0:
                    some |= bit
                if score >= weights.enough:
                    sure |= bit
            occupied[iy, ix], marked[iy, ix] = some, sure


@jit
def empty_polygon(voxels, place, corners):
    """Forget the columns whose middles lie in a convex, counter-clockwise polygon float64 (N, 2); `place` float64 (3,) is the grid's origin and
    resolution."""
    scores, occupied, marked = voxels
    height, width = occupied.shape
    n = corners.shape[0]
    x0, x1, y0, y1 = corners[0, 0], corners[0, 0], corners[0, 1], corners[0, 1]
    for k in range(1, n):
        x0, x1 = min(x0, corners[k, 0]), max(x1, corners[k, 0])
        y0, y1 = min(y0, corners[k, 1]), max(y1, corners[k, 1])
    for iy in range(max(0, int((y0 - place[1]) / place[2])), min(height, int((y1 - place[1]) / place[2]) + 1)):
        for ix in range(max(0, int((x0 - place[0]) / place[2])), min(width, int((x1 - place[0]) / place[2]) + 1)):
            if occupied[iy, ix] == 0:
                continue
            x, y = place[0] + (ix + 0.5) * place[2], place[1] + (iy + 0.5) * place[2]
            is_in = True
            for k in range(n):
                j = (k + 1) % n
                ax, ay = corners[k, 0], corners[k, 1]
                is_in = is_in and (corners[j, 0] - ax) * (y - ay) - (corners[j, 1] - ay) * (x - ax) >= 0.0
            if is_in:
                occupied[iy, ix] = marked[iy, ix] = np.uint32(0)
                for iz in range(LEVELS):
                    scores[iy, ix, iz] = 0


def warm_up() -> None:
    """Compile or load every kernel with its real argument types."""
    depth, view = np.ones((3, 3), np.uint16), np.zeros((3, 3), np.float32)
    points, times = np.zeros((2, 3), np.float32), np.zeros(2, np.float32)
    matrices, place = np.zeros((1, 3, 4)), np.array([0.0, 0.0, 0.05])
    bits = [np.zeros((2, 2), np.uint32) for _ in range(3)]
    voxels, there = Voxels(np.zeros((2, 2, LEVELS), np.int8), bits[0], bits[1]), VoxelPlace(place, 0.05, 0.0)
    points_of_depth(depth, 1.0, 1.0, 1.0, 1.0, 0.3, 4.0, points)
    view_of_depth(depth, view)
    view_of_cloud(points, 0.03, -1.0, view)
    ground = np.zeros((2, 2), np.float32)
    mark_hits(points, times, matrices, 1.0, 0.3, 4.0, there, Band(0.0, ground, 0.05, 0.05, 1.0), bits[0])
    for is_round in (False, True):
        picture = Picture(view, is_round, np.ones(4), 0.3, 4.0)
        weigh(voxels, bits[2], (0, 2, 0, 2), picture, matrices[0], there, Weights(0.05, 0.01, 2, 6, 3))
    empty_polygon(voxels, place, np.zeros((3, 2)))
