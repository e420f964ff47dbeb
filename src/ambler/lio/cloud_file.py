"""Points that lie on the disk until somebody asks for them: a scanner sees hundreds of megabytes per kilometre, of which a match wants two places."""

from __future__ import annotations

import os
import tempfile
import threading
import weakref
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


class KeptPoints(Protocol):
    """Points float32 (M, 3) that are kept somewhere."""

    def read(self) -> F32:
        """Return them."""
        ...


class CloudFile:
    """A temporary file (in `TMPDIR`, else the system's folder) that is gone when nobody uses it any more. What the disk refuses stays in memory.

    `put` and reading may be called in several threads.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._end = 0
        self._descriptor: int | None = None

    def put(self, points: F32) -> KeptPoints:
        """Keep points float32 (M, 3)."""
        data = np.ascontiguousarray(points, np.float32)
        with self._lock:
            try:
                self._write(data.tobytes())
            except OSError:
                return _HeldPoints(data)
            begin, self._end = self._end, self._end + data.nbytes
        return _FiledPoints(self, begin, len(data))

    def read(self, begin: int, count: int) -> F32:
        """Return `count` points float32 (count, 3) from byte `begin` on."""
        assert self._descriptor is not None
        out = np.empty((count, 3), np.float32)
        view, done = out.reshape(-1).view(np.uint8).data, 0
        while done < len(view):
            got = os.preadv(self._descriptor, [view[done:]], begin + done)
            if got == 0:
                raise OSError(f"the temporary file of points ends after {begin + done} bytes")
            done += got
        return out

    def _write(self, data: bytes) -> None:
        if self._descriptor is None:
            self._descriptor, name = tempfile.mkstemp(prefix="ambler-points-")
            weakref.finalize(self, os.close, self._descriptor)
            os.unlink(name)
        done, view = 0, memoryview(data)
        while done < len(view):
            done += os.pwrite(self._descriptor, view[done:], self._end + done)


@dataclass(frozen=True, slots=True, eq=False)
class _FiledPoints:
    """Points of a file."""

    file: CloudFile
    begin: int
    count: int

    def read(self) -> F32:
        return self.file.read(self.begin, self.count)


@dataclass(frozen=True, slots=True, eq=False)
class _HeldPoints:
    """Points in memory, for which the disk had no room."""

    points: F32

    def read(self) -> F32:
        return self.points
