"""How much of one processor core the process of a live run takes, as a whole and by its threads: what they computed, over the time that went by."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

LEAST_PCT = 0.05
"""Threads that take less are not told."""


@dataclass(frozen=True, slots=True)
class ProcessorTimes:
    """Seconds: of the wall clock, computed by this process without its children, and by each of its threads, named and told apart by their numbers."""

    wall: float
    process: float
    threads: Mapping[tuple[str, int], float]


def processor_times() -> ProcessorTimes:
    """Return the times now; those of single threads only where the system tells them."""
    threads: dict[tuple[str, int], float] = {}
    if hasattr(time, "pthread_getcpuclockid"):
        for thread in threading.enumerate():
            if thread.ident is None:
                continue
            try:
                seconds = time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
            except OSError:
                continue  # it has just ended
            threads[thread.name, thread.ident] = seconds
    return ProcessorTimes(time.monotonic(), time.process_time(), threads)


def shares(begin: ProcessorTimes, end: ProcessorTimes) -> dict[str, float]:
    """Return `processor_pct`, `processor_seconds` (s, the time between the two), and `thread_<name>_pct` of every thread worth telling, those of the most first."""
    seconds = end.wall - begin.wall
    taken: dict[str, float] = {}
    for thread, total in end.threads.items():
        name = plain(thread[0])
        taken[name] = taken.get(name, 0.0) + 100.0 * (total - begin.threads.get(thread, 0.0)) / seconds
    told = sorted(((pct, name) for name, pct in taken.items() if pct >= LEAST_PCT), reverse=True)
    return {
        "processor_seconds": seconds,
        "processor_pct": 100.0 * (end.process - begin.process) / seconds,
        **{f"thread_{name}_pct": pct for pct, name in told},
    }


def plain(name: str) -> str:
    """Return a thread's name as part of a field's: that of a link is the end of its place, that of a pool without the worker's number."""
    last = re.sub(r"_\d+$", "", name.rpartition("/")[2])
    return re.sub(r"[^a-z0-9]+", "_", last.lower()).strip("_")
