"""Where the middle of the robot has been: there it can be again, though a wall that is drawn a cell too thick says no.

Cells are as fine as a hand's breadth, and a wall on the border of two is now in one, now in the other. A door that is just wide enough is
shut and open in turns, and whoever went in while it was open must come out again. What stands nearer than a wall's cell can err stays in the way.
"""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_INSCRIBED, COST_LETHAL, GridSpec

U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

SLACK = 2.0  # cells by which an obstacle may lie nearer than the inscribed circle: one that the wall is off, one that the robot is
LONGEST_STEP = 1.0  # metres between two places with the way between them; what is farther apart was no drive
BESIDE = np.array([(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)])


class DrivenCells:
    """Cells of the map frame on which the robot's middle was, and those beside them."""

    def __init__(self, inscribed_radius: float) -> None:
        self._inscribed_radius = inscribed_radius
        self._last: tuple[float, float] | None = None
        self._keys: dict[tuple[int, int], None] = {}
        self._spec: GridSpec | None = None
        self._cells: I64 = np.zeros(0, np.int64)  # of that grid
        self._known = 0  # how many of the keys they hold
        self._resolution = 0.0

    def add(self, x: float, y: float, resolution: float) -> None:
        """Remember where the robot is (m, map frame), and the way from where it was, in steps of half a cell (m)."""
        if resolution != self._resolution:
            self.forget()
            self._resolution = resolution
        last = self._last if self._last is not None else (x, y)
        length = math.dist(last, (x, y))
        if length > LONGEST_STEP:
            last, length = (x, y), 0.0
        self._last = (x, y)
        for t in (
            np.linspace(1.0, 0.0, math.ceil(2.0 * length / resolution), endpoint=False) if length > 0.0 else (1.0,)
        ):
            at = last[0] + t * (x - last[0]), last[1] + t * (y - last[1])
            self._keys.setdefault((math.floor(at[0] / resolution), math.floor(at[1] / resolution)))

    def forget(self) -> None:
        """Forget all: another map, another level."""
        self._last, self._keys, self._spec = None, {}, None

    def kept_open(self, costs: U8, source: U8, spec: GridSpec) -> I64:
        """Return the flat indices of cells that only the inflation shuts, though the robot was there: inscribed in `costs`, with nothing
        lethal in `source` nearer than the inscribed radius less `SLACK` cells; both uint8 [iy, ix]."""
        cells = self._cells_of(spec)
        at: I64 = np.unique(cells[np.ascontiguousarray(costs).reshape(-1)[cells] == COST_INSCRIBED])
        if len(at) == 0:
            return at
        reach = self._inscribed_radius / spec.resolution - SLACK
        around = np.arange(-math.ceil(reach), math.ceil(reach) + 1)
        dy, dx = (a.ravel() for a in np.meshgrid(around, around, indexing="ij"))
        is_near = np.hypot(dy, dx) < reach
        iy = (at[:, None] // spec.shape[1] + dy[is_near]).clip(0, spec.shape[0] - 1)
        ix = (at[:, None] % spec.shape[1] + dx[is_near]).clip(0, spec.shape[1] - 1)
        is_free: NDArray[np.bool_] = (source[iy, ix] != COST_LETHAL).all(axis=1)
        return np.asarray(at[is_free], np.int64)

    def _cells_of(self, spec: GridSpec) -> I64:
        """Return the flat indices of all that was driven and lies in a grid; only what is new since the last call is looked for."""
        if spec != self._spec:
            self._spec, self._cells, self._known = spec, np.zeros(0, np.int64), 0
        news = np.array(list(islice(reversed(self._keys), len(self._keys) - self._known))).reshape(-1, 2)
        self._known = len(self._keys)
        cells = (spec.cells_of((news + 0.5) * spec.resolution)[:, None] + BESIDE).reshape(-1, 2)
        cells = cells[((cells >= 0) & (cells < spec.shape)).all(axis=1)]
        self._cells = np.concatenate((self._cells, np.unique(cells @ (spec.shape[1], 1))))
        return self._cells
