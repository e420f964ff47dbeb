"""How long a piece of work takes, in milliseconds of any clock: one call, or the median of some."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

Clock = Callable[[], float]


def elapsed_ms(work: Callable[[], object], clock: Clock = time.perf_counter) -> float:
    """Return the time of one call; `time.process_time` and `time.thread_time` leave out what others do on the machine."""
    begin = clock()
    work()
    return 1e3 * (clock() - begin)


def median_ms(
    work: Callable[[], object], runs: int, clock: Clock = time.perf_counter, *, uncounted_runs: int = 0
) -> float:
    """Return the median time of `runs` calls, after some that do not count (caches, kernels, first allocations)."""
    for _ in range(uncounted_runs):
        work()
    return statistics.median(elapsed_ms(work, clock) for _ in range(runs))
