"""The obstacle layer: what sensors see now. Every ray clears, whatever its height or end; only wanted returns mark.

All rays of an update clear first, then all its points mark, so that one sensor never erases what another sees at that instant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_FREE, COST_UNKNOWN, GridSpec
from ambler.kernels import costmap as kernels

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]


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
    `free_ends` (M, 2), ends of rays that only clear: no return within range, or a return too high or too low to matter."""

    origin: tuple[float, float]
    hits: F64 = field(default_factory=lambda: np.zeros((0, 2)))
    free_ends: F64 = field(default_factory=lambda: np.zeros((0, 2)))
    starts: F64 | None = None
    free_starts: F64 | None = None

    def starts_of(self, starts: F64 | None) -> F64:
        """Return `starts` as the kernels take it, or (1, 2) with the origin."""
        return np.array([self.origin]) if starts is None else _writeable(starts)


class ObstacleLayer:
    """A grid uint8 [iy, ix] of 0 free, 254 lethal, 255 never seen."""

    def __init__(self, config: ObstacleConfig, spec: GridSpec) -> None:
        self.config = config
        self.spec = spec
        self.cells: U8 = np.full(spec.shape, COST_UNKNOWN, np.uint8)

    def update(self, rays: Sequence[SensorRays]) -> None:
        """Clear along every ray, then mark every hit within range."""
        config, spec = self.config, self.spec
        place = (spec.origin_x, spec.origin_y, spec.resolution)
        for r in rays:
            for starts, ends, is_free in ((r.starts, r.hits, False), (r.free_starts, r.free_ends, True)):
                points, begins = _writeable(ends), r.starts_of(starts)
                kernels.clear_rays(self.cells, *place, begins, points, config.raytrace_range, is_free)
        for r in rays:
            points = _writeable(r.hits)
            kernels.mark_points(self.cells, *place, r.starts_of(r.starts), points, config.obstacle_range)

    def clear_polygon(self, polygon: F64) -> None:
        """Free the cells inside a convex, counter-clockwise polygon (N, 2): where the robot stands, nothing else does."""
        spec = self.spec
        points = _writeable(polygon)
        kernels.fill_convex(self.cells, spec.origin_x, spec.origin_y, spec.resolution, points, COST_FREE)

    def move_to(self, spec: GridSpec) -> None:
        """Keep what overlaps with another grid of the same resolution, aligned to whole cells; the rest becomes unknown."""
        if spec == self.spec:
            return
        dy, dx = spec.offset_in(self.spec)
        moved = np.full(spec.shape, COST_UNKNOWN, np.uint8)
        y0, y1 = max(0, dy), min(self.spec.height, dy + spec.height)
        x0, x1 = max(0, dx), min(self.spec.width, dx + spec.width)
        if y1 > y0 and x1 > x0:
            moved[y0 - dy : y1 - dy, x0 - dx : x1 - dx] = self.cells[y0:y1, x0:x1]
        self.cells, self.spec = moved, spec

    def reset(self) -> None:
        """Forget everything."""
        self.cells[:] = COST_UNKNOWN


def _writeable(points: F64) -> F64:
    """Return the points as the kernels were compiled for: a read-only array is another type to the compiler."""
    return np.require(points, np.float64, ["C", "W"])
