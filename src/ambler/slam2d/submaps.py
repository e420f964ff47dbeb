"""Submaps: each is a probability grid, and a field of lines, filled by consecutive scans; two are active, the older one is matched against."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2, wrap_angle
from ambler.grids.probability_grid import Inserter, InsertionConfig, PackedGrid, ProbabilityGrid
from ambler.registration.line_field import LineConfig, LineField, PackedLines
from ambler.registration.planar_scan import NOTHING_BETWEEN, BetweenReturns, PlanarScan

F32 = NDArray[np.float32]

METRES_PER_RADIAN = 1.0
RECENT = 8  # finished submaps that lie unpacked
MOST_TIMES = 8
"""As how many scans one counts at most that comes after a long way, in which a denser log would have had as many."""


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """What scans drew: a grid, and the lines of their returns."""

    grid: ProbabilityGrid
    lines: LineField

    def packed(self) -> PackedDrawing:
        """Return it in less memory."""
        return PackedDrawing(self.grid.packed(), self.lines.packed())


@dataclass(frozen=True, slots=True, eq=False)
class PackedDrawing:
    """A drawing of which nothing but its extent can be read."""

    grid: PackedGrid
    lines: PackedLines

    def unpacked(self) -> Drawing:
        """Return the drawing."""
        return Drawing(self.grid.unpacked(), LineField.of(self.lines))


class RecentDrawings:
    """The drawings of the finished submaps that were asked for last, unpacked: scans are searched in the same few for a while. May be asked in several threads."""

    def __init__(self, most: int = RECENT) -> None:
        self._most = most
        self._lock = threading.Lock()
        self._drawings: OrderedDict[int, Drawing] = OrderedDict()

    def get(self, index: int, packed: PackedDrawing) -> Drawing:
        """Return a submap's drawing, by its index, and keep it ready."""
        drawing = self.find(index)
        drawing = packed.unpacked() if drawing is None else drawing
        with self._lock:
            self._drawings[index] = drawing
            self._drawings.move_to_end(index)
            if len(self._drawings) > self._most:
                self._drawings.popitem(last=False)
        return drawing

    def find(self, index: int) -> Drawing | None:
        """Return a submap's drawing if it lies ready."""
        with self._lock:
            return self._drawings.get(index)


@dataclass(slots=True, eq=False)
class Submap:
    """A grid and the lines of its returns in its own frame; `local_from_submap` never changes and has yaw 0, so that its cells lie on the local frame's lattice.
    When it is finished, its drawing is packed."""

    index: int
    local_from_submap: SE2
    drawing: Drawing | PackedDrawing
    recent: RecentDrawings
    scans: int = 0
    nodes: list[int] = field(default_factory=list)
    way: float = 0.0
    doubt: tuple[float, float] = (0.0, 0.0)
    travelled: float = 0.0

    @property
    def is_finished(self) -> bool:
        """Whether it takes no more scans."""
        return isinstance(self.drawing, PackedDrawing)

    @property
    def grid(self) -> ProbabilityGrid:
        """Its cells."""
        return self._open().grid

    @property
    def lines(self) -> LineField:
        """Its lines."""
        return self._open().lines

    @property
    def spec(self) -> GridSpec:
        """The geometry of its grid, in its own frame."""
        return self.drawing.grid.spec

    def passing_grid(self) -> ProbabilityGrid:
        """Return its cells for one who reads all submaps once, and must not put away those that others read."""
        drawing = self.drawing
        if isinstance(drawing, Drawing):
            return drawing.grid
        ready = self.recent.find(self.index)
        return drawing.grid.unpacked() if ready is None else ready.grid

    def finish(self) -> None:
        """Take no more scans."""
        if isinstance(self.drawing, Drawing):
            self.drawing.grid.crop()
            self.drawing = self.drawing.packed()

    def to_submap(self, local_from_base: SE2) -> SE2:
        """Return submap_from_base."""
        return self.local_from_submap.inverse() @ local_from_base

    def _open(self) -> Drawing:
        drawing = self.drawing
        return drawing if isinstance(drawing, Drawing) else self.recent.get(self.index, drawing)


class ActiveSubmaps:
    """The one or two submaps that take scans: a new one starts when the newer is half full, the older one ends when full."""

    def __init__(
        self,
        config: InsertionConfig,
        scans_per_submap: int,
        distance_per_submap: float = math.inf,
        step: float = math.inf,
        lines: LineConfig | None = None,
    ) -> None:
        self._inserter = Inserter(config)
        self._lines = lines or LineConfig()
        self._half = scans_per_submap
        self._half_distance = distance_per_submap
        self._step = step
        self._last = SE2()
        self._recent = RecentDrawings()
        self.submaps: list[Submap] = []
        self._count = 0

    @property
    def target(self) -> Submap | None:
        """The submap to match against."""
        return self.submaps[0] if self.submaps else None

    def insert(
        self, scan: PlanarScan, local_from_base: SE2, between: BetweenReturns = NOTHING_BETWEEN
    ) -> tuple[list[Submap], Submap | None]:
        """Insert a scan and what lies between its returns; returns the submaps that took it and the one that this scan finished, if any."""
        step = self._last.distance_to(local_from_base)
        changed = step + METRES_PER_RADIAN * abs(wrap_angle(local_from_base.yaw - self._last.yaw))
        self._last = local_from_base
        if not self.submaps or self._is_full(self.submaps[-1], 1.0):
            self._start(local_from_base)
            step = 0.0
        times = min(max(1, round(changed / self._step)), MOST_TIMES)
        lows = None if scan.falls is None else scan.falls.below(self._inserter.config.low)
        for submap in self.submaps:
            submap.travelled += step
            pose = submap.to_submap(local_from_base)
            starts, free_starts = (pose.transform(s) for s in scan.ray_starts())
            points = pose.transform(scan.points).astype(np.float32)
            free = pose.transform(scan.free_points).astype(np.float32)
            surfaces = pose.transform(between.points).astype(np.float32)
            self._inserter.insert(submap.grid, starts, points, free, free_starts, surfaces, between.sure, times, lows)
            submap.lines.add(points, starts)
            submap.scans += 1
        used = list(self.submaps)
        finished = None
        if len(self.submaps) > 1 and self._is_full(self.submaps[-1], 1.0):
            finished = self.submaps.pop(0)
            finished.finish()
        return used, finished

    def _is_full(self, submap: Submap, halves: float) -> bool:
        return submap.scans >= halves * self._half or submap.travelled >= halves * self._half_distance

    def _start(self, local_from_base: SE2) -> None:
        config = self._inserter.config
        r = config.resolution
        snapped = SE2(round(local_from_base.x / r) * r, round(local_from_base.y / r) * r, 0.0)
        grid = ProbabilityGrid(r, (0.0, 0.0), config.initial_size)
        self.submaps.append(Submap(self._count, snapped, Drawing(grid, LineField(self._lines)), self._recent))
        self._count += 1
