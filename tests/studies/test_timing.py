"""Times are told in milliseconds of the clock that is given, and runs that do not count are not counted."""

from __future__ import annotations

import pytest

from ambler.studies.timing import elapsed_ms, median_ms


class Work:
    """Moves its own clock on by a given number of seconds at each call."""

    def __init__(self, *seconds: float) -> None:
        self.now = 100.0
        self._left = list(seconds)

    def __call__(self) -> None:
        self.now += self._left.pop(0)

    def clock(self) -> float:
        return self.now


def test_one_call() -> None:
    work = Work(0.25)
    assert elapsed_ms(work, work.clock) == pytest.approx(250.0)


def test_the_median_leaves_out_what_does_not_count() -> None:
    work = Work(9.0, 9.0, 0.003, 0.001, 0.002)
    assert median_ms(work, 3, work.clock, uncounted_runs=2) == pytest.approx(2.0)
