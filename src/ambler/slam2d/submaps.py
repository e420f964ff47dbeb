"""Submaps: each is a probability grid, and a field of lines, filled by consecutive scans; two are active, the older one is matched against."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import SE2, wrap_angle
from ambler.grids.probability_grid import Inserter, InsertionConfig, ProbabilityGrid
from ambler.registration.line_field import LineConfig, LineField
from ambler.registration.planar_scan import NOTHING_BETWEEN, BetweenReturns, PlanarScan

F32 = NDArray[np.float32]

METRES_PER_RADIAN = 1.0
MOST_TIMES = 8
"""As how many scans one counts at most that comes after a long way, in which a denser log would have had as many."""


@dataclass(slots=True, eq=False)
class Submap:
    """A grid and the lines of its returns in its own frame; `local_from_submap` never changes and has yaw 0, so that its cells lie on the local frame's lattice."""

    index: int
    local_from_submap: SE2
    grid: ProbabilityGrid
    lines: LineField
    scans: int = 0
    is_finished: bool = False
    nodes: list[int] = field(default_factory=list)
    way: float = 0.0
    doubt: tuple[float, float] = (0.0, 0.0)
    travelled: float = 0.0

    def to_submap(self, local_from_base: SE2) -> SE2:
        """Return submap_from_base."""
        return self.local_from_submap.inverse() @ local_from_base


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
            finished.grid.crop()
            finished.lines.trim()
            finished.is_finished = True
        return used, finished

    def _is_full(self, submap: Submap, halves: float) -> bool:
        return submap.scans >= halves * self._half or submap.travelled >= halves * self._half_distance

    def _start(self, local_from_base: SE2) -> None:
        config = self._inserter.config
        r = config.resolution
        snapped = SE2(round(local_from_base.x / r) * r, round(local_from_base.y / r) * r, 0.0)
        grid = ProbabilityGrid(r, (0.0, 0.0), config.initial_size)
        self.submaps.append(Submap(self._count, snapped, grid, LineField(self._lines)))
        self._count += 1
