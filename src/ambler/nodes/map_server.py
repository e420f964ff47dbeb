"""The map server: publishes a saved map, which never changes while the robot runs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid
from ambler.runtime.node import Node
from ambler.runtime.topics import MAP


class MapServerNode(Node):
    """Publishes one map: `occupancy` int8 [iy, ix] in the cells of `spec` (`wire.map_files.load_map`)."""

    name = "map_server"
    outputs = (MAP,)
    latency = 0.001

    def __init__(self, spec: GridSpec, occupancy: NDArray[np.int8]) -> None:
        self._spec = spec
        self._occupancy = occupancy

    def start(self) -> None:
        """Publish once; the topic is latched."""
        self.ctx.publish(MAP, OccupancyGrid(self.ctx.now_ns, "map", self._spec, self._occupancy))
