"""The lockstep executor: simulated time, one deterministic order, as fast as the machine allows.

Events of one instant run in the order (messages by topic, writer and number; then calls; then timers by node). Because
every output is delivered at least a microsecond after it was made, this order does not depend on who scheduled what
first, so a recording replays to the same bits.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from ambler.core.messages import Message
from ambler.runtime.clock import SimulatedClock
from ambler.runtime.executor import EXTERNAL, Executor, NodeContext
from ambler.runtime.log import RunLog
from ambler.runtime.stack import Stack
from ambler.runtime.topics import Topic, all_topics

T = TypeVar("T")
Key = tuple[int, int, int, int, int]

_MESSAGE, _CALL, _TIMER = 0, 1, 2
_GRACE_NS = 1_000_000_000
# Writers that are no nodes sort before the nodes.
_PERSON, _FEED = -2, -1


class LockstepExecutor(Executor):
    """Runs a stack in simulated time. `extra_latency` delays the outputs of named nodes further (a fault), seconds."""

    def __init__(
        self,
        stack: Stack,
        clock: SimulatedClock | None = None,
        log: RunLog | None = None,
        on_failure: Callable[[str], None] | None = None,
        extra_latency: dict[str, float] | None = None,
    ) -> None:
        super().__init__(stack, log, on_failure)
        self.clock = clock if clock is not None else SimulatedClock()
        self._events: list[tuple[Key, Callable[[], None]]] = []
        self._topic_index = {topic.name: i for i, topic in enumerate(all_topics())}
        self._calls = 0
        self._injected: deque[tuple[Topic[Any], Message]] = deque()
        self._injections = 0
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="background")
        self._is_stopping = False
        self._deadline_ns: int | None = None
        for context in self.contexts:
            context.latency_ns += round((extra_latency or {}).get(context.node.name, 0.0) * 1e9)

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns

    def run(self, duration: float | None = None, feed: Iterable[tuple[Topic[Any], Message, int]] = ()) -> None:
        """Run until `duration` simulated seconds are over, `stop` is called or nothing is left to do; may be called again.

        `feed` gives external messages (topic, message, delivery time ns) in order of time. Raises NodeFailedError.
        """
        end_ns = None if duration is None else self.now_ns + round(duration * 1e9)
        source = iter(feed)
        self._is_stopping = False
        self.start_nodes()
        self._schedule_next(source)
        while not self._is_stopping:
            self._take_injected()
            if not self._events or (end_ns is not None and self._events[0][0][0] > end_ns):
                if end_ns is not None:
                    self.clock.advance(end_ns)
                break
            if self._deadline_ns is not None and self._events[0][0][0] > self._deadline_ns:
                break
            key, callback = heapq.heappop(self._events)
            self.clock.advance(key[0])
            callback()
            if key[1] == _MESSAGE and key[3] == _FEED:
                self._schedule_next(source)
        if self.failure is not None:
            raise self.failure

    def close(self) -> None:
        self.stop_nodes()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def send(self, topic: Topic[Any], message: Message, writer: NodeContext, number: int) -> None:
        due_ns = self.now_ns + writer.latency_ns
        self._push_message(topic, message, due_ns, writer.index, number, writer.node.name)

    def post(self, context: NodeContext, delay_ns: int, callback: Callable[[], None]) -> None:
        self._calls += 1
        key = (self.now_ns + max(1000, delay_ns), _CALL, 0, 0, self._calls)
        heapq.heappush(self._events, (key, lambda: self.guarded(context, callback)))

    def add_timer(
        self, context: NodeContext, period_ns: int, phase_ns: int, callback: Callable[[], None], number: int
    ) -> None:
        def fire(due_ns: int) -> None:
            push(due_ns + period_ns)
            self.guarded(context, callback)

        def push(due_ns: int) -> None:
            key = (due_ns, _TIMER, context.index, number, 0)
            heapq.heappush(self._events, (key, lambda: fire(due_ns)))

        push(self.now_ns + period_ns + phase_ns)

    def run_in_background(
        self, context: NodeContext, work: Callable[[], T], duration_ns: int, done: Callable[[T], None]
    ) -> None:
        future = self._pool.submit(work)
        self.post(context, duration_ns, lambda: done(future.result()))

    def inject(self, topic: Topic[Any], message: Message) -> None:
        self._injected.append((topic, message))

    def stop(self) -> None:
        self._is_stopping = True

    def after_failure(self) -> None:
        if self._deadline_ns is None:
            self._deadline_ns = self.now_ns + _GRACE_NS

    def _schedule_next(self, source: Any) -> None:
        for topic, message, due_ns in source:
            self._injections += 1
            self._push_message(topic, message, max(due_ns, self.now_ns), _FEED, self._injections, EXTERNAL)
            return

    def _take_injected(self) -> None:
        while self._injected:
            topic, message = self._injected.popleft()
            self._injections += 1
            self._push_message(topic, message, self.now_ns + 1000, _PERSON, self._injections, EXTERNAL)

    def _push_message(
        self, topic: Topic[Any], message: Message, due_ns: int, writer_index: int, number: int, writer: str
    ) -> None:
        key = (due_ns, _MESSAGE, self._topic_index[topic.name], writer_index, number)
        heapq.heappush(self._events, (key, lambda: self._deliver(topic, message, writer)))

    def _deliver(self, topic: Topic[Any], message: Message, writer: str) -> None:
        self.show(topic, message, self.now_ns, writer)
        subscriptions = self.subscriptions[topic.name]
        for subscription in subscriptions:
            subscription.context.receive(topic, message)
        for subscription in subscriptions:
            context = subscription.context
            self.guarded(context, lambda s=subscription: s.callback(message))  # type: ignore[misc]
