"""In which order were the beams of a scan taken? Asked of the recording itself.

The message promises that beam i is later than beam i - 1. Drivers of scanners that turn clockwise sort the beams by angle and keep
the promise's sign wrong; then motion compensation doubles the distortion it should remove. Mapping the stretch with the most turning
under each hypothesis shows the truth: under the right one, the returns lie on the walls.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambler.recordings.log_scans import LogScan
from ambler.recordings.sweep import Sweep, swept
from ambler.slam2d.offline import run_offline
from ambler.slam2d.turning import most_turning

EXCERPT = 150
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
    first = most_turning(scans, EXCERPT)
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
