"""Memory that goes back to the system when nobody holds it any more."""

from __future__ import annotations

import ctypes
import sys
import threading
import time
from collections.abc import Callable
from functools import cache

LARGE = 4 << 20  # bytes: maps of more than 2000 m2, and what is made of them for a moment
HOLES_PERIOD = 20.0  # seconds
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)


@cache
def keep_memory_small() -> None:
    """Let this process give back what it does not need, as long as it lives. Again it does nothing."""
    give_back_large_arrays()
    give_back_holes_every(HOLES_PERIOD)


def give_back_large_arrays() -> bool:
    """Ask the C library to map arrays of more than `LARGE` bytes by themselves, for the whole process; returns whether it does.

    That of GNU does so at first, but takes each that is dropped for a sign that more of its size will come, up to 32 MB, and keeps room for them
    between smaller things, where it cannot be given back. Others are left as they are.
    """
    mallopt = _of_the_c_library("mallopt")
    if mallopt is None:
        return False
    # The first call alone would also make it give back the end of the heap after every little thing.
    return bool(mallopt(_MMAP_THRESHOLD, LARGE) and mallopt(_TRIM_THRESHOLD, 4 * LARGE))


def give_back_holes() -> None:
    """Give the system the pages that lie unused between smaller things in the C library's heap: some milliseconds."""
    trim = _of_the_c_library("malloc_trim")
    if trim is not None:
        trim(0)


def give_back_holes_every(seconds: float) -> None:
    """Do that again and again, on a thread of its own, as long as the process lives: an hour of maps that grow leaves a third of the heap in holes."""

    def work() -> None:
        while True:
            time.sleep(seconds)
            give_back_holes()

    threading.Thread(target=work, name="memory", daemon=True).start()


def _of_the_c_library(name: str) -> Callable[..., int] | None:
    return getattr(ctypes.CDLL(None), name, None) if sys.platform.startswith("linux") else None
