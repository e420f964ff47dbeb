"""One level of a map of ground: a sheet that may rise and fall as it likes, without anything of it above or below itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ambler.core.grid import OCC_ASSUMED, OCC_FREE, OCC_OCCUPIED, OCC_UNKNOWN, GridSpec
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.kernels import ground_map as kernels

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
# metres between the heights of two places beside each other that are no neighbours, and how far beside
EDGE, BESIDE = 0.6, 0.6
# metres to either side within which ground goes on where single cells of it were not seen: a terrain is sparse
HOLE = 0.2
FAR = np.float32(1e6)  # metres: no height


@dataclass
class Level:
    """One level: `evidence` int8 [iy, ix] of kernels.ground_map, `heights` float32 [iy, ix] of the ground in the map frame, NaN where not known,
    `reaches` float32 how high (m, in the map frame) reaches what is in the way there, -inf where nothing stands, and `firm` uint8 [iy, ix], `STOOD` where the robot has stood, and 1 beside it where the ground lay in the plane of its wheels."""

    spec: GridSpec
    evidence: NDArray[np.int8] = field(repr=False)
    heights: F32 = field(repr=False)
    firm: U8 = field(repr=False)
    reaches: F32 = field(repr=False)

    @classmethod
    def empty(cls, spec: GridSpec) -> Level:
        """Return a level of which nothing is known."""
        evidence = np.full(spec.shape, kernels.UNKNOWN, np.int8)
        heights, firm = np.full(spec.shape, np.nan, np.float32), np.zeros(spec.shape, np.uint8)
        return cls(spec, evidence, heights, firm, np.full(spec.shape, -np.inf, np.float32))

    @property
    def _layers(self) -> tuple[NDArray[Any], ...]:
        return self.evidence, self.heights, self.firm, self.reaches

    def grown(self, spec: GridSpec) -> Level:
        """Return the same level with room for more: `spec` lies on the same lattice and holds this one's."""
        diy, dix = self.spec.offset_in(spec)
        inner = np.s_[diy : diy + self.spec.height, dix : dix + self.spec.width]
        out = Level.empty(spec)
        for its, mine in zip(out._layers, self._layers, strict=True):
            its[inner] = mine
        return out

    def share(self, cells: NDArray[np.bool_], other: Level) -> None:
        """Tell another level of cells (bool [iy, ix]), where that has room and knows nothing."""
        inner, of_other = common_cells(self.spec, other.spec)
        if inner is None:
            return
        new = cells[inner] & (other.evidence[of_other] == kernels.UNKNOWN)
        for mine, its in zip(self._layers, other._layers, strict=True):
            its[of_other][new] = mine[inner][new]

    def give(self, cells: NDArray[np.bool_], other: Level) -> None:
        """Share cells (bool [iy, ix]) with another level and forget them."""
        self.share(cells, other)
        for mine, nothing in zip(self._layers, (kernels.UNKNOWN, np.nan, 0, -np.inf), strict=True):
            mine[cells] = nothing

    def around(self, place: SE3, reach: float, within: float) -> NDArray[np.bool_]:
        """Return the cells (bool [iy, ix]) within `reach` metres of a place, and `within` metres of its height."""
        x, y, z = place.translation
        dy = self.spec.origin_y + (np.arange(self.spec.height) + 0.5) * self.spec.resolution - y
        dx = self.spec.origin_x + (np.arange(self.spec.width) + 0.5) * self.spec.resolution - x
        return np.asarray((np.hypot(dy[:, None], dx[None, :]) <= reach) & (np.abs(self.heights - z) <= within))

    def ground_under(self, place: SE3, reach: float, within: float) -> NDArray[np.bool_]:
        """Return the ground (bool [iy, ix]) `around` a place that goes on from it, cell by cell: not that behind a wall. None where the level does not reach."""
        x, y, _ = place.translation
        if not self.spec.contains(x, y):
            return np.zeros(self.spec.shape, np.bool_)
        labels, _ = ndimage.label((self.evidence > 0) & self.around(place, reach, within))
        under = labels[self.spec.cell_of(x, y)]
        return np.asarray((labels == under) & (under > 0))

    def joined(self, height: float, within: float, x: float, y: float, reach: float) -> NDArray[np.bool_]:
        """Return the cells (bool [iy, ix]) whose heights are `within` of a height and that hang together with such within `reach` metres of a place, across gaps of
        twice `HOLE`: of ground that is seen from afar, single cells lie apart."""
        is_like = np.abs(self.heights - height) <= within
        labels, _ = self._patches(is_like)
        labels[~is_like] = 0
        (iy, ix), r = self.spec.cell_of(x, y), math.ceil(reach / self.spec.resolution)
        near = labels[max(0, iy - r) : iy + r + 1, max(0, ix - r) : ix + r + 1]
        return np.isin(labels, near[near > 0])

    def islands(self, height: float, within: float, step: float) -> NDArray[np.bool_]:
        """Return the patches of cells (bool [iy, ix]) whose heights are `within` of a height and that nothing goes on from: no cell beside them is higher or lower by less than `step`. They
        were seen from another level."""
        off = np.abs(self.heights - height)
        is_like = off <= within
        labels, count = self._patches(is_like)
        goes_on = np.zeros(count + 1, np.bool_)
        goes_on[labels[(off > within) & (off <= step)]] = True
        return np.asarray(is_like & ~goes_on[labels])

    def _patches(self, cells: NDArray[np.bool_]) -> tuple[NDArray[np.integer], int]:
        """Number cells that hang together across gaps of twice `HOLE`, and what lies within `HOLE` of them: labels [iy, ix] from 1 on, and how many there are."""
        wide = np.ones((2 * round(HOLE / self.spec.resolution) + 1,) * 2, np.uint8)
        labels, count = ndimage.label(cv2.dilate(cells.astype(np.uint8), wide), np.ones((3, 3)))
        return labels, int(count)

    def is_ground(self, place: SE2) -> bool:
        """Say whether there is ground at a place."""
        iy, ix = self.spec.cell_of(place.x, place.y)
        return self.spec.contains_cell(iy, ix) and bool(self.evidence[iy, ix] > 0)

    @property
    def is_begun(self) -> bool:
        """Whether anything is known of it."""
        return bool((self.evidence != kernels.UNKNOWN).any())

    def occupancy(self, assumed: int = OCC_ASSUMED) -> NDArray[np.int8]:
        """Return the level as a map, int8 [iy, ix]: ground is free, what cannot be crossed occupied, and what is too near to be seen `assumed`."""
        out, ground = np.full(self.spec.shape, OCC_UNKNOWN, np.int8), self.evidence > 0
        out[_closed(ground, self.spec.resolution)] = assumed
        out[_closed(ground & (self.evidence != kernels.ASSUMED), self.spec.resolution)] = OCC_FREE
        out[(self.evidence <= 0) & (self.evidence != kernels.UNKNOWN)] = OCC_OCCUPIED
        out[self._below_edges()] = OCC_UNKNOWN
        return out

    def _below_edges(self) -> NDArray[np.bool_]:
        """Say what lies or stands close below ground that ends above it, as the floor under a deck does beside the top of a ramp: for who comes there on the ramp, what follows is not
        known. Ground that is only assumed ends above nothing."""
        is_seen = (self.evidence > 0) & (self.evidence != kernels.ASSUMED) & np.isfinite(self.heights)
        ground = np.where(is_seen, self.heights, -FAR)
        reach = round(BESIDE / self.spec.resolution)
        around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        high = np.asarray(cv2.dilate(ground.astype(np.float32), around))
        known = (self.evidence != kernels.UNKNOWN) & np.isfinite(self.heights)
        return np.asarray(known & (high - np.where(known, self.heights, FAR) > EDGE))


def _closed(ground: NDArray[np.bool_], resolution: float) -> NDArray[np.bool_]:
    """Return ground with its small holes, bool [iy, ix]."""
    hole = 2 * round(HOLE / resolution) + 1
    return np.asarray(cv2.morphologyEx(ground.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((hole, hole), np.uint8)) > 0)


def common_cells(spec: GridSpec, other: GridSpec) -> tuple[tuple[slice, slice] | None, tuple[slice, slice]]:
    """Return the cells of a map, and of another one on the same lattice, where both are; None: nowhere."""
    diy, dix = spec.offset_in(other)
    y0, x0 = max(0, -diy), max(0, -dix)
    y1, x1 = min(spec.height, other.height - diy), min(spec.width, other.width - dix)
    inner = np.s_[y0:y1, x0:x1] if y1 > y0 and x1 > x0 else None
    return inner, np.s_[y0 + diy : y1 + diy, x0 + dix : x1 + dix]
