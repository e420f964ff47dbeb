"""What is known of one floor: cells that are free, forbidden for the robot's centre or unknown, and their clearance, kept up to date tile by tile.

`update` compares new cells with the last ones, computes the clearance anew only around what differs, and says where that was.
"""

from __future__ import annotations

from collections.abc import Sequence
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


@dataclass(frozen=True, slots=True)
class UnknownPrice:
    """What a metre through unknown cells costs more than one through free ones: `unknown` metres, and `doubt` more where obstacles leave no room for a
    disc of `gap` metres: what hides between a cupboard and its wall is rarely a way on. `wall` metres more within the straight continuation of a wall whose rest is hidden."""

    unknown: float = 0.0
    doubt: float = 0.0
    gap: float = 0.5
    wall: float = 0.0


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
    """`spec`, `cells` uint8 [iy, ix] of UNKNOWN, FREE, FORBIDDEN, `known` uint8, `hidden` uint8 (where a wall is supposed), `field` uint8 (clearance in sixteenths of a cell) and
    `price` uint8 (sixteenths of a metre per metre)."""

    def __init__(self, price: UnknownPrice | None = None) -> None:
        self._price = price or UnknownPrice()
        self._filled: U8 = np.zeros((0, 0), np.uint8)
        self.price: U8 = np.zeros((0, 0), np.uint8)
        self.spec: GridSpec | None = None
        self.cells: U8 = np.zeros((0, 0), np.uint8)
        self.hidden: U8 = np.zeros((0, 0), np.uint8)
        self.known: U8 = np.zeros((0, 0), np.uint8)
        self.field: U8 = np.zeros((0, 0), np.uint8)
        self._obstacles: U8 = np.zeros((0, 0), np.uint8)

    def update(self, spec: GridSpec, cells: U8, hidden: U8 | None = None) -> Changes:
        """Take new cells of the whole grid; it may have grown, or have another resolution, which starts afresh."""
        self.set_grid(spec)
        return self.update_box(cells, (0, spec.height, 0, spec.width), hidden)

    def update_box(self, cells: U8, box: Box, hidden: U8 | None = None) -> Changes:
        """Take new cells (y1 - y0, x1 - x0) of a box (y0, y1, x0, x1) of the grid, and where in it walls are supposed."""
        assert self.spec is not None
        spec, (y0, y1, x0, x1) = self.spec, box
        part = (slice(y0, y1), slice(x0, x1))
        before = self.cells[part]
        was, now = before == FORBIDDEN, cells == FORBIDDEN
        differs, freed = was != now, was & ~now
        other = differs | ((before == UNKNOWN) != (cells == UNKNOWN))
        self.cells[part] = cells
        self.known[part] = cells != UNKNOWN
        self._obstacles[part] = np.where(now, LETHAL, 0)
        if hidden is not None:
            other |= (self.hidden[part] != hidden) & (cells == UNKNOWN)
            self.hidden[part] = hidden
        forbidding = _tiles(differs, box, spec)
        boxes = tuple(_tight(differs, tiles, box) for tiles in _boxes(forbidding))
        for changed in boxes:
            self._measure(*grown(changed, CAP, spec))
        self._set_price(box, boxes)
        return Changes(boxes, _widened(_tiles(other, box, spec)), _widened(_tiles(freed, box, spec)))

    def _set_price(self, box: Box, boxes: Sequence[Box]) -> None:
        """Set the price of unknown cells; where obstacles changed, look anew for what is too narrow for the disc (an opening of what is free)."""
        c, spec = self._price, self.spec
        assert spec is not None
        if max(c.unknown, c.doubt, c.wall) == 0.0:
            return
        reach = min(CAP - 1, round(c.gap / spec.resolution))
        for changed in boxes if c.doubt else ():
            self._fill(grown(changed, CAP + reach, spec), reach)
        for y0, y1, x0, x1 in (box, *(grown(changed, CAP + reach, spec) for changed in boxes)):
            doubt = c.doubt * self._filled[y0:y1, x0:x1] + c.wall * self.hidden[y0:y1, x0:x1]
            price = np.minimum(255, np.round(16.0 * (c.unknown + doubt)))
            self.price[y0:y1, x0:x1] = np.where(self.cells[y0:y1, x0:x1] == UNKNOWN, price, 0)

    def _fill(self, box: Box, reach: int) -> None:
        """Mark the cells of a box that no free disc of `reach` cells holds."""
        assert self.spec is not None
        wide = grown(box, reach, self.spec)
        centres = np.where(self.field[wide[0] : wide[1], wide[2] : wide[3]] > 16 * reach, LETHAL, 0).astype(np.uint8)
        opened = np.empty_like(centres)
        table = np.ones(reach * reach + 2, np.uint8)
        table[-1] = 0
        inflate(centres, 0, centres.shape[0], 0, centres.shape[1], reach, table, opened)
        y0, y1, x0, x1 = box
        rows, columns = slice(y0 - wide[0], y1 - wide[0]), slice(x0 - wide[2], x1 - wide[2])
        self._filled[y0:y1, x0:x1] = opened[rows, columns] == 0

    def _measure(self, y0: int, y1: int, x0: int, x1: int) -> None:
        """Compute the clearance in a box."""
        inflated = self.field
        np.subtract(255, inflated[y0:y1, x0:x1], out=inflated[y0:y1, x0:x1])
        inflate(self._obstacles, y0, y1, x0, x1, CAP, _TABLE, inflated)
        np.subtract(255, inflated[y0:y1, x0:x1], out=inflated[y0:y1, x0:x1])

    def set_grid(self, spec: GridSpec) -> None:
        """Lay what is known on another grid: unknown where it did not reach. Another resolution, or one that leaves out what was known, starts
        afresh."""
        old = self.spec
        if old == spec:
            return
        names = {"cells": UNKNOWN, "known": 0, "field": 255, "price": 0, "hidden": 0, "_obstacles": 0, "_filled": 0}
        new = {name: np.full(spec.shape, value, np.uint8) for name, value in names.items()}
        new["price"][:] = min(255, round(16.0 * self._price.unknown))
        if old is not None and old.resolution == spec.resolution and _is_aligned(old, spec):
            dy, dx = old.offset_in(spec)
            if dy >= 0 and dx >= 0 and dy + old.height <= spec.height and dx + old.width <= spec.width:
                part = (slice(dy, dy + old.height), slice(dx, dx + old.width))
                for name, array in new.items():
                    array[part] = getattr(self, name)
        for name, array in new.items():
            setattr(self, name, array)
        self.spec = spec


