"""The memory that this process holds, and the most that it has held."""

from __future__ import annotations

import re
import resource
import sys
from contextlib import suppress
from pathlib import Path

from ambler.core.errors import BadInputError

STATUS = Path("/proc/self/status")
_CLEAR, _CLEAR_PEAK = Path("/proc/self/clear_refs"), "5"  # proc(5)


def peak_memory_mb(status: Path = STATUS) -> float:
    """Return the peak resident memory of this process, MB (10^6 bytes).

    Of Linux the peak of the process's own memory is asked: what `getrusage` tells there is at least what the process that started it
    held at that moment, for it survives `exec`. Where there is no such file `getrusage` has to do.
    """
    told = _told("VmHWM", status)
    if told is not None:
        return told
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit * 1e-6


def forget_peak() -> None:
    """Let the peak begin anew from what is held now: for a process that does one job after the other. Where the system cannot do that it stays the largest of all."""
    with suppress(OSError):
        _CLEAR.write_text(_CLEAR_PEAK, encoding="ascii")


def memory_mb(status: Path = STATUS) -> float:
    """Return the resident memory of this process now, MB (10^6 bytes); raises BadInputError where the system does not tell it."""
    told = _told("VmRSS", status)
    if told is None:
        raise BadInputError(f"the memory of a process is told by Linux alone: no {status}")
    return told


def _told(name: str, status: Path) -> float | None:
    try:
        told = re.search(rf"^{name}:\s+(\d+) kB$", status.read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:
        return None
    return None if told is None else int(told[1]) * 1024e-6
