"""The obstacle layer: what sensors see now. Every ray clears, whatever its height or end; only wanted returns mark.

All rays of an update clear first, then all its points mark, so that one sensor never erases what another sees at that instant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_FREE, COST_UNKNOWN, GridSpec
from ambler.costmap.layer import Box, Moment, box_around, box_within, cells_within, moved, union, whole
from ambler.kernels import costmap as kernels
from ambler.registration.planar_scan import RayFalls

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]
SURE = 0.2  # metres: what is lower may be floor that a body's lean raised, and goes with the next ray over it


@dataclass(frozen=True, slots=True)
class ObstacleConfig:
    """Returns mark up to `obstacle_range` and rays clear up to `raytrace_range`, metres from the sensor. Limits of height are for
    whoever turns a cloud into `SensorRays`: a return too high or too low becomes a free end."""

    obstacle_range: float = 2.5
    raytrace_range: float = 3.0
    clears_footprint: bool = True


@dataclass(frozen=True)
class SensorRays:
    """What one sensor, or several at one instant, saw, in the costmap's frame: its origin (x, y), or where each ray of `hits` and of `free_ends`
    starts, `starts` (N, 2) and `free_starts` (M, 2); `hits` (N, 2), returns that mark and end their ray;
    `free_ends` (M, 2), ends of rays that only clear: no return within range, or a return too high or too low to matter. `falls` tells how low
    the rays pass: they clear nothing that they pass over (None: they are level and clear all on their way)."""

    origin: tuple[float, float]
    hits: F64 = field(default_factory=lambda: np.zeros((0, 2)))
    free_ends: F64 = field(default_factory=lambda: np.zeros((0, 2)))
    starts: F64 | None = None
    free_starts: F64 | None = None
    falls: RayFalls | None = None

    @property
    def spread(self) -> float:
        """How far from the origin rays start at most, metres."""
        given = [starts for starts in (self.starts, self.free_starts) if starts is not None and len(starts)]
        return max((float(np.hypot(*(starts - self.origin).T).max()) for starts in given), default=0.0)

    def starts_of(self, starts: F64 | None) -> F64:
        """Return `starts` as the kernels take it, or (1, 2) with the origin."""
        return np.array([self.origin]) if starts is None else _writeable(starts)


class ObstacleLayer:
    """A `Layer` of what sensors see now: `cells` uint8 [iy, ix] of 0 free, 254 lethal, 255 never seen; None until there is anything."""

    def __init__(self, config: ObstacleConfig) -> None:
        self.config = config
        self.cells: U8 | None = None
        self._tops: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._spec: GridSpec | None = None
        self._rays: list[SensorRays] = []
        self._is_cleared = False

    def add(self, rays: Sequence[SensorRays]) -> None:
        """Take rays in the costmap's frame; the next update clears along all of them and then marks all their hits."""
        self._rays += rays

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Trace the rays fed since the last update, then free the footprint."""
        changed = whole(spec) if self._is_cleared else None
        self._is_cleared = False
        rays, self._rays = self._rays, []
        footprint = moment.footprint if self.config.clears_footprint else None
        cells = self._moved(spec, is_needed=bool(rays) or footprint is not None)
        if cells is None:
            return changed
        self._trace(cells, spec, rays)
        reach = max(self.config.raytrace_range, self.config.obstacle_range)
        for r in rays:
            changed = union(changed, box_within(*r.origin, reach + r.spread, spec))
        if footprint is not None:
            place = (spec.origin_x, spec.origin_y, spec.resolution)
            kernels.fill_convex(cells, *place, _writeable(footprint), COST_FREE)
            changed = union(changed, box_around(footprint, spec))
        return changed

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Draw the larger cost; what is seen replaces what is unknown."""
        if self.cells is not None:
            kernels.combine(master, self.cells, *box)

    def clear(self) -> None:
        """Forget everything."""
        self.cells, self._spec, self._rays, self._is_cleared = None, None, [], True
        self._tops = np.zeros((0, 0), np.float32)

    def clear_within(self, x: float, y: float, radius: float) -> None:
        """Forget what was seen there."""
        if self.cells is not None and self._spec is not None:
            self.cells[cells_within(self._spec, x, y, radius)] = COST_UNKNOWN
            self._is_cleared = True

    def _moved(self, spec: GridSpec, *, is_needed: bool) -> U8 | None:
        """Return the cells in another grid, aligned to whole cells: what overlaps is kept, the rest unknown."""
        if self.cells is None or self._spec is None or spec.resolution != self._spec.resolution:
            self.cells = np.full(spec.shape, COST_UNKNOWN, np.uint8) if is_needed else None
            self._tops = np.zeros((0, 0), np.float32)
        elif spec != self._spec:
            self.cells = moved(self.cells, self._spec, spec, COST_UNKNOWN)
            if self._tops.size:
                self._tops = moved(self._tops, self._spec, spec, 0.0)
        self._spec = spec
        return self.cells

    def _trace(self, cells: U8, spec: GridSpec, rays: Sequence[SensorRays]) -> None:
        place = (spec.origin_x, spec.origin_y, spec.resolution)
        if not self._tops.size and any(r.falls is not None for r in rays):
            self._tops = np.full(spec.shape, np.inf, np.float32)
        tops, level = self._tops, np.zeros((0, 0), np.float32)
        for r in rays:
            z, sinks, free_sinks, _ = _heights(r.falls)
            over = level if r.falls is None else tops
            for starts, ends, is_free, falls in (
                (r.starts, r.hits, False, sinks),
                (r.free_starts, r.free_ends, True, free_sinks),
            ):
                points, begins = _writeable(ends), r.starts_of(starts)
                kernels.clear_rays(cells, over, *place, begins, points, self.config.raytrace_range, is_free, z, falls)
        for r in rays:
            points, heights = _writeable(r.hits), _heights(r.falls)[3]
            kernels.mark_points(cells, tops, *place, r.starts_of(r.starts), points, self.config.obstacle_range, heights)


def _heights(falls: RayFalls | None) -> tuple[float, F64, F64, F64]:
    """Return where rays begin above the floor, how they fall, and the tops of what they met, as the kernels take them."""
    if falls is None:
        return 0.0, np.zeros(0), np.zeros(0), np.zeros(0)
    tops = np.where(falls.tops < SURE, 0.0, falls.tops)
    return falls.height, _writeable(falls.sinks), _writeable(falls.free_sinks), _writeable(tops)


def _writeable(points: NDArray[np.floating]) -> F64:
    """Return the points as the kernels were compiled for: a read-only array is another type to the compiler."""
    return np.require(points, np.float64, ["C", "W"])
