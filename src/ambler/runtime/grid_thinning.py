"""Which grids of a run are recorded: small ones all, large ones the more rarely the larger they are, and the last one always.

The map and the costs of a hall of 10 000 m² have millions of cells and change a little every second: whole, they were half of a recording (nine tenths before compression) and a sixth of the time of the processor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ambler.core.messages import CostGrid, Message, OccupancyGrid
from ambler.runtime.topics import Topic

CELLS_PER_SECOND = 500_000
"""What is recorded of a topic: a building of 35 × 35 m in cells of 5 cm every second."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A grid as the bus delivered it, and the node that wrote it."""

    topic: Topic[Any]
    message: OccupancyGrid | CostGrid
    time_ns: int
    writer: str


class GridThinning:
    """Decides message by message. What no node of the stack wrote, came from outside, and a replay needs all of it."""

    def __init__(self) -> None:
        self._taken_ns: dict[Topic[Any], int] = {}
        self._left: dict[Topic[Any], Grid] = {}

    def takes(self, topic: Topic[Any], message: Message, time_ns: int, writer: str) -> bool:
        """Whether to record a message; a grid that is not recorded is kept until the next one comes."""
        if not isinstance(message, OccupancyGrid | CostGrid) or topic.delivery != "latched" or not writer:
            return True
        period_ns = 1e9 * message.data.size / CELLS_PER_SECOND
        last_ns = self._taken_ns.get(topic)
        if period_ns > 1e9 and last_ns is not None and 0 <= time_ns - last_ns < period_ns:  # clocks are set back
            self._left[topic] = Grid(topic, message, time_ns, writer)
            return False
        self._taken_ns[topic] = time_ns
        self._left.pop(topic, None)
        return True

    def rest(self) -> tuple[Grid, ...]:
        """Return the last grid of every topic that was not recorded, in the order of their delivery."""
        left = tuple(sorted(self._left.values(), key=lambda grid: grid.time_ns))
        self._left.clear()
        return left
