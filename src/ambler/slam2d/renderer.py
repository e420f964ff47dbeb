"""The global map, composed of submaps: finished submaps are added once and again only when optimization has moved one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2, wrap_angle
from ambler.grids.probability import log_odds_table
from ambler.kernels import submap as kernels
from ambler.slam2d.config import RenderConfig
from ambler.slam2d.submaps import Submap

_BLOCK = 5.0
_MOVED_LINEAR = 0.005
_MOVED_ANGULAR = 0.0005


@dataclass(frozen=True, slots=True)
class PlacedSubmap:
    """A submap and where it lies in the map."""

    submap: Submap
    map_from_submap: SE2


@dataclass(slots=True, eq=False)
class _Canvas:
    """What a group of submaps adds up to on the cells [iy, ix] of a grid, and which rows and columns hold something known."""

    spec: GridSpec
    evidence: NDArray[np.float32]
    known: NDArray[np.uint8]
    occupancy: NDArray[np.int8]
    rows: NDArray[np.bool_]
    columns: NDArray[np.bool_]

    @classmethod
    def of(cls, spec: GridSpec) -> _Canvas:
        """Return an empty one."""
        height, width = spec.shape
        return cls(
            *(spec, np.zeros(spec.shape, np.float32), np.zeros(spec.shape, np.uint8)),
            *(np.full(spec.shape, -1, np.int8), np.zeros(height, np.bool_), np.zeros(width, np.bool_)),
        )


_Slices = tuple[slice, slice]


class MapRenderer:
    """Adds log odds of submaps on a lattice that contains the map's origin, and thresholds the sum. What changes costs time, not how large the map is."""

    def __init__(self, config: RenderConfig) -> None:
        self._config = config
        self._log_odds = log_odds_table()
        self._base: dict[int, SE2] = {}
        self._canvas: _Canvas | None = None

    def render(self, placed: list[PlacedSubmap]) -> tuple[GridSpec, NDArray[np.int8]]:
        """Return the map's geometry and occupancy int8 [iy, ix] (-1 unknown, 0 free, 100 occupied), cropped to what is known."""
        canvas = self._with_base([p for p in placed if p.submap.is_finished], self._extent(placed))
        rows, columns, active = canvas.rows.copy(), canvas.columns.copy(), []
        for p in placed:
            if not p.submap.is_finished:
                box = self._box(p, canvas.spec)
                active.append((box, canvas.evidence[box].copy(), canvas.known[box].copy()))
                self._compose(p, canvas)
                _note_known(canvas.known, box, rows, columns)
        box = _known_box(rows, columns, math.ceil(self._config.margin / canvas.spec.resolution))
        occupancy = canvas.occupancy[box].copy()
        for part, _, _ in active:
            self._threshold(canvas, part, box, occupancy)
        for part, evidence, known in reversed(active):  # as it was: of the finished ones
            canvas.evidence[part], canvas.known[part] = evidence, known
        height, width = occupancy.shape
        spec, (y0, x0) = canvas.spec, (box[0].start, box[1].start)
        origin = spec.origin_x + x0 * spec.resolution, spec.origin_y + y0 * spec.resolution
        return GridSpec(spec.resolution, width, height, *origin), occupancy

    def _with_base(self, finished: list[PlacedSubmap], spec: GridSpec) -> _Canvas:
        """Return the canvas of the finished submaps; those that it does not hold yet are added, all of them anew when one has moved."""
        canvas = self._canvas
        if canvas is None or spec != canvas.spec or not self._is_base_of(finished):
            canvas = self._canvas = None  # what it held goes back before there is another
            canvas = self._canvas = _Canvas.of(spec)
            self._base = {}
        changed = []
        for p in finished:
            if p.submap.index not in self._base:
                changed.append(self._box(p, spec))
                self._compose(p, canvas)
                self._base[p.submap.index] = p.map_from_submap
        if changed:
            box = _union(changed)
            self._threshold(canvas, box, np.s_[0 : spec.height, 0 : spec.width], canvas.occupancy)
            _note_known(canvas.known, box, canvas.rows, canvas.columns)
        return canvas

    def _threshold(self, canvas: _Canvas, part: _Slices, within: _Slices, out: NDArray[np.int8]) -> None:
        """Write the occupancy of a part of the canvas into `out`, which holds the cells `within`, as far as these share cells."""
        common = [slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(part, within, strict=True)]
        if any(c.stop <= c.start for c in common):
            return
        rows, columns = common
        config, box = self._config, (rows.start, rows.stop, columns.start, columns.stop)
        corner = within[0].start, within[1].start
        kernels.to_occupancy(canvas.evidence, canvas.known, config.free_below, config.occupied_above, box, corner, out)

    def _compose(self, p: PlacedSubmap, canvas: _Canvas) -> None:
        grid, beside, pose = p.submap.passing_grid(), self._config.beside_occupied, p.map_from_submap.as_array()
        frame = _frame_of(canvas.spec)
        kernels.compose(grid.cells, grid.frame, pose, self._log_odds, beside, frame, canvas.evidence, canvas.known)

    def _box(self, p: PlacedSubmap, spec: GridSpec) -> _Slices:
        """Return the cells of the canvas that a submap may cover."""
        own = p.submap.spec
        pose = p.map_from_submap.as_array()
        y0, y1, x0, x1 = kernels.composed_box(own.shape, _frame_of(own), pose, _frame_of(spec), spec.shape)
        return slice(int(y0), int(y1)), slice(int(x0), int(x1))

    def _is_base_of(self, finished: list[PlacedSubmap]) -> bool:
        now = {p.submap.index: p.map_from_submap for p in finished}
        for index, old in self._base.items():
            new = now.get(index)
            if new is None or old.distance_to(new) > _MOVED_LINEAR:
                return False
            if abs(wrap_angle(old.yaw - new.yaw)) > _MOVED_ANGULAR:
                return False
        return True

    def _extent(self, placed: list[PlacedSubmap]) -> GridSpec:
        """Return a grid over all submaps whose borders lie on multiples of a block, so that it rarely changes."""
        corners = []
        for p in placed:
            own = p.submap.spec
            x0, y0 = own.origin_x, own.origin_y
            x1, y1 = x0 + own.width * own.resolution, y0 + own.height * own.resolution
            box = np.array([[x0, y0], [x1, y0], [x0, y1], [x1, y1]])
            corners.append(p.map_from_submap.transform(box))
        points = np.concatenate(corners) if corners else np.zeros((1, 2))
        low = np.floor(points.min(axis=0) / _BLOCK) * _BLOCK
        size = np.maximum(np.ceil(points.max(axis=0) / _BLOCK) * _BLOCK - low, _BLOCK)
        resolution = self._config.resolution
        return GridSpec(
            resolution,
            math.ceil(size[0] / resolution - 1e-9),
            math.ceil(size[1] / resolution - 1e-9),
            float(low[0]),
            float(low[1]),
        )


