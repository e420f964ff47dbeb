"""A bounded queue that a thread of its own works off, in order: what records, logs and shows, beside a run and never in its way.

Whoever puts something in does nothing but append it: the thread is not woken for each item but looks every few milliseconds, ever less
often while nothing comes, because a thread that wakes wants the interpreter's lock at once, and takes it from the one that drives.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

_IDLE_PERIOD = 0.16  # seconds between looks while nothing comes


class Conveyor(Generic[T]):
    """Calls `work(item)` for each item on a daemon thread. When `capacity` items wait, `put` waits too, or (`is_lossy`) refuses.

    Whatever `work` raises is told to `on_trouble` in one sentence, and the next item is worked on: no fault gets back to a run.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[T], None],
        capacity: int,
        on_trouble: Callable[[str], None],
        *,
        is_lossy: bool = False,
        period: float = 0.01,
    ) -> None:
        """`period`: seconds between looks for something to do."""
        self.is_lossy = is_lossy
        self.dropped = 0
        self._work = work
        self._capacity = capacity
        self._period = period
        self._on_trouble = on_trouble
        self._items: deque[T | threading.Event] = deque()
        self._wake = threading.Event()
        self._space = threading.Condition()
        self._is_closing = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, item: T) -> bool:
        """Hand an item over; returns False when it was dropped: the queue is full and lossy, or closed. Safe from any thread."""
        if self._is_closing:
            return False
        if len(self._items) >= self._capacity:
            if self.is_lossy or threading.current_thread() is self._thread:
                self.dropped += 1
                return False
            self._wait_for_space()
        self._items.append(item)
        return True

    def flush(self, timeout: float | None = None) -> bool:
        """Wait until everything put in so far is done; returns False after `timeout` seconds."""
        if not self._thread.is_alive() or threading.current_thread() is self._thread:
            return True
        mark = threading.Event()
        self._items.append(mark)
        self._wake.set()
        return mark.wait(timeout)

    def close(self, timeout: float | None = None, *last: T) -> bool:
        """Finish what waits, then `last`, and end the thread; returns False when that took longer than `timeout` seconds."""
        self._items.extend(last)
        self._is_closing = True
        self._wake.set()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _wait_for_space(self) -> None:
        self._wake.set()
        with self._space:
            self._space.wait_for(lambda: len(self._items) <= self._capacity // 2 or not self._thread.is_alive())

    def _run(self) -> None:
        period = self._period
        while True:
            is_last = self._is_closing
            period = self._period if self._items else min(2.0 * period, max(self._period, _IDLE_PERIOD))
            self._work_off()
            if is_last:
                return
            self._wake.wait(period)
            self._wake.clear()

    def _work_off(self) -> None:
        while self._items:
            item = self._items.popleft()
            if isinstance(item, threading.Event):
                item.set()
            else:
                self._attempt(item)
            if len(self._items) <= self._capacity // 2:
                with self._space:
                    self._space.notify_all()

    def _attempt(self, item: T) -> None:
        try:
            self._work(item)
        except Exception as error:  # noqa: BLE001  (a fault beside the run must not end what records, logs and shows)
            self._on_trouble(describe(error))


def describe(error: BaseException) -> str:
    """Return the kind and the text of an error, of one that cannot say its text too."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001  (text made by foreign code, on the way to a stop)
        return f"{type(error).__name__} (without a readable text)"
