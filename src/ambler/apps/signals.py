"""Ctrl-C and SIGTERM (containers, systemd, `timeout`) end a run in order: what can be finished is finished."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def terminate_like_interrupt() -> None:
    """Let SIGTERM raise KeyboardInterrupt, as Ctrl-C does, wherever nothing better is asked for."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)


@contextmanager
def on_interrupt(callback: Callable[[], None]) -> Iterator[None]:
    """Call back for the first signal within the block, instead of raising; a second one raises KeyboardInterrupt. Outside of the main
    thread, where signals never come, it does nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    seen: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        if seen:
            raise KeyboardInterrupt
        seen.append(number)
        callback()

    before: dict[signal.Signals, Any] = {number: signal.signal(number, handle) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
