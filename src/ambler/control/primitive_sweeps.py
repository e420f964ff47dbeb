"""Which primitives an obstacle blocks, for one robot: sweep tables of its true footprint along the paths, generated once per process.

A base that looks along its path needs one table per size, the same for all directions. One that drives backwards has its footprint the other way
round; one that holds its heading sweeps another area in each direction and needs a table for each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ambler.control.primitive_library import DIRECTIONS, primitive_library
from ambler.kernels.footprint import footprint_corners, footprint_edges
from ambler.kernels.primitives import WORDS, sweep_paths

F64 = NDArray[np.float64]

ANGLES = np.radians(10.0 * np.arange(DIRECTIONS) - 180.0)
"""The directions in which paths may begin, radians in the base frame."""

CELL = 0.025  # metres: half a cell of the local costmap
HOLD_CELL = 0.05  # there are as many of these tables as directions
SPACING = 0.02  # metres that a corner moves between two poses of a sweep


@dataclass(frozen=True, slots=True)
class SweepTable:
    """Bitmaps uint64 (1 or 36, H, W, WORDS) of the paths whose footprints come within half a diagonal of a cell, and so within reach of all
    of it; `slack` is by how much that is too much at most (m)."""

    bitmaps: NDArray[np.uint64]
    origin: F64
    cell: float

    @property
    def slack(self) -> float:
        """Metres beside the footprint at which a point may still count as met."""
        return math.sqrt(2.0) * self.cell


def following_table(footprint: F64, padding: float, scale: float, *, backwards: bool = False) -> SweepTable:
    """Return the table of a base that looks along its path, or the other way; polygon (N, 2), metres."""
    return _table(_key(footprint), padding, scale, backwards, False)


def holding_table(footprint: F64, padding: float, scale: float) -> SweepTable:
    """Return the tables of a base that holds its heading in every one of the directions."""
    return _table(_key(footprint), padding, scale, False, True)


def _key(footprint: F64) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in footprint)


@lru_cache(maxsize=32)
def _table(
    footprint: tuple[tuple[float, float], ...], padding: float, scale: float, backwards: bool, holds: bool
) -> SweepTable:
    library = primitive_library()
    cell = HOLD_CELL if holds else CELL
    normals, offsets = footprint_edges(np.array(footprint), padding + 0.5 * math.sqrt(2.0) * cell)
    radius = float(np.max(np.hypot(*footprint_corners(normals, offsets).T)))
    points = np.ascontiguousarray(library.points * scale)
    low, high = points.min(axis=(0, 1)) - radius, points.max(axis=(0, 1)) + radius
    width, height = np.ceil((high - low) / cell).astype(int)
    bitmaps = np.zeros((DIRECTIONS if holds else 1, height, width, WORDS), np.uint64)
    turned = math.pi if backwards else 0.0
    for d in range(len(bitmaps)):
        headings = np.full_like(library.headings, -ANGLES[d]) if holds else library.headings + turned
        sweep_paths(points, headings, normals, offsets, SPACING, low, cell, bitmaps[d])
    bitmaps.flags.writeable = False
    return SweepTable(bitmaps, low, cell)
