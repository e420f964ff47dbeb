"""Takes the returns of dust, smoke and rain out of clouds: what is dim, near, and stands for no surface.

A return is doubted when it is dim beside the rest of its cloud and near. Doubt ends where its neighbours in the same cloud lie on a plane or a line with it
(the floor far ahead, a wire); where they lie all about it and are bright, they are leaves, where they are dim, smoke. A return without neighbours is kept when its
place was hit in other clouds, too: a thin pole stays, dust blows on. After the intensity and density filters for snow and dust in the literature (LIOR, DSOR).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.messages import PointCloud
from ambler.kernels import air as kernel

F64 = NDArray[np.float64]
SAMPLE = 4000  # returns from which brightness and the distance of beams are told
AROUND = 1.2  # times the greatest range that is judged: so far out neighbours may lie
_OPEN = 255  # no verdict yet
APART = 1e4  # m
PATCH = math.radians(6.0)  # edge of the patches that tell how much of the sphere a scanner sees


@dataclass(frozen=True, slots=True)
class AirFilterConfig:
    """`dim`: share of the brightness that a quarter of the returns exceed, below which a return is doubted (dust 0.05, a wall met at 80° 0.2).
    `range_most` m: farther out so little light comes from nothing but surfaces. `depth` (share of the range that neighbours may be before or behind: the floor, met flatly), `thickness` m (noise of three standard deviations), `share` of the neighbours: what
    makes a surface. A place is a cube of `cell` m, larger where it would be narrower than `beams` of the scanner's beams, and lasts when `again` of the 15 clouds before hit it."""

    is_used: bool = True
    dim: float = 0.25
    range_most: float = 15.0
    depth: float = 0.25
    thickness: float = 0.04
    share: float = 0.6
    cell: float = 0.1
    beams: float = 0.0
    again: int = 3
    places_most: int = 1 << 16


