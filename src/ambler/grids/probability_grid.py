"""A probability grid that grows as scans reach beyond its border."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import zstandard
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.grids.probability import update_table
from ambler.kernels import submap as kernels

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
NOTHING = np.empty((0, 2), np.float32)


@dataclass(frozen=True, slots=True)
class InsertionConfig:
    """Probabilities of an observed return and of an observed free cell. Rays of a cloud that pass higher than `low` (m above the floor) over a
    cell do not make it free once something was seen there."""

    resolution: float = 0.05
    p_hit: float = 0.55
    p_miss: float = 0.49
    initial_size: float = 20.0
    low: float = 0.25  # seats, sofas and beds are 0.4 m high; what is lower is rare, and the lowest ring of a VLP-16 is so low from 2 m on


class Inserter:
    """Holds the update tables and scratch memory of scan insertion; one serves many grids."""

    def __init__(self, config: InsertionConfig) -> None:
        self.config = config
        self._tables = {1: (update_table(config.p_hit), update_table(config.p_miss))}
        self._touched = np.empty(0, np.int64)

    def insert(
        self,
        grid: ProbabilityGrid,
        origin: NDArray[np.float64],
        points: F32,
        free_points: F32,
        free_origin: NDArray[np.float64] | None = None,
        surfaces: F32 = NOTHING,
        sure: int = 0,
        times: int = 1,
        lows: tuple[F64, F64] | None = None,
    ) -> int:
        """Insert a scan: points (N, 2) and free ends (M, 2) float32, all in the grid's frame. `origin` (2,) is where all rays start, or (N, 2)
        where the ray of each point does; `free_origin` (M, 2) likewise for the free ends (None: `origin`). No ray of the scan makes the cells of `surfaces` (K, 2) free; the first
        `sure` of them are occupied as well where nothing is known yet. The scan counts as if it came `times` times. `lows` (N,) and (M,) are the metres up
        to which rays pass above `low` (None: nowhere).

        Returns how many cells changed.
        """
        starts = np.ascontiguousarray(np.atleast_2d(origin))
        free_starts = starts if free_origin is None else np.ascontiguousarray(np.atleast_2d(free_origin))
        grid.grow_to(starts, free_starts, points, free_points)
        if len(self._touched) < grid.cells.size:
            self._touched = np.empty(grid.cells.size, np.int64)
        hit_lows, free_lows = (np.zeros(0), np.zeros(0)) if lows is None else lows
        return int(
            kernels.insert_scan(
                *(grid.cells, starts, free_starts, points, free_points, surfaces, sure),
                *(hit_lows, free_lows, grid.frame, *self._tables_for(times), self._touched),
            )
        )

    def _tables_for(self, times: int) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
        if times not in self._tables:
            config = self.config
            self._tables[times] = (
                update_table(_repeated(config.p_hit, times)),
                update_table(_repeated(config.p_miss, times)),
            )
        return self._tables[times]


def _repeated(probability: float, times: int) -> float:
    """Return the probability that several observations with the same odds come to."""
    odds = (probability / (1.0 - probability)) ** times
    return odds / (1.0 + odds)


class ProbabilityGrid:
    """Cells uint16 [iy, ix] (see `grids.probability`) and where they lie; the lattice contains the frame's origin."""

    def __init__(self, resolution: float, center: tuple[float, float], size: float) -> None:
        n = max(8, math.ceil(size / resolution))
        corner = [(math.floor(c / resolution) - n // 2) * resolution for c in center]
        self.cells = np.zeros((n, n), np.uint16)
        self.frame = np.array([resolution, corner[0], corner[1]])

    @classmethod
    def of(cls, cells: NDArray[np.uint16], frame: F64) -> ProbabilityGrid:
        """Return a grid of these cells, whose `frame` is (resolution, x, y) of its corner."""
        grid = cls(float(frame[0]), (0.0, 0.0), 0.0)
        grid.cells, grid.frame = cells, frame
        return grid

    @property
    def spec(self) -> GridSpec:
        """The geometry in the grid's own frame."""
        return _spec(self.cells.shape, self.frame)

    def grow_to(self, *point_sets: NDArray[np.floating]) -> None:
        """Enlarge the grid, by a quarter of its size at least, until it contains all points (N, 2) with a margin."""
        low = np.array([np.inf, np.inf])
        high = -low
        for points in point_sets:
            if len(points):
                # One by one: along the first axis of such an array NumPy takes five times as long.
                x, y = points[:, 0], points[:, 1]
                low, high = np.minimum(low, (x.min(), y.min())), np.maximum(high, (x.max(), y.max()))
        if not np.isfinite(low).all():
            return
        resolution, (h, w) = float(self.frame[0]), self.cells.shape
        first = np.floor((low - self.frame[1:]) / resolution).astype(int) - 4
        last = np.floor((high - self.frame[1:]) / resolution).astype(int) + 4
        left, down = (max(0, -int(f)) for f in first)
        right, up = max(0, int(last[0]) - w + 1), max(0, int(last[1]) - h + 1)
        if not (left or down or right or up):
            return
        left, right = (max(k, w // 4) if k else 0 for k in (left, right))
        down, up = (max(k, h // 4) if k else 0 for k in (down, up))
        self.cells = np.pad(self.cells, ((down, up), (left, right)))
        self.frame = np.array([resolution, self.frame[1] - left * resolution, self.frame[2] - down * resolution])

    def crop(self, margin: int = 2) -> None:
        """Shrink to the known cells and a margin of unknown ones; an empty grid stays as it is."""
        box = np.empty(4, np.int64)
        kernels.known_box(self.cells, box)
        y0, y1, x0, x1 = (int(v) for v in box)
        if y0 > y1:
            return
        resolution = float(self.frame[0])
        self.cells = np.pad(self.cells[y0 : y1 + 1, x0 : x1 + 1], margin)
        self.frame = np.array(
            [resolution, self.frame[1] + (x0 - margin) * resolution, self.frame[2] + (y0 - margin) * resolution]
        )

    def packed(self) -> PackedGrid:
        """Return the grid in an eighth of its memory or less; half a millisecond unpacks one of 800 x 800 cells."""
        data = zstandard.compress(self.cells.tobytes())
        return PackedGrid(self.cells.shape, self.frame, bytes(memoryview(data)))  # `data` keeps room for the worst case


@dataclass(frozen=True, slots=True, eq=False)
class PackedGrid:
    """The `shape` (h, w) and `frame` of a grid, and its `data`: the cells, compressed."""

    shape: tuple[int, int]
    frame: F64
    data: bytes

    @property
    def spec(self) -> GridSpec:
        """The geometry in the grid's own frame."""
        return _spec(self.shape, self.frame)

    def unpacked(self) -> ProbabilityGrid:
        """Return the grid."""
        cells = np.empty(self.shape, np.uint16)
        room = cells.data.cast("B")
        with zstandard.ZstdDecompressor().stream_reader(self.data) as stream:  # into its place: it may be large
            while count := stream.readinto(room):
                room = room[count:]
        return ProbabilityGrid.of(cells, self.frame)


def _spec(shape: tuple[int, ...], frame: F64) -> GridSpec:
    h, w = shape
    return GridSpec(float(frame[0]), w, h, float(frame[1]), float(frame[2]))
