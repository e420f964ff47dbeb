"""A costmap layer of one's own: zones of the map that the robot keeps out of, known from the start or told on a topic of one's own.

Nothing in `src` knows this file. A costmap gets the layer through its constructor, a node what feeds it (docs/costmap.md).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import COST_LETHAL, GridSpec
from ambler.core.messages import Polygon
from ambler.costmap.layer import Box, Frames, Moment, box_around, union, whole
from ambler.runtime.topics import Topic

KEEP_OUT = Topic("keep_out", Polygon, "/keep_out", "latched", 1)
"""One zone; it takes the place of the zone told before."""


class KeepOutLayer:
    """A `Layer`: cells whose centres lie in a zone are lethal. Zones are polygons (N, 2) of any form, in the map frame."""

    def __init__(self, zones_map: Iterable[NDArray[np.float64]] = ()) -> None:
        self._known = [np.asarray(zone, np.float64) for zone in zones_map]
        self._told: list[NDArray[np.float64]] = []
        self._zones: list[NDArray[np.float64]] = []
        self._spec: GridSpec | None = None

    def take(self, message: Polygon, frames: Frames) -> None:
        """Take a zone in the map frame, as a `LayerInput` feeds it; one with fewer than three corners takes the last one away."""
        zone = np.array(message.points[:, :2], np.float64)
        self._told = [zone] if len(zone) >= 3 else []

    def update(self, spec: GridSpec, moment: Moment) -> Box | None:
        """Put the zones where the map lies now; while nobody knows, there are none."""
        last, is_new = self._zones, spec != self._spec
        pose = moment.costmap_from_map
        self._zones = [] if pose is None else [pose.transform(zone) for zone in (*self._known, *self._told)]
        self._spec = spec
        if is_new:
            return whole(spec)
        if len(last) == len(self._zones) and all(map(np.array_equal, last, self._zones)):
            return None
        changed: Box | None = None
        for zone in (*last, *self._zones):
            changed = union(changed, box_around(zone, spec))
        return changed

    def draw_into(self, master: NDArray[np.uint8], spec: GridSpec, box: Box) -> None:
        """Draw every zone over whatever is there."""
        for zone in self._zones:
            part = box_around(zone, spec)
            if part is not None:
                y0, y1, x0, x1 = part
                master[y0:y1, x0:x1][inside(zone, spec, part)] = COST_LETHAL

    def clear(self) -> None:
        """Do nothing: no sensor saw the zones."""


def inside(zone: NDArray[np.float64], spec: GridSpec, box: Box) -> NDArray[np.bool_]:
    """Return which cells of a box have their centres in a polygon: those whose ray to the right crosses its edges an odd number of times."""
    y0, y1, x0, x1 = box
    x = (spec.origin_x + (np.arange(x0, x1) + 0.5) * spec.resolution)[None, :]
    y = (spec.origin_y + (np.arange(y0, y1) + 0.5) * spec.resolution)[:, None]
    is_in = np.zeros((y1 - y0, x1 - x0), np.bool_)
    for (ax, ay), (bx, by) in zip(zone, np.roll(zone, -1, axis=0), strict=True):
        if ay != by:
            is_in ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return is_in
