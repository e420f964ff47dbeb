"""The order in which the beams of a scan were taken, which drivers do not always tell rightly."""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ambler.recordings.log_scans import LogScan


class Sweep(enum.Enum):
    """The order of the beams in time; `NONE` takes all of them at the stamp, `AUTO` asks the recording."""

    AUTO = "auto"
    FORWARD = "forward"
    BACKWARD = "backward"
    NONE = "none"


def swept(scan: LogScan, sweep: Sweep) -> LogScan:
    """Return the scan with its beams in the order of the sweep; stamp, angles and ranges stay what they are."""
    if sweep is Sweep.NONE:
        return replace(scan, beam=np.array([scan.beam[0], scan.beam[1], 0.0]))
    if sweep is Sweep.BACKWARD:
        last = scan.beam[0] + (len(scan.ranges) - 1) * scan.beam[1]
        beam = np.array([last, -scan.beam[1], scan.beam[2]])
        return replace(scan, ranges=np.ascontiguousarray(scan.ranges[::-1]), beam=beam)
    return scan


SweepFinder = Callable[[Sequence[LogScan]], tuple[Sweep, dict[Sweep, float]]]
"""Asks a recording for its sweep: the answer, and how good each hypothesis was, 0 to 1 (empty when there is nothing to decide by)."""
