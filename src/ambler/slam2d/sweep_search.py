"""In which order were the beams of a scan taken? Asked of the recording itself.

The message promises that beam i is later than beam i - 1. Drivers of scanners that turn clockwise sort the beams by angle and keep
the promise's sign wrong; then motion compensation doubles the distortion it should remove. Mapping the stretch with the most turning
under each hypothesis shows the truth: under the right one, the returns lie on the walls. Where it turns is told by the odometry, or, without one, by how
far each scan must be shifted to look like the one before.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ambler.core.se2 import wrap_angle
from ambler.recordings.log_scans import LogScan
from ambler.recordings.sweep import Sweep, swept
from ambler.slam2d.offline import run_offline

EXCERPT = 150
TURNING_MIN = 0.5
SHIFT_MAX = 0.5  # radians from one scan to the next
MARGIN = 0.004
MISSES_LEFT = 0.7
ORDERS = (Sweep.FORWARD, Sweep.NONE, Sweep.BACKWARD)
DISTORTIONS = {Sweep.FORWARD: (0.0, 1.0, 4.0), Sweep.NONE: (1.0, 0.0, 1.0), Sweep.BACKWARD: (4.0, 1.0, 0.0)}
"""Of the right order, the square of the distortion that each of `ORDERS` leaves in a scan, in units of what its motion does to it."""


def find_sweep(scans: Sequence[LogScan]) -> tuple[Sweep, dict[Sweep, float]]:
    """Return the sweep and the share of returns on walls under each hypothesis (empty when there is nothing to decide by).

    Forward is believed unless the most likely other one is better by more than `MARGIN` and leaves at most `MISSES_LEFT` of the returns beside the
    walls that forward leaves there.
    """
    if not scans or scans[0].duration <= 0.0:
        return Sweep.FORWARD, {}
    first = _most_turning(scans)
    if first is None:
        return Sweep.FORWARD, {}
    excerpt = scans[first : first + EXCERPT]
    on_walls = {sweep: run_offline(swept(scan, sweep) for scan in excerpt).points_on_walls_ratio for sweep in ORDERS}
    best = most_likely(on_walls)
    gain, misses = on_walls[best] - on_walls[Sweep.FORWARD], 1.0 - on_walls[Sweep.FORWARD]
    is_clear = gain > MARGIN and misses - gain <= MISSES_LEFT * misses
    return (best if is_clear else Sweep.FORWARD), on_walls


def most_likely(on_walls: dict[Sweep, float]) -> Sweep:
    """Return which order explains best how many returns each hypothesis leaves beside the walls: the best of them alone may be so by chance, but if nothing had to be compensated, forward and backward
    would be equally wrong."""
    misses = np.array([1.0 - on_walls[sweep] for sweep in ORDERS])
    residuals = {}
    for sweep, distortion in DISTORTIONS.items():
        basis = np.column_stack((np.ones(3), distortion))
        floor_and_slope = np.linalg.lstsq(basis, misses, rcond=None)[0]
        if floor_and_slope[1] > 0.0:
            residuals[sweep] = float(np.abs(basis @ floor_and_slope - misses).max())
    return min(residuals, key=lambda sweep: residuals[sweep], default=Sweep.FORWARD)


def _most_turning(scans: Sequence[LogScan]) -> int | None:
    """Return where the excerpt with the most turning begins, None when the recording nowhere turns enough to tell."""
    turned = _turned_by_odometry(scans) if any(scan.odometry for scan in scans) else _turned_by_scans(scans)
    total = np.concatenate(([0.0], np.cumsum([0.0, *turned])))
    starts = np.arange(max(1, len(scans) - EXCERPT + 1))
    gains = total[np.minimum(starts + EXCERPT, len(scans))] - total[starts]
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
