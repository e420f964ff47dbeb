"""Layers of places that somebody tells in the map frame, drawn lethal: ways that the robot could not pass though everything else says that it could, and
what people and other programs add."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.costmap.layer import Box, Moment, box_around, union, whole

U8 = NDArray[np.uint8]
F64 = NDArray[np.float64]
LINE_STEP = 0.02  # metres between two points of a line: less than half of a fine cell


class PlacesLayer:
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
        _draw(self._drawn, master, spec)

    def clear(self) -> None:
        """Do nothing: no sensor saw this, so none can take it back; whoever told it does."""


class BlockedLayer(PlacesLayer):
    """Places that could not be passed."""


class AddedLayer(PlacesLayer):
    """Obstacles that people or other programs have added."""


class BoundaryLayer(PlacesLayer):
    """A closed line that the robot does not cross. Inflation makes it as wide as the robot; a goal beyond it is not reached. Its points are its corners:
    of its sides, however long, only what lies in the grid is drawn."""

    def __init__(self) -> None:
        super().__init__()
        self._line: F64 = np.zeros((0, 2))

    def set_corners(self, corners_map: NDArray[np.floating]) -> None:
        """Take the corners (N, 2) of a polygon in the map frame in place of the last ones; none takes the boundary away. Raises BadInputError for one
        or two corners, and for numbers that are not finite."""
        corners = np.array(corners_map, np.float64).reshape(-1, 2)
        if 0 < len(corners) < 3 or not np.isfinite(corners).all():
            raise BadInputError(f"a boundary has three corners or more, or none, and not {len(corners)}")
        self.set_points(corners)

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Put the sides where the map lies now."""
        box = super().update(spec, moment)
        if box is not None:
            self._line = _closed_line(self._drawn, spec)
        return box

    def draw_into(self, master: U8, spec: GridSpec, box: Box) -> None:
        """Draw the cells of all sides."""
        _draw(self._line, master, spec)


def _draw(points: F64, master: U8, spec: GridSpec) -> None:
    cells = spec.cells_of(points)
    is_inside = (cells >= 0).all(axis=1) & (cells[:, 0] < spec.height) & (cells[:, 1] < spec.width)
    master[cells[is_inside, 0], cells[is_inside, 1]] = COST_LETHAL


def _closed_line(corners: F64, spec: GridSpec) -> F64:
    """Return points (M, 2) along what a grid holds of a polygon's sides, LINE_STEP apart at most."""
    low = np.array([spec.origin_x, spec.origin_y])
    high = low + spec.resolution * np.array([spec.width, spec.height])
    parts = [np.zeros((0, 2))]
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = np.where(
            a == b, 1e-12, b - a
        )  # shares of the side at which it crosses the grid's edges: Liang and Barsky (1984)
        shares = np.sort([(low - a) / along, (high - a) / along], axis=0)
        first, last = max(0.0, float(shares[0].max())), min(1.0, float(shares[1].min()))
        if first <= last:
            a, b = a + first * (b - a), a + last * (b - a)
            parts.append(np.linspace(a, b, max(2, math.ceil(float(np.hypot(*(b - a))) / LINE_STEP) + 1)))
    return np.concatenate(parts)
