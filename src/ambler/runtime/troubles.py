"""What goes wrong beside a run: in a recorder, a tap, a listener, the log. It is counted and told, and stops nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable

from ambler.runtime.conveyor import describe


class Troubles:
    """Counts troubles by code and keeps the first text of each; `tell(code, text)` hears the first of each. Safe from any thread."""

    def __init__(self, tell: Callable[[str, str], None]) -> None:
        self.counts: dict[str, int] = {}
        self.texts: dict[str, str] = {}
        self._tell = tell
        self._lock = threading.Lock()

    def note(self, code: str, text: str) -> None:
        """Count one more trouble of this code."""
        with self._lock:
            is_first = code not in self.counts
            self.counts[code] = self.counts.get(code, 0) + 1
            self.texts.setdefault(code, text)
        if is_first:
            self._tell(code, text)

    def attempt(self, code: str, act: Callable[[], object]) -> bool:
        """Do something that is not the run's own business; returns whether it went well. The border where its faults end."""
        try:
            act()
        except Exception as error:  # noqa: BLE001  (a bystander's fault must reach neither a node's turn nor a stop)
            self.note(code, describe(error))
            return False
        return True

    def __bool__(self) -> bool:
        return bool(self.counts)

    def __str__(self) -> str:
        return "; ".join(f"{code} ({self.counts[code]} times): {text}" for code, text in self.texts.items())
