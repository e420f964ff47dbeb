"""Clouds with the inertial measurements and odometry that belong to them, put together as they come in, from a recording or from a robot."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ambler.core.messages import Imu, Odometry, PointCloud

OUTAGE_NS = 10_000_000_000  # of measurements that wait for a cloud
HELD_MAX = 100  # clouds that wait for measurements that may never come, a hundred megabytes or so


@dataclass(frozen=True, slots=True, eq=False)
class CloudScan:
    """A cloud of returns only, its points in the order of their times, and what else is new since the cloud before: measurements up to
    its last point and one more, to interpolate, if the recording goes on. Stamps of clouds strictly increase, so do those of
    measurements, over the whole recording; each is given once. Where clouds are missing, an empty one may come with what is new."""

    cloud: PointCloud
    imu: tuple[Imu, ...]
    odometry: tuple[Odometry, ...]

    @property
    def end_ns(self) -> int:
        """When the last point was taken, ns."""
        return _end_ns(self.cloud)


@dataclass
class _Stream:
    """Measurements that wait for their cloud, in the order of their stamps."""

    waiting: deque[Imu | Odometry] = field(default_factory=deque)
    last_ns: int = -1

    def add(self, message: Imu | Odometry) -> None:
        if message.stamp_ns > self.last_ns:
            self.waiting.append(message)
            self.last_ns = message.stamp_ns

    def take(self, until_ns: int) -> list[Imu | Odometry]:
        """Remove and return everything up to a time, and one more."""
        out = []
        while self.waiting:
            out.append(self.waiting.popleft())
            if out[-1].stamp_ns >= until_ns:
                break
        return out

    def span_ns(self) -> int:
        """Return how long a time waits."""
        return self.waiting[-1].stamp_ns - self.waiting[0].stamp_ns if self.waiting else 0


class ScanJoiner:
    """Holds each cloud back until every other stream that it waits for has passed its end. Stamps that do not increase are left out.

    With `has_outages`, for robots, an empty scan takes the older half away when measurements of more than ten seconds wait and no cloud comes.
    """

    def __init__(
        self,
        *,
        waits_for_imu: bool = True,
        waits_for_odometry: bool = True,
        held_most: int = HELD_MAX,
        has_outages: bool = False,
    ) -> None:
        self._has_outages = has_outages
        self._waits_for_imu, self._waits_for_odometry, self._held_most = waits_for_imu, waits_for_odometry, held_most
        self._imu, self._odometry = _Stream(), _Stream()
        self._clouds: deque[PointCloud] = deque()
        self._last_ns = -1

    def add(self, message: object) -> None:
        """Take a cloud, a measurement or odometry; anything else is left out."""
        if isinstance(message, PointCloud) and message.stamp_ns > self._last_ns:
            self._clouds.append(returns_in_order(message))
            self._last_ns = message.stamp_ns
        elif isinstance(message, Imu):
            self._imu.add(message)
        elif isinstance(message, Odometry):
            self._odometry.add(message)

    def ready(self) -> Iterator[CloudScan]:
        """Remove and yield what is complete, and what has waited for too long."""
        while self._clouds and (len(self._clouds) > self._held_most or self._is_covered(_end_ns(self._clouds[0]))):
            yield self._next()
        longest = max(self._imu, self._odometry, key=_Stream.span_ns)
        if self._has_outages and not self._clouds and longest.span_ns() > OUTAGE_NS:
            yield self._with_measurements(_nothing(longest.last_ns - OUTAGE_NS // 2))

    def rest(self) -> Iterator[CloudScan]:
        """Remove and yield everything: nothing more will come."""
        while self._clouds:
            yield self._next()

    def _is_covered(self, end_ns: int) -> bool:
        needed = ((self._waits_for_imu, self._imu), (self._waits_for_odometry, self._odometry))
        return all(not is_waited_for or stream.last_ns >= end_ns for is_waited_for, stream in needed)

    def _next(self) -> CloudScan:
        return self._with_measurements(self._clouds.popleft())

    def _with_measurements(self, cloud: PointCloud) -> CloudScan:
        end_ns = _end_ns(cloud)
        imu = tuple(m for m in self._imu.take(end_ns) if isinstance(m, Imu))
        odometry = tuple(m for m in self._odometry.take(end_ns) if isinstance(m, Odometry))
        return CloudScan(cloud, imu, odometry)


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


def _end_ns(cloud: PointCloud) -> int:
    return cloud.stamp_ns + (round(float(cloud.time[-1]) * 1e9) if len(cloud.time) else 0)
