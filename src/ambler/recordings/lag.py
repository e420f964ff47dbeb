"""How much later the stamps of a recording's scans are than those of its odometry at the same instant.

Drivers stamp a scan when its last beam has come, when it has crossed a serial line, or when the computer finds the time; wheels are stamped
elsewhere. A robot that turns with 60 deg/s is 8 deg elsewhere after the 0.13 s of one revolution of its scanner.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ambler.recordings.log_scans import LogScan, OdometryFeed


@dataclass(frozen=True, slots=True)
class Lag:
    """`seconds` by which scans are stamped later than odometry; `miss` is the mean difference between the turns that odometry and scans
    tell from one scan to the next once that is taken out, `miss_before` the same as recorded, radians."""

    seconds: float
    miss: float
    miss_before: float


def with_later_odometry(scans: Sequence[LogScan], seconds: float) -> tuple[LogScan, ...]:
    """Return the scans with their odometry stamped `seconds` later, each up to its last beam as before; the scans keep their stamps, by
    which they are known."""
    later_ns = round(seconds * 1e9)
    feed = OdometryFeed([(stamp_ns + later_ns, pose) for scan in scans for stamp_ns, pose in scan.odometry])
    return tuple(replace(scan, odometry=feed.until(scan.stamp_ns + round(scan.duration * 1e9))) for scan in scans)


LagFinder = Callable[[Sequence[LogScan]], Lag | None]
"""Asks a recording for the lag between its scans and its odometry: None where nothing tells it, or it tells of none."""
