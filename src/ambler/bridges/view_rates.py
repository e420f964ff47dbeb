"""What the live view sends and how often: wall-clock limits per topic, so that no run is slowed by its viewers.

Most topics show their newest message at a limited rate. Transforms are merged, the newest of every edge. Events (status, gate,
contacts) are few and all of them are shown, up to a bounded backlog.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ambler.core import messages as m
from ambler.runtime.topics import Topic

DEFAULT_RATE_HZ = 30.0
EVENT_BACKLOG = 100
EVENTS = (m.Status, m.GateStatus, m.Contact)
RATES_HZ: Mapping[type[m.Message], float] = {
    m.PointCloud: 5.0,
    m.OccupancyGrid: 1.0,
    m.CostGrid: 2.0,
    m.Frontiers: 2.0,
    m.VisibilityGraphView: 1.0,
    m.Path: 10.0,
    m.LaserScan: 10.0,
}

Stamped = tuple[m.Message, int]


@dataclass(slots=True)
class Counts:
    """Messages of one topic that were sent, and those that were skipped because newer ones replaced them."""

    sent: int = 0
    skipped: int = 0


class Outbox:
    """What waits to be shown on one topic.

    `put` is called by the thread of the run, `take` by the thread of the bridge; both are built on operations that are atomic
    in CPython (assignment to a dict, append and popleft of a deque), so that neither ever waits for the other.
    """

    def __init__(self, topic: Topic[Any], rate_hz: float | None = None) -> None:
        self.topic = topic
        self.counts = Counts()
        wanted = RATES_HZ.get(topic.type, DEFAULT_RATE_HZ) if rate_hz is None else rate_hz
        self._period = 0.0 if math.isinf(wanted) else 1.0 / wanted
        self._next_time = -math.inf
        self._is_event = issubclass(topic.type, EVENTS)
        self._is_tree = issubclass(topic.type, m.Transforms)
        self._waiting: deque[Stamped] = deque(maxlen=EVENT_BACKLOG if self._is_event else 1)
        self._edges: dict[str, m.TransformStamped] = {}

    def put(self, message: m.Message, time_ns: int) -> None:
        """Offer a message; it replaces the waiting one, or joins the backlog of events."""
        if self._is_tree:
            assert isinstance(message, m.Transforms)
            for edge in message.transforms:
                self._edges[edge.child] = edge
        if len(self._waiting) == self._waiting.maxlen:
            self.counts.skipped += 1
        self._waiting.append((message, time_ns))

    def take(self, now: float) -> list[Stamped]:
        """Return what is due at the wall-clock instant `now` (monotonic seconds), oldest first."""
        if not self._waiting or now < self._next_time:
            return []
        self._next_time = now + self._period
        taken: list[Stamped] = []
        while self._waiting and len(taken) < EVENT_BACKLOG:
            taken.append(self._waiting.popleft())
        if self._is_tree:
            _, time_ns = taken[-1]
            edges, self._edges = self._edges, {}
            taken = [(m.Transforms(time_ns, tuple(edges.copy().values())), time_ns)] if edges else []
        self.counts.sent += len(taken)
        return taken
