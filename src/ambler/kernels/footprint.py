"""Filled, convex footprints against points and against lethal cells.

A footprint is given by its edges: outward unit normals float64 (E, 2) and offsets float64 (E,), so that `n . p - d` is the
signed distance of a point from an edge's line (negative inside). The largest one over all edges is the exact distance inside
and a lower bound outside. No function looks at the outline alone, so nothing inside a footprint can be overlooked.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ambler.kernels.jit import jit, read_only


class Outline(NamedTuple):
    """A footprint: its edges, and circles float64 (M, 3) of (x, y, r) that cover it."""

    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]
    circles: NDArray[np.float64]


class LethalCells(NamedTuple):
    """The lethal cells of a grid, by `lethal_row_sums` and `lethal_distance`; `resolution` in metres."""

    row_sums: NDArray[np.int32]
    distance: NDArray[np.float64]
    resolution: float


def footprint_edges(polygon: NDArray[np.float64], padding: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the edges (normals (E, 2), offsets (E,)) of a convex counter-clockwise polygon (N, 2), moved outwards by `padding`.

    Vertices on a straight line are dropped, so that neighbouring edges always cross. Raises ValueError for anything else.
    """
    edge = np.roll(polygon, -1, axis=0) - polygon
    edge = edge[np.hypot(edge[:, 0], edge[:, 1]) > 1e-9]
    direction = edge / np.hypot(edge[:, 0], edge[:, 1])[:, None]
    before = np.roll(direction, 1, axis=0)
    turn = before[:, 0] * direction[:, 1] - before[:, 1] * direction[:, 0]
    direction = direction[turn > 1e-6]
    if np.any(turn < -1e-6) or len(direction) < 3:
        raise ValueError("a footprint must be a convex polygon, counter-clockwise, with an area")
    normals = np.ascontiguousarray(np.stack((direction[:, 1], -direction[:, 0]), axis=1))
    offsets = np.max(polygon @ normals.T, axis=0) + padding
    return normals, np.ascontiguousarray(offsets)


