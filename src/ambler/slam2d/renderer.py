"""The global map, composed of submaps: finished submaps are added once and again only when optimization has moved one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.se2 import SE2, wrap_angle
from ambler.grids.probability import log_odds_table
from ambler.kernels import submap as kernels
from ambler.slam2d.config import RenderConfig
from ambler.slam2d.submaps import Submap

_BLOCK = 5.0
_MOVED_LINEAR = 0.005
_MOVED_ANGULAR = 0.0005


@dataclass(frozen=True, slots=True)
class PlacedSubmap:
    """A submap and where it lies in the map."""

    submap: Submap
    map_from_submap: SE2


class MapRenderer:
    """Adds log odds of submaps on a lattice that contains the map's origin, and thresholds the sum."""

    def __init__(self, config: RenderConfig) -> None:
        self._config = config
        self._log_odds = log_odds_table()
        self._base: dict[int, SE2] = {}
        self._spec: GridSpec | None = None
        self._evidence = np.zeros((0, 0), np.float32)
        self._known = np.zeros((0, 0), np.uint8)

    def render(self, placed: list[PlacedSubmap]) -> tuple[GridSpec, NDArray[np.int8]]:
        """Return the map's geometry and occupancy int8 [iy, ix] (-1 unknown, 0 free, 100 occupied), cropped to what is known."""
        spec = self._canvas(placed)
        finished = [p for p in placed if p.submap.is_finished]
        if spec != self._spec or not self._is_base_of(finished):
            self._spec = spec
            self._evidence = np.zeros(spec.shape, np.float32)
            self._known = np.zeros(spec.shape, np.uint8)
            self._base = {}
        for p in finished:
            if p.submap.index not in self._base:
                self._compose(p, spec, self._evidence, self._known)
                self._base[p.submap.index] = p.map_from_submap
        evidence, known = self._evidence.copy(), self._known.copy()
        for p in placed:
            if not p.submap.is_finished:
                self._compose(p, spec, evidence, known)
        occupancy = np.empty(spec.shape, np.int8)
        kernels.to_occupancy(evidence, known, self._config.free_below, self._config.occupied_above, occupancy)
        return self._crop(spec, known, occupancy)

    def _compose(
        self, p: PlacedSubmap, spec: GridSpec, evidence: NDArray[np.float32], known: NDArray[np.uint8]
    ) -> None:
        frame = np.array([spec.resolution, spec.origin_x, spec.origin_y])
        pose = p.map_from_submap.as_array()
        grid, beside = p.submap.grid, self._config.beside_occupied
        kernels.compose(grid.cells, grid.frame, pose, self._log_odds, beside, frame, evidence, known)

    def _is_base_of(self, finished: list[PlacedSubmap]) -> bool:
        now = {p.submap.index: p.map_from_submap for p in finished}
        for index, old in self._base.items():
            new = now.get(index)
            if new is None or old.distance_to(new) > _MOVED_LINEAR:
                return False
            if abs(wrap_angle(old.yaw - new.yaw)) > _MOVED_ANGULAR:
                return False
        return True

    def _canvas(self, placed: list[PlacedSubmap]) -> GridSpec:
        """Return a grid over all submaps whose borders lie on multiples of a block, so that it rarely changes."""
        corners = []
        for p in placed:
            resolution, x, y = (float(v) for v in p.submap.grid.frame)
            h, w = p.submap.grid.cells.shape
            box = np.array(
                [[x, y], [x + w * resolution, y], [x, y + h * resolution], [x + w * resolution, y + h * resolution]]
            )
            corners.append(p.map_from_submap.transform(box))
        points = np.concatenate(corners) if corners else np.zeros((1, 2))
        low = np.floor(points.min(axis=0) / _BLOCK) * _BLOCK
        size = np.maximum(np.ceil(points.max(axis=0) / _BLOCK) * _BLOCK - low, _BLOCK)
        resolution = self._config.resolution
        return GridSpec(
            resolution,
            math.ceil(size[0] / resolution - 1e-9),
            math.ceil(size[1] / resolution - 1e-9),
            float(low[0]),
            float(low[1]),
        )

    def _crop(
        self, spec: GridSpec, known: NDArray[np.uint8], occupancy: NDArray[np.int8]
    ) -> tuple[GridSpec, NDArray[np.int8]]:
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        if len(rows) == 0:
            return spec, occupancy
        m = math.ceil(self._config.margin / spec.resolution)
        y0, y1 = max(0, int(rows[0]) - m), min(spec.height, int(rows[-1]) + 1 + m)
        x0, x1 = max(0, int(columns[0]) - m), min(spec.width, int(columns[-1]) + 1 + m)
        origin = spec.origin_x + x0 * spec.resolution, spec.origin_y + y0 * spec.resolution
        return GridSpec(spec.resolution, x1 - x0, y1 - y0, *origin), np.ascontiguousarray(occupancy[y0:y1, x0:x1])
