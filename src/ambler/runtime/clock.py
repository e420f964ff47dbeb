"""Clocks. Nodes never see one directly: the executor owns time and hands out `now_ns`."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Time in nanoseconds."""

    @property
    def now_ns(self) -> int: ...


class SystemClock:
    """The wall clock of a real robot, or (from_zero) the time since the start of a simulated run; monotonic in both cases."""

    def __init__(self, *, from_zero: bool) -> None:
        self._start_ns = time.time_ns()
        self._monotonic_start_ns = time.monotonic_ns()
        self._offset_ns = (0 if from_zero else self._start_ns) - self._monotonic_start_ns

    @property
    def now_ns(self) -> int:
        return time.monotonic_ns() + self._offset_ns

    @property
    def drift(self) -> float:
        """How far the system's time of day has moved away from this clock since the start, seconds: somebody set it, or it was slewed."""
        return (time.time_ns() - self._start_ns - (time.monotonic_ns() - self._monotonic_start_ns)) * 1e-9


class SimulatedClock:
    """A clock that the executor sets. With a `rate` it waits so that simulated time runs at that multiple of real time."""

    def __init__(self, start_ns: int = 0, rate: float | None = None) -> None:
        self._now_ns = start_ns
        self._start_ns = start_ns
        self._rate = rate
        self._started = time.monotonic()

    @property
    def now_ns(self) -> int:
        return self._now_ns

    def pace(self, rate: float | None) -> None:
        """From now on run at a multiple of real time, or (None) as fast as possible."""
        self._rate = rate
        self._start_ns = self._now_ns
        self._started = time.monotonic()

    def advance(self, to_ns: int) -> None:
        """Set the time, never backwards."""
        if to_ns < self._now_ns:
            raise ValueError(f"time cannot run backwards: {to_ns} < {self._now_ns}")
        self._now_ns = to_ns
        if self._rate is not None:
            due = self._started + (to_ns - self._start_ns) * 1e-9 / self._rate
            delay = due - time.monotonic()
            if delay > 0:
                time.sleep(delay)


class ReplayClock(SimulatedClock):
    """Follows the times of a recording, beginning at its first message."""
