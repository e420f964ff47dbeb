"""Finds the value that stands for "nothing came back" in the readings of a scanner that nobody describes.

Scanners report a code at the end of their range there: 81.91 of a SICK, 8.191 of one in mm mode, 4.095 of a Hokuyo. Such readings pile up
at the largest value, on few values, and far more of them than just beneath, in many beams. Walls do not: their ranges spread as the robot moves,
noise makes the largest one rare, and what a robot at rest sees farthest away lies in a few beams.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

_GLITCHES = 0.0005  # share of readings above all others that are left out of account
_TOP = 0.995  # codes of one scanner lie within half a percent: 81.83, 81.87, 81.91
_BENEATH = 0.95
_SMALLEST_SHARE = 0.001
_FEWEST = 20
_FEWEST_BEAMS = 0.05  # of a scanner's, in which the code comes up
_BEYOND = 0.01  # share of readings beyond a range that is told, and none of them a code, from which on it is not the scanner's
_CODES = 10
_COMMONEST = 0.5  # of the readings at the top; walls of public logs stay below, codes reach 0.8 to 1


def find_no_return(ranges: NDArray[np.float32], beams: NDArray[np.int64]) -> float | None:
    """Return the range in metres from which on readings are no returns, or None where the largest ones may be walls.

    `ranges` (N,) are all readings of one scanner over a whole recording, metres, `beams` (N,) the numbers of their beams.
    """
    is_measured = np.isfinite(ranges) & (ranges > 0.0)
    ranges, beams = ranges[is_measured], beams[is_measured]
    if len(ranges) < _FEWEST:
        return None
    place = len(ranges) - 1 - int(_GLITCHES * len(ranges))
    largest = float(np.partition(ranges, place)[place])
    is_top = (ranges >= _TOP * largest) & (ranges <= largest / _TOP)
    top = ranges[is_top]
    beneath = np.count_nonzero((ranges >= _BENEATH * largest) & (ranges < _TOP * largest))
    if len(top) < max(_FEWEST, _SMALLEST_SHARE * len(ranges)) or len(top) <= beneath:
        return None
    if len(np.unique(beams[is_top])) < _FEWEST_BEAMS * len(np.unique(beams)):
        return None
    _, counts = np.unique(top, return_counts=True)
    return _TOP * largest if counts.max() >= _COMMONEST * len(top) else None


def beam_numbers(scans: Iterable[NDArray[np.float32]]) -> NDArray[np.int64]:
    """Return the numbers of the beams of scans that are laid behind each other, int64 (N,)."""
    return np.concatenate([np.arange(len(ranges)) for ranges in scans])


def is_exceeded(told: float, ranges: NDArray[np.float32]) -> bool:
    """Say whether many readings lie beyond a range (m) that is told, and are no codes: then it is that of a program, not of the scanner.

    `ranges` (N,) are the readings of one scanner over a whole recording that may be returns, metres.
    """
    beyond = ranges[np.isfinite(ranges) & (ranges > told)]
    if len(beyond) <= _BEYOND * len(ranges):
        return False
    _, counts = np.unique(beyond, return_counts=True)
    return float(np.sort(counts)[-_CODES:].sum()) < _COMMONEST * len(beyond)
