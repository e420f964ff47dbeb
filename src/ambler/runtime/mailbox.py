"""What waits for one node of the live executor: messages per subscription and writer, calls, timers.

A thread that wakes costs more than most messages do. Messages that a node only keeps do not wake it until there are some; whatever does wake it finds them taken in.
"""

from __future__ import annotations

import heapq
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ambler.core.messages import Message
from ambler.runtime.bus import Subscription, whole
from ambler.runtime.topics import Topic

_IDLE = 0.5
_KEPT_MOST = 10  # messages that can wait, before the node is woken for them


@dataclass(slots=True, eq=False)
class _Letter:
    """A message on its way to one subscription."""

    subscription: Subscription
    topic: Topic[Any]
    message: Message
    writer: int


class Mailbox:
    """Safe from any thread; `take` is for the node's own. `drops` counts what a full queue lost, by topic."""

    def __init__(self) -> None:
        self.drops: dict[str, int] = {}
        self._condition = threading.Condition()
        self._queue: deque[_Letter | Callable[[], None]] = deque()
        self._waiting: dict[tuple[int, int], int] = {}
        self._timers: list[tuple[int, int, Callable[[], None]]] = []
        self._sequence = 0
        self._kept = 0
        self._was_timer = False
        self._is_closed = False

    def put_message(self, subscription: Subscription, topic: Topic[Any], message: Message, writer: int) -> None:
        """Add a message. A full queue drops its oldest; of `latest` topics only the newest waits, of latched ones the newest of each
        writer, with transforms merged."""
        key = id(subscription), writer if topic.delivery == "latched" else 0
        depth = topic.depth if topic.delivery == "queue" else 1
        with self._condition:
            waiting = self._waiting.get(key, 0)
            if waiting >= depth:
                oldest = self._take_oldest(subscription, writer if topic.delivery == "latched" else None)
                if topic.delivery == "queue":
                    self.drops[topic.name] = self.drops.get(topic.name, 0) + 1
                elif topic.delivery == "latched":
                    message = whole(oldest, message)
            else:
                self._waiting[key] = waiting + 1
            self._queue.append(_Letter(subscription, topic, message, writer))
            self._kept += subscription.can_wait
            if not subscription.can_wait or self._kept >= _KEPT_MOST:
                self._condition.notify()

    def put_call(self, callback: Callable[[], None]) -> None:
        """Add a callback; calls are never dropped."""
        with self._condition:
            self._queue.append(callback)
            self._condition.notify()

    def put_timer(self, due_ns: int, callback: Callable[[], None]) -> None:
        """Add a callback that is due at an instant of the executor's clock."""
        with self._condition:
            self._sequence += 1
            heapq.heappush(self._timers, (due_ns, self._sequence, callback))
            self._condition.notify()

    def open(self) -> None:
        """Let `take` wait again."""
        self._is_closed = False

    def close(self) -> None:
        """Let `take` return None from now on; what waits stays."""
        with self._condition:
            self._is_closed = True
            self._condition.notify_all()

    def take(self, now_ns: Callable[[], int]) -> Callable[[], None] | None:
        """Wait for what is to be done next and return it: messages that could wait and are first in the queue, what is due, then the queue in order. A timer that takes longer
        than its period is always due: between two timers something of the queue has its turn. None after `close`."""
        with self._condition:
            while not self._is_closed:
                self._kept = 0
                if self._queue and _can_wait(self._queue[0]):
                    return self._open_letter(self._queue.popleft())
                wait = _IDLE
                if self._timers:
                    wait = min(wait, (self._timers[0][0] - now_ns()) * 1e-9)
                    if wait <= 0.0 and not (self._was_timer and self._queue):
                        self._was_timer = True
                        return heapq.heappop(self._timers)[2]
                self._was_timer = False
                if self._queue:
                    return self._open_letter(self._queue.popleft())
                self._condition.wait(wait)
        return None

    def _open_letter(self, item: _Letter | Callable[[], None]) -> Callable[[], None]:
        if not isinstance(item, _Letter):
            return item
        self._waiting[id(item.subscription), item.writer if item.topic.delivery == "latched" else 0] -= 1

        def hand_over() -> None:
            item.subscription.context.receive(item.topic, item.message)
            item.subscription.callback(item.message)

        return hand_over

    def _take_oldest(self, subscription: Subscription, writer: int | None) -> Message | None:
        for i, item in enumerate(self._queue):
            if isinstance(item, _Letter) and item.subscription is subscription and writer in (None, item.writer):
                del self._queue[i]
                return item.message
        return None


def _can_wait(item: _Letter | Callable[[], None]) -> bool:
    return isinstance(item, _Letter) and item.subscription.can_wait
