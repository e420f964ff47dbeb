"""The glass layer: segments of a map that light goes through and robots do not, drawn lethal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.costmap.layer import Box, Moment, box_around, union, whole
from ambler.kernels.range_layer import draw_segments

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]


class GlassLayer:
    """A `Layer`; it draws nothing while nobody knows where the map lies in the costmap's frame."""

    def __init__(self) -> None:
        self._segments_map: F64 = np.zeros((0, 4))
        self._drawn: F64 = np.zeros((0, 4))
        self._spec: GridSpec | None = None

    def set_segments(self, segments_map: NDArray[np.floating]) -> None:
        """Take all segments (N, 4) of (x0, y0, x1, y1) in the map frame in place of the last ones."""
        self._segments_map = np.array(segments_map, np.float64)

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Put the segments where the map lies now."""
        last, is_new = self._drawn, spec != self._spec
        pose = moment.costmap_from_map
        ends = np.zeros((0, 2)) if pose is None else pose.transform(self._segments_map.reshape(-1, 2))
        self._drawn, self._spec = ends.reshape(-1, 4), spec
        if is_new:
            return whole(spec)
        if np.array_equal(last, self._drawn):
            return None
        return union(box_around(last.reshape(-1, 2), spec), box_around(ends, spec))

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Draw every cell that a segment passes."""
        draw_segments(master, spec.origin_x, spec.origin_y, spec.resolution, self._drawn, COST_LETHAL)

    def clear(self) -> None:
        """Do nothing: glass belongs to the map."""
