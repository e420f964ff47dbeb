"""How soon a robot acts on what it sees: the time from a scan's last point to the first command that knows of the scan.

A command knows of a scan when all that it was made of had taken in this scan or a later one. A scan that is passed over is known by the first command that
knows of a later one, so that leaving scans out does not make a robot quick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TakenScan:
    """A scan of a live run: its stamp, the instant of its last point, that of its arrival on the bus (ns), and the number of the motion that
    the robot was carrying out then, 0 for none."""

    stamp_ns: int
    end_ns: int
    arrival_ns: int
    motion: int = 0


@dataclass(frozen=True, slots=True)
class KnowingCommand:
    """A command: when it was sent, the stamp of the newest scan that it knows of (ns), and the motion that it carries out."""

    sent_ns: int
    known_ns: int
    motion: int = 0


def reaction_times(scans: Sequence[TakenScan], commands: Sequence[KnowingCommand], *, in_motion: bool) -> F64:
    """Return the seconds from the end of each scan to the first command, in the order of sending, that knows of it; scans that no command knows of are left out.
    `in_motion`: only for scans that came during a motion that still went on at that command, because a robot that has nothing to do asks for no command."""
    known = np.maximum.accumulate(np.array([c.known_ns for c in commands], np.int64)) if commands else np.empty(0)
    first = np.searchsorted(known, np.array([scan.stamp_ns for scan in scans], np.int64))
    pairs = [(scan, commands[k]) for scan, k in zip(scans, first.tolist(), strict=True) if k < len(commands)]
    if in_motion:
        pairs = [(scan, command) for scan, command in pairs if scan.motion != 0 and scan.motion == command.motion]
    return np.array([1e-9 * (command.sent_ns - scan.end_ns) for scan, command in pairs], np.float64)


def summary_ms(name: str, seconds: F64) -> dict[str, float | None]:
    """Return `<name>_median_ms`, `_p95_ms` and `_p99_ms` of times in seconds, None when there are none."""
    shares = {"median": 50.0, "p95": 95.0, "p99": 99.0}
    if len(seconds) == 0:
        return {f"{name}_{what}_ms": None for what in shares}
    return {f"{name}_{what}_ms": 1e3 * float(np.percentile(seconds, share)) for what, share in shares.items()}
