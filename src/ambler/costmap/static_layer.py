"""The static layer: the costs of an occupancy grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_FREE, COST_LETHAL, COST_UNKNOWN, GridSpec
from ambler.costmap.layer import Box, Moment, changed_box, union, whole
from ambler.kernels import costmap as kernels

U8 = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class StaticConfig:
    """Occupancy >= `lethal_threshold` is lethal, unknown is 255 (0 unless `tracks_unknown`), the rest is free when `is_trinary`
    and proportional otherwise."""

    lethal_threshold: int = 65
    tracks_unknown: bool = True
    is_trinary: bool = True


class StaticLayer:
    """A `Layer` that lies below all others: it replaces what is there. `set_map` gives it its grid."""

    def __init__(self, config: StaticConfig) -> None:
        self._table = occupancy_table(config)
        self._spec: GridSpec | None = None
        self._cells: U8 = np.zeros((0, 0), np.uint8)
        self._changed: Box | None = None

    def set_map(self, spec: GridSpec, occupancy: NDArray[np.int8]) -> None:
        """Take a map int8 [iy, ix] in place of the last one; raises BadInputError when it does not fit its geometry."""
        if occupancy.shape != spec.shape:
            raise BadInputError(f"a map of {occupancy.shape} cells does not fit its geometry {spec.shape}")
        cells = np.empty(spec.shape, np.uint8)
        kernels.to_static(np.ascontiguousarray(occupancy), self._table, cells)
        is_same = spec == self._spec
        self._changed = union(self._changed, changed_box(self._cells, cells)) if is_same else whole(spec)
        self._spec, self._cells = spec, cells

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Return what the last maps changed; raises BadInputError when `spec` is not the map's."""
        if spec != self._spec:
            raise BadInputError("a static layer covers its own map only")
        changed, self._changed = self._changed, None
        return changed

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Replace what is there."""
        y0, y1, x0, x1 = box
        master[y0:y1, x0:x1] = self._cells[y0:y1, x0:x1]

    def clear(self) -> None:
        """Do nothing: a map is not what sensors see now."""


def occupancy_table(config: StaticConfig) -> U8:
    """Return the cost of occupancy v at index v + 128, uint8 (256,)."""
    value = np.arange(256) - 128
    graded = np.zeros(256) if config.is_trinary else value / config.lethal_threshold * COST_LETHAL
    table = np.where(value >= config.lethal_threshold, COST_LETHAL, np.clip(graded, COST_FREE, COST_LETHAL - 1))
    table[value < 0] = COST_UNKNOWN if config.tracks_unknown else COST_FREE
    return np.asarray(table, np.uint8)
