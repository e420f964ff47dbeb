"""Clouds with the inertial measurements and odometry that belong to them, put together as they come in, from a recording or from a robot."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from ambler.core.messages import Imu, Odometry, PointCloud
from ambler.recordings.cloud_parts import PartJoiner, span_ns

OUTAGE_NS = 10_000_000_000  # of measurements that wait for a cloud
HELD_MB = (
    300.0  # of clouds that wait for measurements that may never come: a minute or so of the densest, and many of others
)
JUMP_NS = 1_000_000_000  # by which a stamp lies ahead of the last one when the next has to say whether it is true
BEFORE_NS = 3600 * 10**9  # from a first stamp on; a second one later shows that the first is of no clock, as zero is

BACK_MANY = 10  # messages in a row, one after the other but a jump behind the last one, whose clock went back

M = TypeVar("M", Imu, Odometry, PointCloud)


@dataclass(frozen=True, slots=True, eq=False)
class CloudScan:
    """A cloud of returns only, its points in the order of their times, and what else is new since the cloud before: measurements up to
    its last point and one more, to interpolate, if the recording goes on. Stamps of clouds strictly increase, so do those of
    measurements, over the whole recording; each is given once. Where clouds are missing, an empty one may come with what is new.
    `left_out`: how many messages were left out before it, for stamps that do not increase or that no other bears out. `is_overdue`: so many clouds waited that this one
    comes without all its measurements."""

    cloud: PointCloud
    imu: tuple[Imu, ...]
    odometry: tuple[Odometry, ...]
    left_out: int = 0
    is_overdue: bool = False

    @property
    def end_ns(self) -> int:
        """When the last point was taken, ns."""
        return _end_ns(self.cloud)


@dataclass
class _Stream(Generic[M]):
    """Messages in the order of their stamps, which wait for their cloud, or as clouds for their measurements.

    One whose stamp is zero or jumps ahead, as the first one's does, is `doubtful` until the next comes: a single wrong stamp would else leave out all that follows. `given` are the stamps of all that were taken, where it is `watched` whether the clock goes back; `behind` those that may show it."""

    waiting: deque[M] = field(default_factory=deque)
    last_ns: int = -1
    doubtful: M | None = None
    left_out: int = 0
    watched: bool = False
    given: array[int] = field(default_factory=lambda: array("q"))
    behind: list[int] = field(default_factory=list)

    def add(self, message: M) -> None:
        """Take a message, unless its stamp is not after all that are known to be true."""
        if message.stamp_ns <= self.last_ns:
            self.left_out += 1
            if self.watched and self.went_back is None:
                self._watch(message.stamp_ns)
            return
        doubtful, self.doubtful = self.doubtful, None
        if doubtful is not None and self._bears_out(message, doubtful):
            self._take_in(doubtful)
        elif doubtful is not None:
            self.left_out += 1
        if message.stamp_ns == 0 or self.last_ns < message.stamp_ns - JUMP_NS:
            self.doubtful = message
        else:
            self._take_in(message)

    @property
    def went_back(self) -> tuple[int, int] | None:
        """The stamp after which the clock went back, and by how much, ns."""
        return (self.last_ns, self.last_ns - self.behind[0]) if len(self.behind) >= BACK_MANY else None

    def _watch(self, stamp_ns: int) -> None:
        """Count what comes in order but long after its time, unless it came before: a recording may hold a stretch twice."""
        k = bisect_left(self.given, stamp_ns)
        is_known = k < len(self.given) and self.given[k] == stamp_ns
        if is_known or stamp_ns >= self.last_ns - JUMP_NS or (self.behind and stamp_ns <= self.behind[-1]):
            self.behind.clear()
        if not is_known and stamp_ns < self.last_ns - JUMP_NS:
            self.behind.append(stamp_ns)

    def _bears_out(self, message: M, doubtful: M) -> bool:
        ahead_ns = message.stamp_ns - doubtful.stamp_ns
        return ahead_ns > 0 and (self.last_ns >= 0 or ahead_ns <= BEFORE_NS)

    def _take_in(self, message: M) -> None:
        self._keep(message)
        self.last_ns = message.stamp_ns
        self.behind.clear()
        if self.watched:
            self.given.append(message.stamp_ns)

    def _keep(self, message: M) -> None:
        self.waiting.append(message)

    def end(self) -> None:
        """Take that nothing more will come."""
        if self.doubtful is not None:
            self._take_in(self.doubtful)
            self.doubtful = None

    def take(self, until_ns: int) -> tuple[M, ...]:
        """Remove and return everything up to a time, and one more."""
        out = []
        while self.waiting:
            out.append(self.waiting.popleft())
            if out[-1].stamp_ns >= until_ns:
                break
        return tuple(out)

    def span_ns(self) -> int:
        """Return how long a time waits."""
        return self.waiting[-1].stamp_ns - self.waiting[0].stamp_ns if self.waiting else 0

    def count_left_out(self) -> int:
        """Return how many were left out since this was asked last."""
        count, self.left_out = self.left_out, 0
        return count


