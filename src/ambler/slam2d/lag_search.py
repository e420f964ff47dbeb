"""How much later are a recording's scans stamped than its odometry? Asked of the recording itself.

Both tell how the robot turned from scan to scan. Where it turns most, the scans are mapped; shifting the odometry in time until both tell the
same turns finds the lag between their stamps. A scan whose beams are all taken at once shows the heading in the middle of its duration, in whichever order they
were taken, so this is asked before the order of the beams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
LAGS: F64 = np.linspace(-LAG_MAX, LAG_MAX, 2 * round(LAG_MAX / STEP) + 1)
NONE = len(LAGS) // 2
MISS_MAX = 0.2
"""Radians from which on a turn counts no more: a scan that was matched wrongly, or a leap of the odometry."""
MISSES_LEFT = 0.6
"""What of the differences between the turns a lag may leave: the rest must be explained by it."""
HALVES_APART = 0.06
"""Seconds between the lags of the first and the second half of the turning."""
TURNS_MIN = 20
SCALE_MAX = 2.0


def find_lag(scans: Sequence[LogScan]) -> Lag | None:
    """Return the lag, None where the recording does not turn enough, where no lag explains why the turns differ, where the one half
    of the turning tells another lag than the other, or where elsewhere in the recording the lag makes turns differ more than none."""
    odometry = _Odometry.of(scans)
    stretch = None if odometry is None else _Stretch.of(scans, odometry)
    if odometry is None or stretch is None:
        return None
    best = NONE
    for _ in range(ROUNDS):
        misses = stretch.misses(best)
        miss = misses.mean(axis=1)
        best = int(miss.argmin())
        if miss[best] > MISSES_LEFT * miss[NONE]:
            return None
    is_inside = 0 < best < len(LAGS) - 1
    is_agreed = _halves_apart(misses, stretch.turns[best]) <= HALVES_APART
    elsewhere = max(scans[: stretch.first], scans[stretch.first + EXCERPT :], key=len)
    is_lag = is_inside and is_agreed and _holds(best, elsewhere, odometry)
    return Lag(float(LAGS[best]), float(miss[best]), float(miss[NONE])) if is_lag else None


@dataclass(frozen=True, slots=True)
class _Odometry:
    """Its headings, unwrapped, float64 (N,), and when they were: seconds after `since_ns`."""

    since_ns: int
    times: F64
    yaws: F64

    @classmethod
    def of(cls, scans: Sequence[LogScan]) -> _Odometry | None:
        entries = [entry for scan in scans for entry in scan.odometry]
        if not entries:
            return None
        since_ns = entries[0][0]
        times = np.array([(stamp_ns - since_ns) * 1e-9 for stamp_ns, _ in entries])
        return cls(since_ns, times, np.unwrap([pose.yaw for _, pose in entries]))

    def turns_between(self, stamps_ns: Sequence[int]) -> tuple[NDArray[np.bool_], F64]:
        """Return between which of the instants (N,) it tells the turns whatever the lag, bool (N - 1,), and those turns for each of `LAGS`, (L, M)."""
        times = np.array([(stamp_ns - self.since_ns) * 1e-9 for stamp_ns in stamps_ns])
        is_covered = (times - LAG_MAX >= self.times[0]) & (times + LAG_MAX <= self.times[-1])
        is_told = is_covered[1:] & is_covered[:-1]
        turns = np.array([np.diff(np.interp(times - lag, self.times, self.yaws)) for lag in LAGS])
        return is_told, turns[:, is_told]


@dataclass(frozen=True, slots=True)
class _Stretch:
    """The scans from `first` on where a recording turns most, each at its middle; between which of them the odometry tells the turns, bool (N - 1,),
    and those turns for each of `LAGS`, (L, M)."""

    first: int
    scans: tuple[LogScan, ...]
    is_told: NDArray[np.bool_]
    turns: F64

    @classmethod
    def of(cls, scans: Sequence[LogScan], odometry: _Odometry) -> _Stretch | None:
        """Return that of a recording, None where nothing turns enough or the odometry tells too few turns."""
        first = most_turning(scans, EXCERPT)
        if first is None:
            return None
        excerpt = tuple(_at_its_middle(scan) for scan in scans[first : first + EXCERPT])
        is_told, turns = odometry.turns_between([scan.stamp_ns for scan in excerpt])
        return cls(first, excerpt, is_told, turns) if is_told.sum() >= TURNS_MIN else None

    def misses(self, mapped: int) -> F64:
        """Return by how much the odometry's turns differ from those that a map of the scans tells, (L, M); it is made with the lag number `mapped`."""
        poses = run_offline(with_later_odometry(self.scans, float(LAGS[mapped]))).poses
        seen = np.diff(np.unwrap(poses[:, 2]))[self.is_told]
        return np.minimum(np.abs(self.turns * _scale(self.turns[mapped], seen) - seen), MISS_MAX)


def _holds(best: int, scans: Sequence[LogScan], odometry: _Odometry) -> bool:
    """Say whether a lag explains the turns where the rest of a recording turns most, too, or nothing speaks against it there: a lag that comes and goes is
    none that could be taken out."""
    elsewhere = _Stretch.of(scans, odometry)
    if elsewhere is None:
        return True
    miss = elsewhere.misses(best).mean(axis=1)
    return bool(miss[best] < miss[NONE])


def _scale(turns: F64, seen: F64) -> float:
    """Return by what the odometry's turns are to be multiplied: robots whose wheels skid tell theirs far too large."""
    return float(np.clip(np.abs(seen).sum() / max(np.abs(turns).sum(), 1e-9), 1.0 / SCALE_MAX, SCALE_MAX))


def _at_its_middle(scan: LogScan) -> LogScan:
    return replace(swept(scan, Sweep.NONE), stamp_ns=scan.stamp_ns + round(0.5e9 * scan.duration))


def _halves_apart(misses: F64, turns: F64) -> float:
    """Return how far apart the lags of the two halves of the turning are, seconds."""
    turned = np.cumsum(np.abs(turns))
    is_first = turned <= 0.5 * turned[-1]
    first, second = (LAGS[misses[:, half].mean(axis=1).argmin()] for half in (is_first, ~is_first))
    return abs(float(first - second))