class CloudLooks:
    """What does not depend on which points of a cloud are asked for: how bright is dim, and the verdicts on points. It is kept for the cloud that was looked at last."""

    def __init__(self, config: AirFilterConfig) -> None:
        self._config = config
        self._cloud: PointCloud | None = None

    def look_at(self, cloud: PointCloud) -> float:
        """Return the intensity below which a return of this cloud is dim; `verdicts` are on its returns from now on."""
        if cloud is not self._cloud:
            self._cloud = cloud
            self._limit = self._dim_below(cloud)
            self._verdicts = np.full(len(cloud.points), _OPEN, np.uint8)
            self._cells: _Cells | None = None
        return self._limit

    def verdicts(self, doubted: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return the verdicts on returns (K,), given by their numbers."""
        asked = doubted[self._verdicts[doubted] == _OPEN]
        if len(asked):
            self._verdicts[asked] = self._judge(asked)
        return np.asarray(self._verdicts[doubted])

    @property
    def spacing(self) -> float:
        """Mean angle (rad) between the beams of the cloud."""
        return self._sorted().spacing

    def _dim_below(self, cloud: PointCloud) -> float:
        """Return the intensity below which a return is dim beside the others: infinite, where a scanner does not tell brightness."""
        sample = cloud.intensity[:: max(1, len(cloud.intensity) // SAMPLE)]
        low, high = np.percentile(sample, (5.0, 75.0))
        return float(self._config.dim * high) if high > low else math.inf

    def _judge(self, asked: NDArray[np.int64]) -> NDArray[np.uint8]:
        c, cells = self._config, self._sorted()
        verdicts = np.empty(len(asked), np.uint8)
        kernel.judge(
            *(cells.cloud, cells.near, cells.is_dim, asked, cells.columns, cells.rows),
            *(cells.cell_of, cells.begins, cells.order, cells.spacing, c.depth, c.thickness, c.share, verdicts),
        )
        return verdicts

    def _sorted(self) -> _Cells:
        if self._cells is None:
            assert self._cloud is not None
            self._cells = _Cells.of(self._cloud, self._limit, AROUND * self._config.range_most)
        return self._cells


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """The near returns of a cloud, sorted into cells of azimuth and elevation (`kernels.air`)."""

    cloud: NDArray[np.float32]
    near: NDArray[np.float32]
    is_dim: NDArray[np.bool_]
    columns: int
    rows: int
    cell_of: NDArray[np.int64]
    begins: NDArray[np.int64]
    order: NDArray[np.int64]
    spacing: float

    @classmethod
    def of(cls, cloud: PointCloud, limit: float, reach: float) -> _Cells:
        points, intensity = np.ascontiguousarray(cloud.points), np.ascontiguousarray(cloud.intensity)
        n, spacing = len(points), _spacing(points)
        columns = min(max(math.ceil(2.0 * math.pi / (kernel.EDGE * spacing)), 16), 2048)
        rows = min(max(math.ceil(2.0 / (kernel.EDGE * spacing)), 8), 1024)
        cell_of, order = np.empty(n, np.int64), np.empty(n, np.int64)
        near, is_dim, begins = (
            np.empty((n, 3), np.float32),
            np.empty(n, np.bool_),
            np.empty(columns * rows + 1, np.int64),
        )
        # Where brightness is not told, smoke and leaves are the same.
        dim_below = limit if math.isfinite(limit) else -math.inf
        kernel.sort_cells(points, intensity, reach, dim_below, columns, rows, cell_of, begins, order, near, is_dim)
        return cls(points, near, is_dim, columns, rows, cell_of, begins, order, spacing)


class AirFilter:
    """Give it every cloud of one scanner in the order of time. Filters that are asked about the same clouds one after the other, in one thread, may share `looks`."""

    def __init__(self, config: AirFilterConfig | None = None, looks: CloudLooks | None = None) -> None:
        self.config = c = config or AirFilterConfig()
        self._looks = looks or CloudLooks(c)
        self._scan = 0
        self._table = (
            np.full(c.places_most, -1, np.int64),
            np.zeros(c.places_most, np.uint16),
            np.zeros(c.places_most, np.int64),
        )

    def keep(
        self,
        cloud: PointCloud,
        asked: NDArray[np.int64],
        place: Callable[[NDArray[np.int64]], NDArray[np.floating]],
    ) -> NDArray[np.bool_]:
        """Return which of the points `asked` (M,) are kept, bool (M,). `place` returns where points of some numbers (K,) lie in a frame that stands still, (K, 3)."""
        kept = np.ones(len(asked), np.bool_)
        self._scan += 1
        if not self.config.is_used or len(cloud.points) < kernel.LEAST:
            return kept
        limit = self._looks.look_at(cloud)
        dim = np.flatnonzero(cloud.intensity[asked] < limit)
        points = cloud.points[asked[dim]]
        squares = np.einsum("ij,ij->i", points, points)
        doubted = dim[(squares < self.config.range_most**2) & (squares > 0.0)]
        if len(doubted) == 0:
            return kept
        verdicts = self._looks.verdicts(asked[doubted])
        kept[doubted[verdicts == kernel.CLOUDY]] = False
        lonely = doubted[verdicts == kernel.LONELY]
        if len(lonely):
            ranges = np.linalg.norm(cloud.points[asked[lonely]].astype(np.float64), axis=1)
            kept[lonely] = self._lasts(np.asarray(place(asked[lonely]), np.float64), ranges)
        return kept

    def _lasts(self, places: F64, ranges: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return which places (M, 3) at these ranges (M,) were hit before; the sides of their cubes are `cell` times a power of two."""
        c = self.config
        wide = c.beams * self._looks.spacing * ranges / c.cell
        doublings = np.round(np.log2(np.maximum(wide, 1.0)))
        places = places / 2.0 ** doublings[:, None]
        places[:, 2] += APART * doublings  # cubes of other sides are other places
        is_lasting = np.empty(len(places), np.bool_)
        kernel.remember(*self._table, self._scan, places, c.cell, c.again, is_lasting)
        return is_lasting


def _spacing(points: NDArray[np.float32]) -> float:
    """Return the mean angle (rad) between a scanner's beams: that of as many patches as returns on the part of the sphere in which there are any."""
    columns, rows = round(2.0 * math.pi / PATCH), round(2.0 / PATCH)
    step = max(1, len(points) // SAMPLE)
    seen = kernel.count_patches(points, step, columns, rows, np.empty(columns * rows, np.bool_))
    return math.sqrt(max(seen, 1) * 4.0 * math.pi / (columns * rows) / len(points))