class _Clouds(_Stream[PointCloud]):
    """Clouds; parts of scans wait until their scan is complete."""

    def __init__(self, spacing: float | None, *, watched: bool) -> None:
        super().__init__(watched=watched)
        self._parts = PartJoiner(spacing)
        self._held_bytes = 0

    @property
    def held_mb(self) -> float:
        """How much memory those take that wait."""
        return 1e-6 * self._held_bytes

    def next(self) -> PointCloud:
        """Remove and return the first."""
        cloud = self.waiting.popleft()
        self._held_bytes -= _size(cloud)
        return cloud

    def _hold(self, clouds: list[PointCloud]) -> None:
        self.waiting += clouds
        self._held_bytes += sum(map(_size, clouds))

    def _keep(self, message: PointCloud) -> None:
        self._hold(self._parts.add(message))

    def end(self) -> None:
        """Take that nothing more will come."""
        super().end()
        self.complete()

    def complete(self) -> None:
        """Take that no more parts will come soon."""
        self._hold(self._parts.end())


class ScanJoiner:
    """Holds each cloud back until every other stream that it waits for has passed its end. Stamps that do not increase are left out, and so is a
    stamp that lies ahead by more than a second, if the next does not.

    Clouds that come in small parts are joined into scans; `spacing` is how many seconds lie between two clouds, where that is known. `lidar_clock` is how many seconds the clouds' stamps lag behind those of the measurements: of a cloud that was taken later than it says, so are the last ones.
    At most `held_most` clouds, and `held_mb` of them, wait. With `has_outages`, for robots, an empty scan takes the older half away when measurements of more than ten seconds wait and no cloud comes.
    """

    def __init__(
        self,
        *,
        waits_for_imu: bool = True,
        waits_for_odometry: bool = True,
        held_most: int | None = None,
        held_mb: float = HELD_MB,
        has_outages: bool = False,
        lidar_clock: float = 0.0,
        spacing: float | None = None,
    ) -> None:
        self._has_outages, self._late_ns = has_outages, round(lidar_clock * 1e9)
        self._waits_for_imu, self._waits_for_odometry = waits_for_imu, waits_for_odometry
        self._held_most, self._held_mb = held_most, held_mb
        watched = not has_outages
        self._imu: _Stream[Imu] = _Stream(watched=watched)
        self._odometry: _Stream[Odometry] = _Stream(watched=watched)
        self._clouds = _Clouds(spacing, watched=watched)

    def add(self, message: object) -> None:
        """Take a cloud, a measurement or odometry; anything else is left out."""
        if isinstance(message, PointCloud):
            self._clouds.add(returns_in_order(message))
        elif isinstance(message, Imu):
            self._imu.add(message)
        elif isinstance(message, Odometry):
            self._odometry.add(message)

    def ready(self) -> Iterator[CloudScan]:
        """Remove and yield what is complete, and what waits for too much."""
        clouds = self._clouds.waiting
        while clouds and (self._is_covered(self._taken_ns(clouds[0])) or self._is_full()):
            yield self._next()
        longest_ns, last_ns = max((stream.span_ns(), stream.last_ns) for stream in (self._imu, self._odometry))
        if self._has_outages and not clouds and longest_ns > OUTAGE_NS:
            self._clouds.complete()
            yield self._next() if clouds else self._with_measurements(_nothing(last_ns - OUTAGE_NS // 2))

    def rest(self) -> Iterator[CloudScan]:
        """Remove and yield everything: nothing more will come."""
        for stream in (self._imu, self._odometry, self._clouds):
            stream.end()
        while self._clouds.waiting:
            yield self._next()

    @property
    def went_back(self) -> str:
        """Whose clock went back, when and by how much, in words; empty: none did. Not known on robots, of which everything had to be kept for that."""
        streams = (("clouds", self._clouds), ("inertial measurements", self._imu), ("odometry", self._odometry))
        for name, stream in streams:
            if stream.went_back is not None:
                at_ns, by_ns = stream.went_back
                return f"the clock of the {name} went back by {1e-9 * by_ns:.1f} s after {1e-9 * at_ns:.3f} s"
        return ""

    def _is_covered(self, end_ns: int) -> bool:
        needed = ((self._waits_for_imu, self._imu), (self._waits_for_odometry, self._odometry))
        return all(not is_waited_for or stream.last_ns >= end_ns for is_waited_for, stream in needed)

    def _is_full(self) -> bool:
        return self._clouds.held_mb > self._held_mb or len(self._clouds.waiting) > (self._held_most or math.inf)

    def _next(self) -> CloudScan:
        is_overdue = self._clouds.held_mb > self._held_mb
        scan = self._with_measurements(self._clouds.next())
        is_overdue = is_overdue and not self._is_covered(self._taken_ns(scan.cloud))
        return replace(scan, is_overdue=True) if is_overdue else scan

    def _taken_ns(self, cloud: PointCloud) -> int:
        """Return when the last point was taken, by the clock of the measurements."""
        return _end_ns(cloud) + self._late_ns

    def _with_measurements(self, cloud: PointCloud) -> CloudScan:
        end_ns = self._taken_ns(cloud)
        left_out = sum(stream.count_left_out() for stream in (self._imu, self._odometry, self._clouds))
        return CloudScan(cloud, self._imu.take(end_ns), self._odometry.take(end_ns), left_out)


def returns_in_order(cloud: PointCloud) -> PointCloud:
    """Return the cloud without points that are not finite or lie at its origin (no return), ordered by time; the stamp stays."""
    is_return = np.isfinite(cloud.points).all(axis=1) & (cloud.points != 0.0).any(axis=1) & np.isfinite(cloud.time)
    kept = np.flatnonzero(is_return)
    kept = kept[np.argsort(cloud.time[kept], kind="stable")]
    return replace(
        cloud,
        points=cloud.points[kept],
        intensity=cloud.intensity[kept],
        time=cloud.time[kept],
        ring=cloud.ring[kept],
    )


def _nothing(stamp_ns: int) -> PointCloud:
    """Return a cloud of no points."""
    none = np.empty(0, np.float32)
    return PointCloud(stamp_ns, "", np.empty((0, 3), np.float32), none, none, np.empty(0, np.uint16))


def _size(cloud: PointCloud) -> int:
    """Return how many bytes a cloud takes, about."""
    return 1000 + cloud.points.nbytes + cloud.intensity.nbytes + cloud.time.nbytes + cloud.ring.nbytes


def _end_ns(cloud: PointCloud) -> int:
    return span_ns(cloud)[1]
