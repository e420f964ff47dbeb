"""What a viewer is shown as soon as it asks, and what is said again because viewers forget.

Latched topics are kept, and `/status`, which speaks only when something happens: the newest message of each of its writers. The fixed
transforms are repeated: a viewer that is given another layout while it is connected keeps its subscription and forgets their content.
"""

from __future__ import annotations

import math
from typing import Any

from ambler.bridges.view_rates import Stamped
from ambler.core.messages import Message, Status
from ambler.runtime.bus import whole
from ambler.runtime.topics import STATIC_TRANSFORMS, Topic

REPEAT_PERIOD = 1.5
REPEATED = (STATIC_TRANSFORMS.name,)


class ViewMemory:
    """The newest messages of kept topics. `keep` is called by the thread of the run, the rest by that of the bridge; as in `Outbox`,
    neither waits for the other."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[str, Stamped]] = {}
        self._repeat_time = -math.inf

    def keep(self, topic: Topic[Any], message: Message, time_ns: int, writer: str) -> None:
        """Remember a message if its topic is kept; of transforms the newest of every edge."""
        if not is_kept(topic):
            return
        by_writer = self._kept.setdefault(topic.name, {})
        key = writer if topic.has_many_writers else ""
        before = by_writer.get(key)
        by_writer[key] = (whole(before and before[0], message), time_ns)

    def newest(self, name: str) -> list[Stamped]:
        """Return what is kept of a topic, oldest first."""
        return sorted(self._kept.get(name, {}).copy().values(), key=lambda stamped: stamped[1])

    def due(self, now: float) -> tuple[str, ...]:
        """Return the names of topics to be said again at the wall-clock instant `now` (monotonic seconds)."""
        if now < self._repeat_time:
            return ()
        self._repeat_time = now + REPEAT_PERIOD
        return REPEATED


def is_kept(topic: Topic[Any]) -> bool:
    """Say whether a new viewer is shown at once what a topic said last."""
    return topic.delivery == "latched" or issubclass(topic.type, Status)
