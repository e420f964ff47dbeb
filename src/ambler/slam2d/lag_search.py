"""How much later are a recording's scans stamped than its odometry? Asked of the recording itself.

Both tell how the robot turned from scan to scan. Where it turns most, the scans are mapped; shifting the odometry in time until both tell the
same turns finds the lag between their stamps. A scan whose beams are all taken at once shows the heading in the middle of its duration, in whichever order they
were taken, so this is asked before the order of the beams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ambler.recordings.lag import Lag, with_later_odometry
from ambler.recordings.log_scans import LogScan
from ambler.recordings.sweep import Sweep, swept
from ambler.slam2d.offline import run_offline
from ambler.slam2d.turning import most_turning

F64 = NDArray[np.float64]

EXCERPT = 150
ROUNDS = 2
"""The first map is made with the odometry as recorded, which draws its headings to the wrong instants."""
LAG_MAX = 1.5
STEP = 0.01
MISS_MAX = 0.2
"""Radians from which on a turn counts no more: a scan that was matched wrongly, or a leap of the odometry."""
MISSES_LEFT = 0.6
"""What of the differences between the turns a lag may leave: the rest must be explained by it."""
HALVES_APART = 0.06
"""Seconds between the lags of the first and the second half of the turning."""
TURNS_MIN = 20
SCALE_MAX = 2.0


def find_lag(scans: Sequence[LogScan]) -> Lag | None:
    """Return the lag, None where the recording does not turn enough, where no lag explains why the turns differ, or where the one half
    of the turning tells another lag than the other."""
    if not any(scan.odometry for scan in scans):
        return None
    first = most_turning(scans, EXCERPT)
    if first is None:
        return None
    excerpt = [_at_its_middle(scan) for scan in scans[first : first + EXCERPT]]
    times = _seconds([scan.stamp_ns for scan in excerpt], excerpt[0].stamp_ns)
    odometry = [entry for scan in scans for entry in scan.odometry]
    odometry_times = _seconds([stamp_ns for stamp_ns, _ in odometry], excerpt[0].stamp_ns)
    odometry_yaws = np.unwrap([pose.yaw for _, pose in odometry])
    lags = np.linspace(-LAG_MAX, LAG_MAX, 2 * round(LAG_MAX / STEP) + 1)
    is_covered = (times - LAG_MAX >= odometry_times[0]) & (times + LAG_MAX <= odometry_times[-1])
    is_told = is_covered[1:] & is_covered[:-1]
    if is_told.sum() < TURNS_MIN:
        return None
    turns = np.array([np.diff(np.interp(times - lag, odometry_times, odometry_yaws)) for lag in lags])[:, is_told]
    best = none = len(lags) // 2
    for _ in range(ROUNDS):
        yaws = np.unwrap(run_offline(with_later_odometry(excerpt, float(lags[best]))).poses[:, 2])
        seen = np.diff(yaws)[is_told]
        misses = np.minimum(np.abs(turns * _scale(turns[best], seen) - seen), MISS_MAX)
        best = int(misses.mean(axis=1).argmin())
        found = Lag(float(lags[best]), float(misses[best].mean()), float(misses[none].mean()))
        is_explained = found.miss <= MISSES_LEFT * found.miss_before
        if not is_explained:
            return None
    is_inside = 0 < best < len(lags) - 1
    is_agreed = _halves_apart(misses, turns[best], lags) <= HALVES_APART
    return found if is_inside and is_agreed else None


def _scale(turns: F64, seen: F64) -> float:
    """Return by what the odometry's turns are to be multiplied: robots whose wheels skid tell theirs far too large."""
    return float(np.clip(np.abs(seen).sum() / max(np.abs(turns).sum(), 1e-9), 1.0 / SCALE_MAX, SCALE_MAX))


def _at_its_middle(scan: LogScan) -> LogScan:
    return replace(swept(scan, Sweep.NONE), stamp_ns=scan.stamp_ns + round(0.5e9 * scan.duration))


def _halves_apart(misses: F64, turns: F64, lags: F64) -> float:
    """Return how far apart the lags of the two halves of the turning are, seconds; `misses` (lags, N)."""
    turned = np.cumsum(np.abs(turns))
    is_first = turned <= 0.5 * turned[-1]
    return abs(
        float(lags[misses[:, is_first].mean(axis=1).argmin()] - lags[misses[:, ~is_first].mean(axis=1).argmin()])
    )


def _seconds(stamps_ns: list[int], since_ns: int) -> F64:
    return np.array([(stamp_ns - since_ns) * 1e-9 for stamp_ns in stamps_ns])
