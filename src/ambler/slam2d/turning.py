"""Where a recording turns most: told by its odometry, or, without one, by how far each scan must be shifted to look like the one before."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import wrap_angle
from ambler.recordings.log_scans import LogScan

TURNING_MIN = 0.5  # radians, all turns of the excerpt together
SHIFT_MAX = 0.5  # radians from one scan to the next


def most_turning(scans: Sequence[LogScan], count: int) -> int | None:
    """Return where the `count` scans with the most turning begin, None when the recording nowhere turns enough to tell anything by it."""
    turned = _turned_by_odometry(scans) if any(scan.odometry for scan in scans) else _turned_by_scans(scans)
    total = np.concatenate(([0.0], np.cumsum([0.0, *turned])))
    starts = np.arange(max(1, len(scans) - count + 1))
    gains = total[np.minimum(starts + count, len(scans))] - total[starts]
    first = int(np.argmax(gains))
    return first if gains[first] >= TURNING_MIN else None


def _turned_by_odometry(scans: Sequence[LogScan]) -> list[float]:
    """Return how far it turned from each scan to the next, radians."""
    yaws = [scan.odometry[-1][1].yaw if scan.odometry else None for scan in scans]
    return [
        0.0 if before is None or after is None else abs(wrap_angle(after - before))
        for before, after in itertools.pairwise(yaws)
    ]


def _turned_by_scans(scans: Sequence[LogScan]) -> list[float]:
    """Return the turns, in whole beams, after which the ranges correlate best with those of the scan before."""
    turned = []
    for (earlier, before), (later, after) in itertools.pairwise((scan, _spectrum(scan)) for scan in scans):
        beams, step = len(later.ranges), abs(float(later.beam[1]))
        if len(earlier.ranges) != beams:
            turned.append(0.0)
            continue
        shifts = np.fft.fftfreq(beams, 1.0 / beams)
        alike = np.fft.irfft(after * before.conj(), beams)
        alike[np.abs(shifts) * step > SHIFT_MAX] = -np.inf
        turned.append(float(abs(shifts[int(np.argmax(alike))]) * step))
    return turned


def _spectrum(scan: LogScan) -> NDArray[np.complex128]:
    """Return the Fourier transform of the ranges about their mean; where nothing came back they are as far as the scanner sees."""
    far = scan.limits[1]
    ranges = np.clip(np.nan_to_num(scan.ranges, nan=far, posinf=far, neginf=0.0), 0.0, far)
    return np.asarray(np.fft.rfft(ranges - ranges.mean()), np.complex128)
