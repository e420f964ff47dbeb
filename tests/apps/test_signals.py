"""Signals are heard, also where Python ignores what their handler raises."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from ambler.apps.signals import SIGNALS, Interrupted, on_interrupt, terminate_like_interrupt, was_interrupted


@pytest.fixture(autouse=True)
def own_handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in SIGNALS}
    terminate_like_interrupt()
    yield
    terminate_like_interrupt()
    for number, handler in before.items():
        signal.signal(number, handler)


class Deaf:
    """Python ignores what is raised while it is deleted."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        sum(range(1000))


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_raises_where_nothing_better_is_asked_for(number: signal.Signals) -> None:
    with pytest.raises(Interrupted):
        os.kill(os.getpid(), number)
    assert was_interrupted()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_that_was_lost_ends_the_next_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.unraisablehook", lambda told: None)
    Deaf()
    assert was_interrupted()
    with pytest.raises(Interrupted), on_interrupt(lambda: None):
        raise AssertionError("the run was begun")


def test_the_first_signal_of_a_run_calls_back_and_the_second_raises() -> None:
    heard: list[str] = []

    def run() -> None:
        with on_interrupt(lambda: heard.append("first")):
            os.kill(os.getpid(), signal.SIGINT)
            assert heard == ["first"]
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(Interrupted):
        run()
    assert heard == ["first"]
