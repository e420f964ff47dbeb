"""The structured log: one JSON object per line with stamp, run, node, code, text and free fields."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

Listener = Callable[[dict[str, Any]], None]


class RunLog:
    """Writes log lines to a file (or nowhere) and to listeners such as a console or a test; safe from any thread."""

    def __init__(self, path: Path | None = None, run: str = "") -> None:
        self._file: TextIO | None = path.open("w", encoding="utf-8") if path else None
        self._run = run
        self._lock = threading.Lock()
        self._listeners: list[Listener] = []

    def listen(self, listener: Listener) -> None:
        """Call `listener` with every record from now on."""
        self._listeners.append(listener)

    def write(self, stamp_ns: int, node: str, code: str, text: str, **fields: Any) -> None:
        """Append one record."""
        record = {"stamp_ns": stamp_ns, "run": self._run, "node": node, "code": code, "text": text, **fields}
        with self._lock:
            if self._file is not None:
                self._file.write(json.dumps(record, default=str) + "\n")
                self._file.flush()
            for listener in self._listeners:
                listener(record)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
