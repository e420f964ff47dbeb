"""The blocked layer: places that the robot could not pass though everything else says that it could, drawn lethal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.costmap.layer import Box, Moment, box_around, union, whole

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]


class BlockedLayer:
    """A `Layer` of points in the map frame; it draws nothing while nobody knows where the map lies in the costmap's frame."""

    def __init__(self) -> None:
        self._points_map: F64 = np.zeros((0, 2))
        self._drawn: F64 = np.zeros((0, 2))
        self._spec: GridSpec | None = None

    def set_points(self, points_map: NDArray[np.floating]) -> None:
        """Take all points (N, 2) in the map frame in place of the last ones."""
        self._points_map = np.array(points_map, np.float64).reshape(-1, 2)

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Put the points where the map lies now."""
        last, is_new = self._drawn, spec != self._spec
        pose = moment.costmap_from_map
        self._drawn = np.zeros((0, 2)) if pose is None else pose.transform(self._points_map)
        self._spec = spec
        if is_new:
            return whole(spec)
        if np.array_equal(last, self._drawn):
            return None
        return union(box_around(last, spec), box_around(self._drawn, spec))

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Draw the cell of every point."""
        cells = spec.cells_of(self._drawn)
        is_inside = (cells >= 0).all(axis=1) & (cells[:, 0] < spec.height) & (cells[:, 1] < spec.width)
        master[cells[is_inside, 0], cells[is_inside, 1]] = COST_LETHAL

    def clear(self) -> None:
        """Do nothing: no sensor saw this, so none can take it back; whoever marked it does."""
