"""Level cuts of meshes and terrain for the true map: the cells that a surface crosses, and what lies inside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.sim.meshes import HeightField, TriangleMesh

F64 = NDArray[np.float64]


def slice_mesh(corners: F64, height: float) -> F64:
    """Return where triangles (M, 3, 3) cross z = `height`, segments float64 (K, 2 ends, 2), the outside on their right.

    A corner at that very height counts as above it, so that the segments of a closed surface form closed loops.
    """
    above = corners[:, :, 2] >= height
    crossing = corners[above.any(axis=1) & ~above.all(axis=1)]
    above = crossing[:, :, 2] >= height
    alone = np.where(above.sum(axis=1) == 1, np.argmax(above, axis=1), np.argmin(above, axis=1))
    rows = np.arange(len(crossing))
    tip, after, before = (crossing[rows, (alone + k) % 3] for k in range(3))
    ends = [tip + ((height - tip[:, 2]) / (o[:, 2] - tip[:, 2]))[:, None] * (o - tip) for o in (after, before)]
    segments = np.stack(ends, axis=1)[:, :, :2].reshape(-1, 2, 2)
    is_tip_up = crossing[rows, alone, 2] >= height
    return np.where(is_tip_up[:, None, None], segments, segments[:, ::-1])


def draw_mesh(mesh: TriangleMesh, height: float, spec: GridSpec, samples: int, out: NDArray[np.bool_]) -> None:
    """Mark the cells of `out` bool [iy, ix] that a mesh's surface crosses at a height; of a closed mesh also those with any of
    `samples` x `samples` points inside."""
    segments = slice_mesh(mesh.corners, height)
    if len(segments) == 0:
        return
    for a, b in segments:
        _draw_segment(a, b, spec, out)
    if mesh.is_closed:
        _fill(segments, spec, samples, out)


def draw_terrain(terrain: HeightField, height: float, spec: GridSpec, samples: int, out: NDArray[np.bool_]) -> None:
    """Mark the cells of `out` bool [iy, ix] with any of `samples` x `samples` points where the ground is not lower than `height`."""
    low, high = spec.cells_of(np.stack([terrain.outline.min(axis=0), terrain.outline.max(axis=0)]))
    columns = np.arange(low[1], high[1] + 1)
    x = _sample_places(columns, spec.origin_x, spec.resolution, samples)
    for row in range(low[0], high[0] + 1):
        y = _sample_places(np.array([row]), spec.origin_y, spec.resolution, samples)
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        is_ground = terrain.heights_at(points) >= height
        out[row, columns] |= is_ground.reshape(samples, len(columns), samples).any(axis=(0, 2))


def _sample_places(cells: NDArray[np.int64], origin: float, resolution: float, samples: int) -> F64:
    offsets = (np.arange(samples) + 0.5) / samples
    return np.asarray(origin + (cells[:, None] + offsets).ravel() * resolution)


def _draw_segment(a: F64, b: F64, spec: GridSpec, out: NDArray[np.bool_]) -> None:
    """Mark every cell that a segment runs through: its crossings with the grid's lines cut it into pieces of one cell each."""
    origin = np.array([spec.origin_x, spec.origin_y])
    u, v = (a - origin) / spec.resolution, (b - origin) / spec.resolution
    cuts = [np.array([0.0, 1.0])]
    for j in range(2):
        if u[j] != v[j]:
            lines = np.arange(np.ceil(min(u[j], v[j])), np.floor(max(u[j], v[j])) + 1.0)
            cuts.append((lines - u[j]) / (v[j] - u[j]))
    shares = np.sort(np.concatenate(cuts))
    middles = 0.5 * (shares[1:] + shares[:-1])
    cells = spec.cells_of(a + middles[:, None] * (b - a))
    out[cells[:, 0], cells[:, 1]] = True


def _fill(segments: F64, spec: GridSpec, samples: int, out: NDArray[np.bool_]) -> None:
    """Mark the cells with a sample point around which the loops of segments turn (winding number not 0)."""
    low, high = spec.cells_of(np.stack([segments.min(axis=(0, 1)), segments.max(axis=(0, 1))]))
    columns = np.arange(low[1], high[1] + 1)
    x = _sample_places(columns, spec.origin_x, spec.resolution, samples)
    ya, yb = segments[:, 0, 1], segments[:, 1, 1]
    for row in range(low[0], high[0] + 1):
        for y in _sample_places(np.array([row]), spec.origin_y, spec.resolution, samples):
            met = np.nonzero((ya <= y) != (yb <= y))[0]
            a, b = segments[met, 0], segments[met, 1]
            at = a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
            order = np.argsort(at)
            turns = np.concatenate([[0], np.cumsum(np.where(yb[met] > ya[met], 1, -1)[order])])
            inside = turns[np.searchsorted(at[order], x)] != 0
            out[row, columns] |= inside.reshape(len(columns), samples).any(axis=1)