def _is_aligned(a: GridSpec, b: GridSpec) -> bool:
    dy, dx = (a.origin_y - b.origin_y) / a.resolution, (a.origin_x - b.origin_x) / a.resolution
    return abs(dy - round(dy)) < 1e-3 and abs(dx - round(dx)) < 1e-3


def _tiles(mask: NDArray[np.bool_], box: Box, spec: GridSpec) -> U8:
    """Return which tiles of a grid hold a marked cell of a box of it, uint8."""
    out = np.zeros((-(-spec.height // TILE), -(-spec.width // TILE)), np.uint8)
    rows, columns = np.nonzero(mask)
    out[(rows + box[0]) // TILE, (columns + box[2]) // TILE] = 1
    return out


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


def grown(box: Box, by: int, spec: GridSpec) -> Box:
    """Return a box with `by` cells more on each side, within the grid."""
    y0, y1, x0, x1 = box
    return max(0, y0 - by), min(spec.height, y1 + by), max(0, x0 - by), min(spec.width, x1 + by)


def _tight(mask: NDArray[np.bool_], tiles: Box, box: Box) -> Box:
    """Return the box of the marked cells within a box of tiles; `mask` is of the box of cells."""
    y0, x0 = max(0, tiles[0] * TILE - box[0]), max(0, tiles[2] * TILE - box[2])
    part = mask[y0 : tiles[1] * TILE - box[0], x0 : tiles[3] * TILE - box[2]]
    rows, columns = np.flatnonzero(part.any(axis=1)), np.flatnonzero(part.any(axis=0))
    y0, x0 = y0 + box[0], x0 + box[2]
    return y0 + int(rows[0]), y0 + int(rows[-1]) + 1, x0 + int(columns[0]), x0 + int(columns[-1]) + 1
