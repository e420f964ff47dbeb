"""The most memory that this process has held."""

from __future__ import annotations

import re
import resource
import sys
from pathlib import Path

STATUS = Path("/proc/self/status")


def peak_memory_mb(status: Path = STATUS) -> float:
    """Return the peak resident memory of this process, MB (10^6 bytes).

    Of Linux the peak of the process's own memory is asked: what `getrusage` tells there is at least what the process that started it
    held at that moment, for it survives `exec`. Where there is no such file `getrusage` has to do.
    """
    try:
        told = re.search(r"^VmHWM:\s+(\d+) kB$", status.read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:
        told = None
    if told is not None:
        return int(told[1]) * 1024e-6
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit * 1e-6