def _frame_of(spec: GridSpec) -> NDArray[np.float64]:
    return np.array([spec.resolution, spec.origin_x, spec.origin_y])


def _union(boxes: list[_Slices]) -> _Slices:
    """Return the box around boxes."""
    rows, columns = zip(*boxes, strict=True)
    return (
        slice(min(r.start for r in rows), max(r.stop for r in rows)),
        slice(min(c.start for c in columns), max(c.stop for c in columns)),
    )


def _note_known(known: NDArray[np.uint8], box: _Slices, rows: NDArray[np.bool_], columns: NDArray[np.bool_]) -> None:
    """Mark the rows (H,) and columns (W,) in which a box holds something known."""
    part = known[box]
    rows[box[0]] |= part.any(axis=1)
    columns[box[1]] |= part.any(axis=0)


def _known_box(rows: NDArray[np.bool_], columns: NDArray[np.bool_], margin: int) -> _Slices:
    """Return the box of the rows (H,) and columns (W,) that hold something, and a margin; all where none does."""
    out = []
    for marks in (rows, columns):
        marked = np.flatnonzero(marks)
        low, high = (int(marked[0]) - margin, int(marked[-1]) + 1 + margin) if len(marked) else (0, len(marks))
        out.append(slice(max(0, low), min(len(marks), high)))
    return out[0], out[1]
