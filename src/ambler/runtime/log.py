"""The structured log: one JSON object per line with stamp, run, node, code, text and free fields.

Lines are written on a thread of their own. A full or broken disk loses lines and counts them; it never reaches who logs.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ambler.runtime.conveyor import Conveyor

Record = dict[str, Any]
Listener = Callable[[Record], None]

MAX_BYTES = 32 << 20
_CAPACITY = 4096
_PATIENCE = 10.0


class RunLog:
    """Writes log lines to a file (or nowhere) and to listeners such as a console or a test; safe from any thread.

    When the file has grown to `max_bytes` it becomes `<stem>.1<suffix>`, replacing an older one, and a new one begins.
    A full queue makes `write` wait, unless `never_block` was called. Raises OSError when the file cannot be made.
    """

    def __init__(self, path: Path | None = None, run: str = "", *, max_bytes: int = MAX_BYTES) -> None:
        self.troubles: dict[str, int] = {}
        self._file = _LogFile(path, max_bytes) if path else None
        self._run = run
        self._listeners: list[Listener] = []
        self._conveyor: Conveyor[Record] | None = None
        self._is_lossy = self._is_closed = False
        self._lock = threading.Lock()

    @property
    def lost(self) -> int:
        """How many lines a full queue or a full disk lost so far."""
        return (self._file.lost if self._file else 0) + (self._conveyor.dropped if self._conveyor else 0)

    def never_block(self) -> None:
        """From now on drop and count lines when the queue is full: a robot must not wait for a disk."""
        self._is_lossy = True
        if self._conveyor is not None:
            self._conveyor.is_lossy = True

    def listen(self, listener: Listener) -> None:
        """Call `listener` with every record from now on, on the thread of the log; what it raises is counted in `troubles`."""
        self._listeners.append(listener)

    def write(self, stamp_ns: int, node: str, code: str, text: str, **fields: Any) -> None:
        """Append one record; never raises."""
        if self._file is None and not self._listeners:
            return
        record = {"stamp_ns": stamp_ns, "run": self._run, "node": node, "code": code, "text": text, **fields}
        conveyor = self._conveyor or self._start()
        conveyor.put(record)

    def flush(self, timeout: float = _PATIENCE) -> bool:
        """Wait until every line so far is written and heard; returns False after `timeout` seconds."""
        return self._conveyor is None or self._conveyor.flush(timeout)

    def close(self) -> None:
        """Write what waits and close the file. Lines that come later are lost."""
        if self._is_closed:
            return
        self._is_closed = True
        is_done = self._conveyor is None or self._conveyor.close(_PATIENCE)
        if self._file is not None and is_done:
            if self.lost:
                self._file.write({"run": self._run, "code": "LOG_LINES_LOST", "text": f"{self.lost} lines were lost"})
            self._file.close()

    def _start(self) -> Conveyor[Record]:
        with self._lock:
            if self._conveyor is None:
                self._conveyor = Conveyor("log", self._put, _CAPACITY, self._note, is_lossy=self._is_lossy)
                if self._is_closed:
                    self._conveyor.close(0.0)
            return self._conveyor

    def _put(self, record: Record) -> None:
        if self._file is not None:
            self._file.write(record)
        for listener in tuple(self._listeners):
            try:
                listener(record)
            except Exception as error:  # noqa: BLE001  (one listener's fault must not keep the line from the others)
                self._note(f"listener: {type(error).__name__}")

    def _note(self, text: str) -> None:
        self.troubles[text] = self.troubles.get(text, 0) + 1


class _LogFile:
    """Lines in a file, unbuffered, so that a process that dies has written what it said. Survives OSError and counts in `lost`."""

    def __init__(self, path: Path, max_bytes: int) -> None:
        self.lost = 0
        self._path = path
        self._max_bytes = max_bytes
        self._size = 0
        self._is_torn = False
        self._stream = path.open("wb", buffering=0)

    def write(self, record: Record) -> None:
        line = (json.dumps(record, default=str) + "\n").encode()
        try:
            if self._size and self._size + len(line) > self._max_bytes:
                self._rotate()
            if self._is_torn:
                line = b"\n" + line
            written = self._stream.write(line) or 0
        except OSError:
            self.lost += 1
            return
        self._size += written
        self._is_torn = written < len(line)
        self.lost += self._is_torn

    def close(self) -> None:
        self._stream.close()

    def _rotate(self) -> None:
        os.replace(self._path, self._path.with_suffix(f".1{self._path.suffix}"))
        fresh = self._path.open("wb", buffering=0)
        self._stream.close()
        self._stream, self._size, self._is_torn = fresh, 0, False
