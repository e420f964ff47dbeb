"""Large arrays that go back to the system when nobody holds them any more."""

from __future__ import annotations

import ctypes
import sys

LARGE = 4 << 20  # bytes: maps of more than 2000 m2, and what is made of them for a moment
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)


def give_back_large_arrays() -> bool:
    """Ask the C library to map arrays of more than `LARGE` bytes by themselves, for the whole process; returns whether it does.

    That of GNU does so at first, but takes each that is dropped for a sign that more of its size will come, up to 32 MB, and keeps room for them
    between smaller things, where it cannot be given back. Others are left as they are.
    """
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    # The first call alone would also make it give back the end of the heap after every little thing.
    return bool(mallopt(_MMAP_THRESHOLD, LARGE) and mallopt(_TRIM_THRESHOLD, 4 * LARGE))
