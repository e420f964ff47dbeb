"""Frontier cells of a growing map, kept up to date by searching changed boxes only, and their 8-connected groups.

Frontiers as B. Yamauchi defines them ("A frontier-based approach for autonomous exploration", 1997): free cells next to
unknown ones. All cells are grouped anew at every update, which costs time in the number of frontier cells, not of the map.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.kernels.frontier import frontier_cells, group_cells, replace_in_box

I64 = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Box:
    """Cells [iy0, iy1) x [ix0, ix1)."""

    iy0: int
    ix0: int
    iy1: int
    ix1: int

    def grown(self, cells: int, spec: GridSpec) -> Box:
        """Return the box with a border of `cells`, cut at the grid's edge."""
        return Box(
            max(0, self.iy0 - cells),
            max(0, self.ix0 - cells),
            min(spec.height, self.iy1 + cells),
            min(spec.width, self.ix1 + cells),
        )


def changed_box(before: NDArray[np.int8], after: NDArray[np.int8]) -> Box | None:
    """Return the smallest box that holds every cell that differs between two grids of one shape, None when they are equal."""
    differs = before != after
    rows = np.flatnonzero(differs.any(axis=1))
    if len(rows) == 0:
        return None
    iy0, iy1 = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero(differs[iy0:iy1].any(axis=0))
    return Box(iy0, int(columns[0]), iy1, int(columns[-1]) + 1)


@dataclass(frozen=True, eq=False)
class FrontierGroups:
    """Groups of frontier cells of one grid: flat indices `iy * width + ix`, sorted by group (group g is
    cells[starts[g]:starts[g + 1]]), each group in row-major order, groups ordered by their first cell."""

    spec: GridSpec
    cells: I64
    starts: I64

    def __len__(self) -> int:
        return len(self.starts) - 1

    @property
    def sizes(self) -> I64:
        """Cells per group, int64 (G,)."""
        return np.diff(self.starts)

    def points(self) -> NDArray[np.float64]:
        """Return the centres of all cells in metres, float64 (N, 2), in the order of `cells`."""
        return self.spec.centers_of(np.stack(np.divmod(self.cells, self.spec.width), axis=1))

    @cached_property
    def parts(self) -> list[tuple[NDArray[np.float32], tuple[float, float]]]:
        """The centres of each group's cells, float32 (n, 2), and their mean, metres."""
        if len(self) == 0:
            return []
        points = self.points()
        means = np.add.reduceat(points, self.starts[:-1], axis=0) / self.sizes[:, None]
        cells, edges = points.astype(np.float32), itertools.pairwise(self.starts.tolist())
        return [(cells[a:b], (x, y)) for (a, b), (x, y) in zip(edges, means.tolist(), strict=True)]


class FrontierMap:
    """Keeps the frontier cells of one occupancy map. Cells with 0 <= occupancy < `free_below` count as free."""

    def __init__(self, free_below: int = 50) -> None:
        self.free_below = free_below
        self._spec: GridSpec | None = None
        self._cells: I64 = np.empty(0, np.int64)

    def update(self, spec: GridSpec, occupancy: NDArray[np.int8], changed: Box | None = None) -> FrontierGroups:
        """Search the changed box (None: the whole map) of an int8 [iy, ix] map and return all groups.

        A map of another spec than the last one is always searched whole. An empty box changes nothing.
        """
        if changed is None or spec != self._spec:
            buffer = np.empty(spec.height * spec.width, np.int64)
            n = frontier_cells(occupancy, self.free_below, 0, 0, spec.height, spec.width, buffer)
            self._cells = buffer[:n].copy()
        else:
            self._cells = self._search_again(spec, occupancy, changed.grown(1, spec))
        self._spec = spec
        return group(spec, self._cells)

    def _search_again(self, spec: GridSpec, occupancy: NDArray[np.int8], box: Box) -> I64:
        area = max(0, box.iy1 - box.iy0) * max(0, box.ix1 - box.ix0)
        fresh = np.empty(area, np.int64)
        edges = (box.iy0, box.ix0, box.iy1, box.ix1)
        n_fresh = frontier_cells(occupancy, self.free_below, *edges, fresh)
        merged = np.empty(len(self._cells) + n_fresh, np.int64)
        n = replace_in_box(self._cells, spec.width, *edges, fresh, n_fresh, merged)
        return merged[:n]


def group(spec: GridSpec, flat: I64) -> FrontierGroups:
    """Return the 8-connected groups of ascending flat cells."""
    n = len(flat)
    cells, starts = np.empty(n, np.int64), np.empty(n + 1, np.int64)
    groups = group_cells(flat, spec.width, np.empty(n, np.int64), cells, starts)
    return FrontierGroups(spec, cells, starts[: groups + 1])
