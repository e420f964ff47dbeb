"""The planar scan that every 2-D matcher and grid takes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ambler.kernels import scan_points

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Where a surface goes on between neighbouring returns; a device of one beam a degree sees walls at 10 m in dots 0.17 m apart.
LONGEST_GAP = 1.0  # m
WIDEST_BEAMS = math.radians(2.5)  # a device of one beam a degree may lose one between
LEAST_INCIDENCE = math.sin(math.radians(5.0))
LEAST_BEND = math.cos(math.radians(15.0))
LONGEST_LIKELY = 4.0
LEAST_LIKELY_INCIDENCE = math.sin(math.radians(1.5))
LEAST_LIKELY_BEND = math.cos(math.radians(3.0))
MOST_BETWEEN = 8192


@dataclass(frozen=True, slots=True, eq=False)
class RayFalls:
    """How low the rays of a flattened cloud pass. From `height` (m above the floor) the lowest ray of each direction falls by `sinks` float32 (N,)
    per metre, `free_sinks` (M,) of those without return; `tops` float32 (N,) is how high each return's surface goes (inf: above the band).

    Within some metres all rays pass above a sofa, and tell nothing of it.
    """

    height: float
    sinks: F32
    free_sinks: F32
    tops: F32

    def of(self, hits: NDArray[np.bool_]) -> RayFalls:
        """Return this for some of the N returns only, bool (N,)."""
        return replace(self, sinks=self.sinks[hits], tops=self.tops[hits])

    def below(self, height: float) -> tuple[F64, F64]:
        """Return from which distance (m) on rays are lower than a height, float64 (N,) and (M,); inf for those that never are."""
        return _below(self.height - height, self.sinks), _below(self.height - height, self.free_sinks)


def _below(depth: float, sinks: F32) -> F64:
    out = np.full(len(sinks), 0.0 if depth <= 0.0 else math.inf)
    if depth > 0.0:
        np.divide(depth, sinks, out=out, where=sinks > 0.0)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class PlanarScan:
    """Points of one scan in the base frame of the instant `stamp_ns`, motion-compensated.

    `points` float32 (N, 2) are returns; `free_points` float32 (M, 2) end rays that are free but have no return; `origin` (x, y)
    is the sensor. `intensities` float32 (N,) belong to the returns, None when none were measured. `starts` (N, 2) and `free_starts` (M, 2) are
    where the sensor was when it measured each ray, when rays do not all start at `origin`: of several sensors, or of a moving one. `falls` tells
    how low the rays of a cloud pass; None: they are level.
    """

    stamp_ns: int
    points: F32
    free_points: F32
    origin: tuple[float, float] = (0.0, 0.0)
    intensities: F32 | None = None
    starts: F32 | None = None
    free_starts: F32 | None = None
    falls: RayFalls | None = None

    def ray_starts(self) -> tuple[F64, F64]:
        """Return where the rays of the returns and the free rays start, float64 (N, 2) and (M, 2), or (1, 2) for one start of all."""
        one = np.array([self.origin])
        starts = one if self.starts is None else self.starts.astype(np.float64)
        return starts, one if self.free_starts is None else self.free_starts.astype(np.float64)

    def thinned(self, size: float, *, picks_middle: bool = True) -> PlanarScan:
        """Return the scan with the middle or the first return of every square voxel; what belongs to the returns goes with them."""
        chosen = np.empty(len(self.points), np.int64)
        n = scan_points.choose_voxels(self.points, size, _table(len(self.points)), picks_middle, chosen)
        return self.of_returns(chosen[: int(n)])

    def of_returns(self, rows: NDArray[np.int64]) -> PlanarScan:
        """Return the scan with these of its returns, by their rows, and all its free rays."""
        f = self.falls
        return replace(
            self,
            points=self.points[rows],
            intensities=None if self.intensities is None else self.intensities[rows],
            starts=None if self.starts is None else self.starts[rows],
            falls=None if f is None else replace(f, sinks=f.sinks[rows], tops=f.tops[rows]),
        )


def _table(n: int) -> NDArray[np.int64]:
    return np.empty((3, 1 << max(4, (2 * n).bit_length())), np.int64)


def filter_voxels(points: F32, size: float) -> F32:
    """Keep the middle point of every square voxel, in the order of the scan; (N, 2) -> (K, 2), order kept."""
    out, chosen = np.empty_like(points), np.empty(len(points), np.int64)
    return out[: int(scan_points.voxel_filter(points, size, _table(len(points)), True, chosen, out))].copy()


def filter_voxels_adaptively(points: F32, max_size: float, min_points: int, *, picks_middle: bool = True) -> F32:
    """Keep at least `min_points` points with the largest voxel up to `max_size` that allows it; (N, 2) -> (K, 2).

    The voxel is never below 1/128 of `max_size`, so that points closer than that may count as one. `picks_middle`: of its points the middle one in the
    order of the scan, else the first one.
    """
    out, chosen = np.empty_like(points), np.empty(len(points), np.int64)
    n = scan_points.adaptive_voxel_filter(points, max_size, min_points, _table(len(points)), picks_middle, chosen, out)
    return out[: int(n)].copy()  # who keeps them need not keep the room for all points


@dataclass(frozen=True, slots=True, eq=False)
class BetweenReturns:
    """Points float32 (K, 2) on surfaces that go on between neighbouring returns: the first `sure` of them certainly, the others likely: a wall that is seen
    at a grazing angle, whose returns lie metres apart, may have a gap there, but rays along it do not show one."""

    points: F32
    sure: int


NOTHING_BETWEEN = BetweenReturns(np.empty((0, 2), np.float32), 0)


def points_between_returns(scan: PlanarScan, spacing: float) -> BetweenReturns:
    """Return points at most `spacing` apart on the surfaces that go on between neighbouring returns of a scan."""
    sure = (spacing, LONGEST_GAP, WIDEST_BEAMS, LEAST_INCIDENCE, LEAST_BEND)
    likely = (spacing, LONGEST_LIKELY, WIDEST_BEAMS, LEAST_LIKELY_INCIDENCE, LEAST_LIKELY_BEND)
    out, counts = np.empty((MOST_BETWEEN, 2), np.float32), np.empty(2, np.int64)
    scan_points.fill_surfaces(scan.points, np.array(scan.origin), np.array([sure, likely]), out, counts)
    return BetweenReturns(out[: int(counts[1])], int(counts[0]))
