"""Ctrl-C and SIGTERM (containers, systemd, `timeout`) end a run in order: what can be finished is finished."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)
_heard: list[int] = []  # signals that were raised as Interrupted


class Interrupted(KeyboardInterrupt):
    """A signal came. A class of its own: after a KeyboardInterrupt itself in the middle of an import
    CPython may end the process by SIGINT, whatever code it was to exit with."""


def terminate_like_interrupt() -> None:
    """Let Ctrl-C and SIGTERM raise Interrupted wherever nothing better is asked for; see also `was_interrupted`."""
    _heard.clear()

    def handle(number: int, frame: FrameType | None) -> None:
        _heard.append(number)
        raise Interrupted

    if threading.current_thread() is threading.main_thread():
        for number in SIGNALS:
            signal.signal(number, handle)


def was_interrupted() -> bool:
    """Say whether a signal raised Interrupted. Where Python ignores what is raised (in the middle of some imports) nobody else hears of it."""
    return bool(_heard)


@contextmanager
def on_interrupt(callback: Callable[[], None]) -> Iterator[None]:
    """Call back for the first signal within the block, instead of raising; a second one raises Interrupted. Outside of the main
    thread, where signals never come, it does nothing. Raises Interrupted for a signal that came before and was lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    if was_interrupted():
        raise Interrupted
    seen: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        if seen:
            raise Interrupted
        seen.append(number)
        callback()

    before: dict[signal.Signals, Any] = {number: signal.signal(number, handle) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