def footprint_corners(normals: NDArray[np.float64], offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners (E, 2) in which neighbouring edges meet; the inverse of `footprint_edges`."""
    after, limits = np.roll(normals, -1, axis=0), np.roll(offsets, -1)
    det = normals[:, 0] * after[:, 1] - normals[:, 1] * after[:, 0]
    x = (offsets * after[:, 1] - limits * normals[:, 1]) / det
    y = (normals[:, 0] * limits - after[:, 0] * offsets) / det
    return np.stack((x, y), axis=1)


@jit
def edge_clearance(x, y, normals, offsets):
    """Return the signed clearance of one point of the footprint's frame, metres."""
    best = -1e30
    for e in range(normals.shape[0]):
        d = normals[e, 0] * x + normals[e, 1] * y - offsets[e]
        best = max(best, d)
    return best


@jit
def lethal_row_sums(costs, lethal, out):
    """Write int32 (H, W + 1): how many cells of a row left of column ix hold exactly the value `lethal`."""
    for iy in range(costs.shape[0]):
        total = 0
        out[iy, 0] = 0
        for ix in range(costs.shape[1]):
            if costs[iy, ix] == lethal:
                total += 1
            out[iy, ix + 1] = total


@jit
def lethal_distance(row_sums, resolution, out):
    """Write float64 (H, W): the exact distance from each cell's centre to the nearest lethal cell's centre, metres.

    Column distances first, then the lower envelope of parabolas along each row (Felzenszwalb and Huttenlocher, 2012).
    """
    height, width = out.shape
    far = 1e12
    for iy in range(height):
        for ix in range(width):
            above = out[iy - 1, ix] + 1.0 if iy > 0 else far + 1.0
            out[iy, ix] = 0.0 if row_sums[iy, ix + 1] > row_sums[iy, ix] else above
    for iy in range(height - 2, -1, -1):
        for ix in range(width):
            out[iy, ix] = min(out[iy, ix], out[iy + 1, ix] + 1.0)
    site = np.empty(width, np.int64)
    bound = np.empty(width + 1, np.float64)
    squared = np.empty(width, np.float64)
    for iy in range(height):
        count = 0
        for ix in range(width):
            g = out[iy, ix]
            squared[ix] = g * g
            if g >= far:
                continue
            start = -1e30
            while count > 0:
                q = site[count - 1]
                start = (squared[ix] + ix * ix - squared[q] - q * q) / (2.0 * (ix - q))
                if start > bound[count - 1]:
                    break
                count -= 1
            site[count] = ix
            bound[count] = start if count > 0 else -1e30
            count += 1
        k = 0
        for ix in range(width):
            if count == 0:
                out[iy, ix] = 1e6
                continue
            while k + 1 < count and bound[k + 1] < ix:
                k += 1
            d = float(ix - site[k])
            out[iy, ix] = resolution * math.sqrt(d * d + squared[site[k]])


@jit
def lethal_cells_inside(row_sums, resolution, gx, gy, cos, sin, normals, offsets):
    """Count the lethal cells whose centres lie inside the filled footprint at (gx, gy) metres from the grid's origin.

    Each grid row cuts the convex footprint in one interval; the row sums answer it in constant time. Cells outside the grid
    count as free.
    """
    height, width = row_sums.shape[0], row_sums.shape[1] - 1
    x_low, x_high, y_low, y_high = 1e30, -1e30, 1e30, -1e30
    edges = normals.shape[0]
    for e in range(edges):
        f = (e + 1) % edges
        det = normals[e, 0] * normals[f, 1] - normals[e, 1] * normals[f, 0]
        vx = (offsets[e] * normals[f, 1] - offsets[f] * normals[e, 1]) / det
        vy = (normals[e, 0] * offsets[f] - normals[f, 0] * offsets[e]) / det
        x, y = gx + cos * vx - sin * vy, gy + sin * vx + cos * vy
        x_low, x_high, y_low, y_high = min(x_low, x), max(x_high, x), min(y_low, y), max(y_high, y)
    first = max(0, int(math.ceil(y_low / resolution - 0.5)))
    last = min(height - 1, int(math.floor(y_high / resolution - 0.5)))
    left = min(max(0, int(x_low / resolution - 1.0)), width)
    right = max(min(width, int(x_high / resolution + 2.0)), left)
    total = 0
    for iy in range(first, last + 1):
        if row_sums[iy, right] == row_sums[iy, left]:
            continue  # nothing lethal between the outermost corners
        dy = (iy + 0.5) * resolution - gy
        low, high = -1e30, 1e30
        for e in range(edges):
            nx = cos * normals[e, 0] - sin * normals[e, 1]
            ny = sin * normals[e, 0] + cos * normals[e, 1]
            rest = offsets[e] - ny * dy
            if abs(nx) < 1e-12:
                if rest < 0.0:
                    high = -1e30
            elif nx > 0.0:
                high = min(high, rest / nx)
            else:
                low = max(low, rest / nx)
        if low <= high:
            a = max(0, int(math.ceil((gx + low) / resolution - 0.5)))
            b = min(width - 1, int(math.floor((gx + high) / resolution - 0.5)))
            if a <= b:
                total += row_sums[iy, b + 1] - row_sums[iy, a]
    return total


def warm_up() -> None:
    """Compile every kernel of this module."""
    normals = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    offsets = np.ones(4)
    edge_clearance(0.0, 0.0, normals, offsets)
    sums = np.zeros((3, 4), np.int32)
    lethal_row_sums(np.zeros((3, 3), np.uint8), 254, sums)
    lethal_row_sums(read_only(np.zeros((3, 3), np.uint8)), 254, sums)
    lethal_distance(sums, 0.05, np.empty((3, 3)))
    lethal_cells_inside(sums, 0.05, 0.1, 0.1, 1.0, 0.0, normals, offsets)
