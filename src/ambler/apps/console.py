"""What a person reads in the terminal while a robot works: a line that is rewritten, or now and then a new one."""

from __future__ import annotations

import sys
import time


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
