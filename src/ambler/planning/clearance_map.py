"""What is known of one floor: cells that are free, forbidden for the robot's centre or unknown, and their clearance, kept up to date tile by tile.

`update` compares new cells with the last ones, computes the clearance anew only around what differs, and says where that was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.kernels.distance_transform import LETHAL, inflate

U8 = NDArray[np.uint8]
Box = tuple[int, int, int, int]

UNKNOWN, FREE, FORBIDDEN = 0, 1, 2
CAP = 15  # cells: clearances beyond are not told apart
TILE = 32  # cells
_TABLE = 255 - np.minimum(255, np.floor(16.0 * np.sqrt(np.arange(CAP * CAP + 2)))).astype(np.uint8)
_TABLE[-1] = 0


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Where a floor changed: `boxes` (y0, y1, x0, x1) around cells that became forbidden or stopped being so, `dirty` uint8 tiles in which
    sight or knowledge may differ now, `freed` uint8 tiles where something was forbidden and is not any more. Tiles beside them count too."""

    boxes: tuple[Box, ...]
    dirty: U8
    freed: U8

    @property
    def is_empty(self) -> bool:
        """Whether nothing changed."""
        return not self.dirty.any()


class ClearanceMap:
    """`spec`, `cells` uint8 [iy, ix] of UNKNOWN, FREE, FORBIDDEN, `known` uint8 and `field` uint8 (clearance in sixteenths of a cell)."""

    def __init__(self) -> None:
        self.spec: GridSpec | None = None
        self.cells: U8 = np.zeros((0, 0), np.uint8)
        self.known: U8 = np.zeros((0, 0), np.uint8)
        self.field: U8 = np.zeros((0, 0), np.uint8)
        self._obstacles: U8 = np.zeros((0, 0), np.uint8)

    def update(self, spec: GridSpec, cells: U8) -> Changes:
        """Take new cells of the whole grid; it may have grown, or have another resolution, which starts afresh."""
        before = self._on_grid(spec)
        self.spec, self.cells = spec, cells
        was, now = before == FORBIDDEN, cells == FORBIDDEN
        differs = was != now
        forbidding = _tiles(differs)
        freed = _tiles(was & ~now)
        dirty = forbidding | _tiles((before == UNKNOWN) != (cells == UNKNOWN))
        self.known = np.ascontiguousarray(cells != UNKNOWN).view(np.uint8)
        boxes = tuple(_tight(differs, box) for box in _boxes(forbidding))
        self._obstacles = np.where(now, LETHAL, 0).astype(np.uint8)
        for y0, y1, x0, x1 in boxes:
            self._measure(max(0, y0 - CAP), min(spec.height, y1 + CAP), max(0, x0 - CAP), min(spec.width, x1 + CAP))
        return Changes(boxes, _widened(dirty), _widened(freed))

    def _measure(self, y0: int, y1: int, x0: int, x1: int) -> None:
        """Compute the clearance in a box."""
        inflated = self.field
        np.subtract(255, inflated[y0:y1, x0:x1], out=inflated[y0:y1, x0:x1])
        inflate(self._obstacles, y0, y1, x0, x1, CAP, _TABLE, inflated)
        np.subtract(255, inflated[y0:y1, x0:x1], out=inflated[y0:y1, x0:x1])

    def _on_grid(self, spec: GridSpec) -> U8:
        """Return the last cells on a new grid, unknown where they did not reach; what is kept is moved with them."""
        old = self.spec
        if old == spec:
            return self.cells
        cells, field = np.full(spec.shape, UNKNOWN, np.uint8), np.full(spec.shape, 255, np.uint8)
        if old is not None and old.resolution == spec.resolution and _is_aligned(old, spec):
            dy, dx = old.offset_in(spec)
            y0, y1 = max(0, dy), min(spec.height, dy + old.height)
            x0, x1 = max(0, dx), min(spec.width, dx + old.width)
            if y1 > y0 and x1 > x0:
                part = (slice(y0 - dy, y1 - dy), slice(x0 - dx, x1 - dx))
                cells[y0:y1, x0:x1], field[y0:y1, x0:x1] = self.cells[part], self.field[part]
                lost = (old.height * old.width) - (y1 - y0) * (x1 - x0)
                if lost and (self.cells == FORBIDDEN).any():  # what lay outside no longer counts for the clearance inside
                    cells[:], field[:] = UNKNOWN, 255
        self.field = field
        return cells


def _is_aligned(a: GridSpec, b: GridSpec) -> bool:
    dy, dx = (a.origin_y - b.origin_y) / a.resolution, (a.origin_x - b.origin_x) / a.resolution
    return abs(dy - round(dy)) < 1e-3 and abs(dx - round(dx)) < 1e-3


def _tiles(mask: NDArray[np.bool_]) -> U8:
    """Return which tiles hold a marked cell, uint8."""
    height, width = mask.shape
    rows = np.arange(0, height, TILE)
    columns = np.arange(0, width, TILE)
    if height == 0 or width == 0:
        return np.zeros((0, 0), np.uint8)
    return np.logical_or.reduceat(np.logical_or.reduceat(mask, rows, 0), columns, 1).astype(np.uint8)


def _widened(tiles: U8) -> U8:
    """Mark the eight neighbours of marked tiles, too."""
    padded = np.pad(tiles, 1)
    out = tiles.copy()
    height, width = tiles.shape
    for dy in range(3):
        for dx in range(3):
            out |= padded[dy : dy + height, dx : dx + width]
    return out


def _boxes(tiles: U8) -> list[Box]:
    """Return boxes of tiles (y0, y1, x0, x1) around connected groups of marked ones."""
    left = {(int(y), int(x)) for y, x in np.argwhere(tiles)}
    if len(left) * 2 > tiles.size:
        return [(0, tiles.shape[0], 0, tiles.shape[1])]
    boxes = []
    while left:
        queue = [min(left)]
        left.discard(queue[0])
        group = []
        while queue:
            y, x = queue.pop()
            group.append((y, x))
            for ny in range(y - 1, y + 2):
                for nx in range(x - 1, x + 2):
                    if (ny, nx) in left:
                        left.discard((ny, nx))
                        queue.append((ny, nx))
        ys, xs = [y for y, _ in group], [x for _, x in group]
        boxes.append((min(ys), max(ys) + 1, min(xs), max(xs) + 1))
    return boxes


def _tight(mask: NDArray[np.bool_], tiles: Box) -> Box:
    """Return the box of the marked cells within a box of tiles."""
    y0, x0 = tiles[0] * TILE, tiles[2] * TILE
    part = mask[y0 : tiles[1] * TILE, x0 : tiles[3] * TILE]
    rows, columns = np.flatnonzero(part.any(axis=1)), np.flatnonzero(part.any(axis=0))
    return y0 + int(rows[0]), y0 + int(rows[-1]) + 1, x0 + int(columns[0]), x0 + int(columns[-1]) + 1
