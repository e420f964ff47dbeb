"""The live executor: the wall clock, one thread per node, bounded queues that drop the oldest and count it."""

from __future__ import annotations

import heapq
import sys
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from ambler.core.messages import Message
from ambler.runtime.clock import Clock, SystemClock
from ambler.runtime.executor import EXTERNAL, Executor, NodeContext, Subscription
from ambler.runtime.log import RunLog
from ambler.runtime.stack import Stack
from ambler.runtime.topics import Topic

T = TypeVar("T")
_GRACE = 1.0


class _Mailbox:
    """What waits for one node: messages per subscription, calls, timers. `drops` counts what a full queue lost, by topic."""

    def __init__(self) -> None:
        self.condition = threading.Condition()
        self.queue: deque[tuple[Subscription | None, Topic[Any] | None, Any]] = deque()
        self.waiting: dict[int, int] = {}
        self.timers: list[tuple[int, int, Callable[[], None]]] = []
        self.drops: dict[str, int] = {}
        self.sequence = 0

    def put_message(self, subscription: Subscription, topic: Topic[Any], message: Message) -> None:
        depth = topic.depth if topic.delivery == "queue" else 1
        key = id(subscription)
        with self.condition:
            if self.waiting.get(key, 0) >= depth:
                self._drop_oldest(subscription)
                if topic.delivery == "queue":
                    self.drops[topic.name] = self.drops.get(topic.name, 0) + 1
            self.waiting[key] = self.waiting.get(key, 0) + 1
            self.queue.append((subscription, topic, message))
            self.condition.notify()

    def put_call(self, callback: Callable[[], None]) -> None:
        with self.condition:
            self.queue.append((None, None, callback))
            self.condition.notify()

    def put_timer(self, due_ns: int, callback: Callable[[], None]) -> None:
        with self.condition:
            self.sequence += 1
            heapq.heappush(self.timers, (due_ns, self.sequence, callback))
            self.condition.notify()

    def _drop_oldest(self, subscription: Subscription) -> None:
        for i, item in enumerate(self.queue):
            if item[0] is subscription:
                del self.queue[i]
                self.waiting[id(subscription)] -= 1
                return


class LiveExecutor(Executor):
    """Runs a stack in real time; nodes run in parallel, each one alone in its thread."""

    def __init__(
        self,
        stack: Stack,
        clock: Clock | None = None,
        log: RunLog | None = None,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        super().__init__(stack, log, on_failure)
        self.clock = clock if clock is not None else SystemClock(from_zero=True)
        self._mailboxes = [_Mailbox() for _ in self.contexts]
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="background")
        self._show_lock = threading.Lock()
        self._stopped = threading.Event()
        self._grace: threading.Timer | None = None

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns

    @property
    def drops(self) -> dict[str, int]:
        """How many messages full queues lost so far, by `node/topic`."""
        return {
            f"{context.node.name}/{topic}": count
            for context, box in zip(self.contexts, self._mailboxes, strict=True)
            for topic, count in box.drops.items()
        }

    def run(self, duration: float | None = None) -> None:
        """Run until `duration` seconds are over or `stop` is called; may be called again. Raises NodeFailedError."""
        previous_interval = sys.getswitchinterval()
        self._stopped.clear()
        sys.setswitchinterval(0.0005)
        self.start_nodes()
        threads = [
            threading.Thread(target=self._work, args=(context, box), name=context.node.name, daemon=True)
            for context, box in zip(self.contexts, self._mailboxes, strict=True)
        ]
        for thread in threads:
            thread.start()
        try:
            self._stopped.wait(duration)
        finally:
            self._stopped.set()
            for box in self._mailboxes:
                with box.condition:
                    box.condition.notify()
            for thread in threads:
                thread.join()
            sys.setswitchinterval(previous_interval)
        if self.failure is not None:
            raise self.failure

    def close(self) -> None:
        if self._grace is not None:
            self._grace.cancel()
        self.stop_nodes()
        self._pool.shutdown(wait=True, cancel_futures=True)
        for name, count in self.drops.items():
            self.log.write(self.now_ns, "executor", "MESSAGES_DROPPED", f"{name} lost {count} messages", count=count)

    def send(self, topic: Topic[Any], message: Message, writer: NodeContext, number: int) -> None:
        self._deliver(topic, message, writer.node.name)

    def post(self, context: NodeContext, delay_ns: int, callback: Callable[[], None]) -> None:
        box = self._mailboxes[context.index]
        if delay_ns <= context.latency_ns or delay_ns < 10_000_000:
            box.put_call(callback)
        else:
            box.put_timer(self.now_ns + delay_ns, callback)

    def add_timer(
        self, context: NodeContext, period_ns: int, phase_ns: int, callback: Callable[[], None], number: int
    ) -> None:
        box = self._mailboxes[context.index]
        due = [self.now_ns + period_ns + phase_ns]

        def fire() -> None:
            due[0] = max(due[0] + period_ns, self.now_ns)
            box.put_timer(due[0], fire)
            callback()

        box.put_timer(due[0], fire)

    def run_in_background(
        self, context: NodeContext, work: Callable[[], T], duration_ns: int, done: Callable[[T], None]
    ) -> None:
        def hand_over(future: Future[T]) -> None:
            if not future.cancelled():
                self.post(context, 0, lambda: done(future.result()))

        self._pool.submit(work).add_done_callback(hand_over)

    def inject(self, topic: Topic[Any], message: Message) -> None:
        self._deliver(topic, message, EXTERNAL)

    def stop(self) -> None:
        self._stopped.set()

    def after_failure(self) -> None:
        if self._grace is None:
            self._grace = threading.Timer(_GRACE, self.stop)
            self._grace.daemon = True
            self._grace.start()

    def _deliver(self, topic: Topic[Any], message: Message, writer: str) -> None:
        with self._show_lock:
            self.show(topic, message, self.now_ns, writer)
        for subscription in self.subscriptions[topic.name]:
            self._mailboxes[subscription.context.index].put_message(subscription, topic, message)

    def _work(self, context: NodeContext, box: _Mailbox) -> None:
        while not self._stopped.is_set():
            task = self._next(context, box)
            if task is not None:
                self.guarded(context, task)

    def _next(self, context: NodeContext, box: _Mailbox) -> Callable[[], None] | None:
        with box.condition:
            wait = 0.1
            if box.timers:
                due_ns, _, callback = box.timers[0]
                wait = min(wait, (due_ns - self.now_ns) * 1e-9)
                if wait <= 0:
                    heapq.heappop(box.timers)
                    return callback
            if not box.queue:
                box.condition.wait(wait)
                return None
            subscription, topic, item = box.queue.popleft()
            if subscription is None or topic is None:
                return item  # type: ignore[no-any-return]
            box.waiting[id(subscription)] -= 1
        context.receive(topic, item)
        return lambda: subscription.callback(item)
