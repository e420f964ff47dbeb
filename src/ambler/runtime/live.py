"""The live executor: the wall clock, one thread per node, bounded queues that drop the oldest and count it.

Nothing of a run waits for who watches it: messages are delivered first; a thread of its own then shows them to the taps.
"""

from __future__ import annotations

import gc
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from ambler.core.messages import Message, OutsideCall
from ambler.runtime.bus import Bus, Channel, Subscription
from ambler.runtime.clock import Clock, SystemClock
from ambler.runtime.context import NodeContext
from ambler.runtime.conveyor import Conveyor
from ambler.runtime.door import OutsideDoor
from ambler.runtime.executor import EXTERNAL, Executor
from ambler.runtime.log import RunLog
from ambler.runtime.mailbox import Mailbox
from ambler.runtime.node import WorkKind
from ambler.runtime.stack import Stack
from ambler.runtime.topics import OUTSIDE_CALLS, Topic

T = TypeVar("T")
_GRACE = 1.0
_SHORT_NS = 10_000_000
_PATIENCE = 5.0
_TAP_CAPACITY = 20_000
_SWITCH_INTERVAL = 0.0005
_PRIORITY, _PRIORITY_BEHIND = -10, -5
_CLOCK_JUMP = 0.1
_Shown = tuple[Bus, Topic[Any], Message, int, str]


def _step_behind() -> None:
    """Let the threads that command go before this one, and this one still before other processes, where that is permitted."""
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _PRIORITY_BEHIND)


