"""The lockstep executor: simulated time, one deterministic order, as fast as the machine allows.

Events of one instant run in the order (messages by stack, topic, writer and number; then calls, those from outside first; then
timers by node). Because every output is delivered at least a microsecond after it was made, this order does not depend on who
scheduled what first, so a recording replays to the same bits; and what one stack does never depends on another one's presence.
"""

from __future__ import annotations

import gc
import heapq
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from ambler.core.errors import StackError
from ambler.core.messages import Message, OutsideCall
from ambler.runtime.bus import Bus, Channel, Rank, Subscription
from ambler.runtime.clock import SimulatedClock
from ambler.runtime.context import NodeContext
from ambler.runtime.door import OutsideDoor
from ambler.runtime.executor import EXTERNAL, Executor
from ambler.runtime.log import RunLog
from ambler.runtime.node import WorkKind
from ambler.runtime.stack import Stack
from ambler.runtime.topics import OUTSIDE_CALLS, Topic

T = TypeVar("T")
Key = tuple[int, int, int, Rank, int, int]
"""Time, kind of event, stack, rank within the kind, writer, number."""
Feed = Iterable[tuple[Topic[Any], Message, int]]

_MESSAGE, _CALL, _TIMER = 0, 1, 2
_FROM_OUTSIDE: Rank = (-1, "")
_FROM_INSIDE: Rank = (0, "")
_GRACE_NS = 1_000_000_000
_SOON_NS = 1000
# Writers that are no nodes sort before the nodes.
_PERSON, _FEED = -2, -1


