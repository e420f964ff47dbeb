"""What a person reads in the terminal while a robot works: a line that is rewritten, or now and then a new one."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType


class ProgressLine:
    """Shows how far a run is. On a terminal one line is rewritten, elsewhere one is printed every `period` seconds."""

    def __init__(self, period: float = 10.0) -> None:
        self.begin_ns = 0
        """When the run began, by its executor's clock."""
        self._is_terminal = sys.stdout.isatty()
        self._period = 0.5 if self._is_terminal else period
        self._started = time.monotonic()
        self._shown = 0.0
        self._is_open = False

    def show(self, now_ns: int, text: str) -> None:
        """Show a text with the run's time, if the last line is old enough."""
        now = time.monotonic()
        if now - self._shown < self._period:
            return
        self._shown = now
        seconds = (now_ns - self.begin_ns) * 1e-9
        factor = seconds / max(1e-3, now - self._started)
        line = f"{seconds:6.0f} s ({factor:.1f} x real time)  {text}"
        if self._is_terminal:
            print(f"\r{line:<118}", end="", flush=True)
            self._is_open = True
        else:
            print(line, flush=True)

    def close(self) -> None:
        """End the rewritten line."""
        if self._is_open:
            print()
            self._is_open = False


class Stages:
    """Says what is being done, once it takes longer than `patience` seconds, and again every `period`: long work is never silent."""

    def __init__(self, patience: float = 1.5, period: float = 10.0) -> None:
        self._patience, self._period = patience, period
        self._timer: threading.Timer | None = None
        self._lock = threading.Lock()

    def __enter__(self) -> Stages:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._end()

    def begin(self, text: str) -> None:
        """Begin a stage; the one before is over."""
        self._end()
        with self._lock:
            self._tell_after(self._patience, text, time.monotonic())

    def _tell_after(self, seconds: float, text: str, begun: float) -> None:
        timer = threading.Timer(seconds, lambda: self._tell(timer, text, begun))
        timer.daemon = True
        self._timer = timer
        timer.start()

    def _tell(self, timer: threading.Timer, text: str, begun: float) -> None:
        with self._lock:
            if timer is not self._timer:
                return
            print(f"{text} ... {time.monotonic() - begun:.0f} s", flush=True)
            self._tell_after(self._period, text, begun)

    def _end(self) -> None:
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = None