class LiveExecutor(Executor):
    """Runs stacks in real time; nodes run in parallel, each one alone in its thread. Real robots give it a clock that tells the
    time of day: `SystemClock(from_zero=False)`. Taps are called on one thread beside the run, up to some hundredths of a second
    after delivery; when they fall behind by 20 000 messages, the newest are not shown and counted in `tap_drops`."""

    begin_background = staticmethod(_step_behind)

    def __init__(
        self,
        stacks: Stack | Sequence[Stack],
        clock: Clock | None = None,
        log: RunLog | None = None,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        super().__init__(stacks, log, on_failure)
        self.clock = clock if clock is not None else SystemClock(from_zero=True)
        self.tap_drops: dict[str, int] = {}
        self.log.never_block()
        self._mailboxes = {context: Mailbox() for context in self._everybody()}
        self._teller: Conveyor[_Shown] | None = None
        self._stopped = threading.Event()
        self._is_stopped_by_hand = False
        self._grace: threading.Timer | None = None

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns

    @property
    def drops(self) -> dict[str, int]:
        """How many messages full queues lost so far, by `node/topic`."""
        return {
            f"{context.name}/{topic}": count
            for context, box in self._mailboxes.items()
            for topic, count in box.drops.items()
        }

    def run(self, duration: float | None = None) -> None:
        """Run until `duration` seconds are over or `stop` is called; may be called again. Raises NodeFailedError."""
        self._stopped.clear()
        self._is_stopped_by_hand = False
        with _undisturbed():
            gc.collect()
            gc.freeze()  # what was there before is not searched for garbage during the run: that took up to 100 ms
            try:
                self.start_nodes()
                self._run_threads(duration)
            finally:
                gc.unfreeze()
        self._flush()
        self.end_run(is_over=self._is_stopped_by_hand)

    def _run_threads(self, duration: float | None) -> None:
        threads = []
        for context, box in self._mailboxes.items():
            box.open()
            threads.append(threading.Thread(target=self._work, args=(context, box), name=context.name, daemon=True))
        for thread in threads:
            thread.start()
        try:
            self._wait(duration)
        finally:
            self._stopped.set()
            for box in self._mailboxes.values():
                box.close()
            for thread in threads:
                thread.join()

    def _wait(self, duration: float | None) -> None:
        """Wait for the end, and look after the clock meanwhile."""
        end = math.inf if duration is None else time.monotonic() + duration
        drift = self._drift()
        while not self._stopped.wait(max(0.0, min(1.0, end - time.monotonic()))) and time.monotonic() < end:
            moved = self._drift() - drift
            if abs(moved) > _CLOCK_JUMP:
                drift += moved
                self.troubles.note(
                    "CLOCK_JUMPED", f"the system's time of day moved by {moved:+.3f} s; this run keeps its own"
                )

    def _drift(self) -> float:
        return self.clock.drift if isinstance(self.clock, SystemClock) else 0.0

    def close(self) -> None:
        if self._grace is not None:
            self._grace.cancel()
        super().close()
        if self._teller is not None:
            self._teller.close(_PATIENCE)
        for name, count in self.drops.items():
            self.log_line("executor", "MESSAGES_DROPPED", f"{name} lost {count} messages", count=count)
        for name, count in self.tap_drops.items():
            self.log_line("executor", "TAPS_BEHIND", f"{count} messages of {name} were not shown", count=count)

    def subscribe(self, channel: Channel, subscription: Subscription) -> None:
        with channel.lock:
            channel.subscriptions = (*channel.subscriptions, subscription)
            for writer, kept in sorted(channel.kept.items()):
                self._mailboxes[subscription.context].put_message(subscription, channel.topic, kept, writer)

    def send(self, channel: Channel, message: Message, writer: NodeContext, number: int) -> None:
        self._deliver(writer.bus, channel, message, writer.index, writer.node.name)

    def post(self, context: NodeContext, delay_ns: int, callback: Callable[[], None]) -> None:
        box = self._mailboxes[context]
        if delay_ns <= context.latency_ns or delay_ns < _SHORT_NS:
            box.put_call(callback)
        else:
            box.put_timer(self.now_ns + delay_ns, callback)

    def post_outside(self, door: OutsideDoor, callback: Callable[[], None]) -> None:
        self._mailboxes[door.context].put_call(callback)

    def show_outside(self, bus: Bus, call: OutsideCall) -> None:
        self._tell(bus, OUTSIDE_CALLS, call, self.now_ns, EXTERNAL)

    def add_timer(
        self, context: NodeContext, period_ns: int, phase_ns: int, callback: Callable[[], None], number: int
    ) -> None:
        """Run a callback at start + k * period; instants that were missed are left out, those that follow keep their place."""
        box = self._mailboxes[context]
        due = [self.now_ns + period_ns + phase_ns]

        def fire() -> None:
            missed = max(0, self.now_ns - due[0]) // period_ns
            due[0] += (missed + 1) * period_ns
            box.put_timer(due[0], fire)
            callback()

        box.put_timer(due[0], fire)

    def run_in_background(
        self, context: NodeContext, work: Callable[[], T], duration_ns: int, done: Callable[[T], None], kind: WorkKind
    ) -> None:
        def hand_over(future: Future[T]) -> None:
            if not future.cancelled():
                self.post(context, 0, lambda: done(future.result()))

        self.pool(context, kind).submit(work).add_done_callback(hand_over)

    def inject(self, topic: Topic[Any], message: Message, prefix: str = "") -> None:
        bus = self._bus(prefix)
        self._deliver(bus, bus.channel(topic), message, -1, EXTERNAL)

    def stop(self) -> None:
        self._is_stopped_by_hand = True
        self._stopped.set()

    def after_failure(self) -> None:
        with self._failing:
            if self._grace is not None:
                return
            self._grace = threading.Timer(_GRACE, self.stop)
        self._grace.daemon = True
        self._grace.start()

    def _everybody(self) -> list[NodeContext]:
        return [*self.contexts, *(door.context for door in self._doors.values())]

    def _deliver(self, bus: Bus, channel: Channel, message: Message, writer: int, name: str) -> None:
        now_ns = self.now_ns
        if channel.is_latched:
            with channel.lock:
                channel.keep(writer, message)
                self._hand_out(channel, message, writer)
        else:
            self._hand_out(channel, message, writer)
        self._tell(bus, channel.topic, message, now_ns, name)

    def _hand_out(self, channel: Channel, message: Message, writer: int) -> None:
        for subscription in channel.subscriptions:
            self._mailboxes[subscription.context].put_message(subscription, channel.topic, message, writer)

    def _tell(self, bus: Bus, topic: Topic[Any], message: Message, now_ns: int, writer: str) -> None:
        if bus.taps and not self._conveyor().put((bus, topic, message, now_ns, writer)):
            with self._failing:
                self.tap_drops[topic.name] = self.tap_drops.get(topic.name, 0) + 1

    def _conveyor(self) -> Conveyor[_Shown]:
        if self._teller is None:
            with self._failing:
                if self._teller is None:
                    self._teller = Conveyor(
                        "taps",
                        lambda shown: self.show(*shown),
                        _TAP_CAPACITY,
                        lambda text: self.troubles.note("TAP_FAILED", text),
                        is_lossy=True,
                    )
        return self._teller

    def _flush(self) -> None:
        if self._teller is not None and not self._teller.flush(_PATIENCE):
            self.troubles.note("TAPS_STUCK", f"what watches the run did not end within {_PATIENCE} s")
        self.log.flush(_PATIENCE)

    def _work(self, context: NodeContext, box: Mailbox) -> None:
        if not context.node.commands:
            _step_behind()
        while True:
            task = box.take(lambda: self.clock.now_ns)
            if task is None:
                return
            self.guarded(context, task)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let threads take turns often, and let this process go before others where that is permitted; both end with the run."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL)
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, min(before, _PRIORITY))  # of this thread; threads that it starts inherit it
    try:
        yield
    finally:
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, before)
        sys.setswitchinterval(interval)