class LockstepExecutor(Executor):
    """Runs stacks in simulated time. `extra_latency` delays the outputs of named nodes further (a fault), seconds, by the names of
    their contexts: `node`, or `prefix/node`. Taps are called in the run's own thread, in the order of delivery."""

    def __init__(
        self,
        stacks: Stack | Sequence[Stack],
        clock: SimulatedClock | None = None,
        log: RunLog | None = None,
        on_failure: Callable[[str], None] | None = None,
        extra_latency: dict[str, float] | None = None,
    ) -> None:
        super().__init__(stacks, log, on_failure)
        self.clock = clock if clock is not None else SimulatedClock()
        self._events: list[tuple[Key, Callable[[], None]]] = []
        self._inbox: deque[Callable[[], None]] = deque()
        self._calls = 0
        self._injections = 0
        self._thread: int | None = None
        self._is_stopping = False
        self._deadline_ns: int | None = None
        for context in self.contexts:
            context.latency_ns += round((extra_latency or {}).get(context.name, 0.0) * 1e9)

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns

    def run(self, duration: float | None = None, feed: Feed | Mapping[str, Feed] = ()) -> None:
        """Run until `duration` simulated seconds are over, `stop` is called or nothing is left to do; may be called again.

        `feed` gives what comes from outside (topic, message, delivery time ns) in the order of a recording, or for several stacks
        one such stream by prefix. Messages of OUTSIDE_CALLS are calls and are carried out. Raises NodeFailedError.
        """
        feeds = feed if isinstance(feed, Mapping) else {self.stacks[0].prefix: feed}
        end_ns = None if duration is None else self.now_ns + round(duration * 1e9)
        self._is_stopping = False
        self._thread = threading.get_ident()
        gc.freeze()  # what was there before is not searched for garbage again and again during the run
        try:
            self.start_nodes()
            for prefix, stream in feeds.items():
                self._feed_next(self._bus(prefix), iter(stream))
            is_over = self._run_until(end_ns)
        finally:
            gc.unfreeze()
            self._thread = None
            self.log.flush()
        self.end_run(is_over=is_over)

    def _run_until(self, end_ns: int | None) -> bool:
        """Run events; returns whether the run is over (instead of merely its time)."""
        events, inbox = self._events, self._inbox
        while not self._is_stopping:
            while inbox:
                inbox.popleft()()
            if not events or (end_ns is not None and events[0][0][0] > end_ns):
                if end_ns is not None:
                    self.clock.advance(end_ns)
                return end_ns is None
            if self._deadline_ns is not None and events[0][0][0] > self._deadline_ns:
                return True
            key, callback = heapq.heappop(events)
            self.clock.advance(key[0])
            callback()
        return True

    def subscribe(self, channel: Channel, subscription: Subscription) -> None:
        channel.subscriptions = (*channel.subscriptions, subscription)
        for writer in sorted(channel.kept):
            self._deliver_late(channel, subscription, writer)

    def _deliver_late(self, channel: Channel, subscription: Subscription, writer: int) -> None:
        kept = channel.kept[writer]

        def deliver() -> None:
            if channel.kept[writer] is kept:  # else the newer one came already
                subscription.context.receive(channel.topic, kept)
                subscription.callback(kept)

        self.post(subscription.context, 0, deliver)

    def send(self, channel: Channel, message: Message, writer: NodeContext, number: int) -> None:
        if self._is_foreign():
            raise StackError(f"{writer.name} publishes from a thread that is not the run's")
        due_ns = self.now_ns + writer.latency_ns
        key = (due_ns, _MESSAGE, writer.bus.index, channel.rank, writer.index, number)
        heapq.heappush(
            self._events,
            (key, lambda: self._deliver(writer.bus, channel, message, writer.index, writer.node.name)),
        )

    def post(self, context: NodeContext, delay_ns: int, callback: Callable[[], None]) -> None:
        """Run a callback in a node's turn. From a foreign thread it is safe, but its time is not reproducible."""
        if self._is_foreign():
            self._inbox.append(lambda: self.post(context, delay_ns, callback))
            return
        self._calls += 1
        due_ns = self.now_ns + max(_SOON_NS, delay_ns)
        key = (due_ns, _CALL, context.bus.index, _FROM_INSIDE, 0, self._calls)
        heapq.heappush(self._events, (key, lambda: self.guarded(context, callback)))

    def post_outside(self, door: OutsideDoor, callback: Callable[[], None]) -> None:
        self._inbox.append(lambda: self._push_outside(door.context, self.now_ns + _SOON_NS, callback))

    def show_outside(self, bus: Bus, call: OutsideCall) -> None:
        self.show(bus, OUTSIDE_CALLS, call, self.now_ns, EXTERNAL)

    def add_timer(
        self, context: NodeContext, period_ns: int, phase_ns: int, callback: Callable[[], None], number: int
    ) -> None:
        rank = (context.index, "")

        def fire(due_ns: int) -> None:
            push(due_ns + period_ns)
            self.guarded(context, callback)

        def push(due_ns: int) -> None:
            key = (due_ns, _TIMER, context.bus.index, rank, number, 0)
            heapq.heappush(self._events, (key, lambda: fire(due_ns)))

        push(self.now_ns + period_ns + phase_ns)

    def run_in_background(
        self, context: NodeContext, work: Callable[[], T], duration_ns: int, done: Callable[[T], None], kind: WorkKind
    ) -> None:
        future = self.pool(context, kind).submit(work)
        self.post(context, duration_ns, lambda: done(future.result()))

    def inject(self, topic: Topic[Any], message: Message, prefix: str = "") -> None:
        bus = self._bus(prefix)
        self._inbox.append(lambda: self._push_external(bus, topic, message, self.now_ns + _SOON_NS, _PERSON))

    def stop(self) -> None:
        self._is_stopping = True

    def after_failure(self) -> None:
        if self._deadline_ns is None:
            self._deadline_ns = self.now_ns + _GRACE_NS

    def _is_foreign(self) -> bool:
        return self._thread is not None and threading.get_ident() != self._thread

    def _feed_next(self, bus: Bus, stream: Iterator[tuple[Topic[Any], Message, int]]) -> None:
        """Schedule the next of a feed; when it is done, the one after it."""
        fed = next(stream, None)
        if fed is None:
            return
        topic, message, time_ns = fed
        due_ns = max(time_ns, self.now_ns)
        if isinstance(message, OutsideCall):
            door = self._doors[bus.prefix]
            self._push_outside(door.context, due_ns, lambda: door.repeat(message), lambda: self._feed_next(bus, stream))
        else:
            self._push_external(bus, topic, message, due_ns, _FEED, lambda: self._feed_next(bus, stream))

    def _push_external(
        self,
        bus: Bus,
        topic: Topic[Any],
        message: Message,
        due_ns: int,
        writer: int,
        after: Callable[[], None] | None = None,
    ) -> None:
        self._injections += 1
        channel = bus.channel(topic)

        def deliver() -> None:
            self._deliver(bus, channel, message, writer, EXTERNAL)
            if after is not None:
                after()

        key = (due_ns, _MESSAGE, bus.index, channel.rank, writer, self._injections)
        heapq.heappush(self._events, (key, deliver))

    def _push_outside(
        self,
        context: NodeContext,
        due_ns: int,
        callback: Callable[[], None],
        after: Callable[[], None] | None = None,
    ) -> None:
        self._calls += 1

        def act() -> None:
            self.guarded(context, callback)
            if after is not None:
                after()

        key = (due_ns, _CALL, context.bus.index, _FROM_OUTSIDE, 0, self._calls)
        heapq.heappush(self._events, (key, act))

    def _deliver(self, bus: Bus, channel: Channel, message: Message, writer: int, name: str) -> None:
        if bus.taps:
            self.show(bus, channel.topic, message, self.now_ns, name)
        if channel.is_latched:
            channel.keep(writer, message)
        for subscription in channel.subscriptions:
            subscription.context.receive(channel.topic, message)
        for subscription in channel.subscriptions:
            self.guarded(subscription.context, lambda s=subscription: s.callback(message))  # type: ignore[misc]
