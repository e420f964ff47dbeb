"""Clouds with the inertial measurements and odometry that belong to them, out of bags, as 3-D mapping wants them.

Clouds are large, so a recording is read while it is used, and may be read again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ambler.core.errors import BadInputError, TransformError
from ambler.core.messages import Imu, Odometry, PointCloud, Transforms
from ambler.core.se3 import SE3
from ambler.recordings.bag_content import BASE_FRAMES, RecordedFrames, choose_topic, listed_topics, plain_frame
from ambler.wire.bags import BagReader, open_bag

NONE = "none"
HELD_MAX = 100  # clouds that wait for measurements that may never come, a hundred megabytes or so


@dataclass(frozen=True, slots=True)
class CloudChoices:
    """What the user decides: topic names (None: the only one; `none` as `imu_topic` or `odom_topic`: without), and the pose of the IMU in
    the LiDAR's frame (None: from the transforms)."""

    cloud_topic: str | None = None
    imu_topic: str | None = None
    odom_topic: str | None = None
    lidar_from_imu: SE3 | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CloudScan:
    """A cloud of returns only, its points in the order of their times, and what else is new since the cloud before: measurements up to
    its last point and one more, to interpolate, if the recording goes on. Stamps of clouds strictly increase, so do those of
    measurements, over the whole recording; each is given once."""

    cloud: PointCloud
    imu: tuple[Imu, ...]
    odometry: tuple[Odometry, ...]

    @property
    def end_ns(self) -> int:
        """When the last point was taken, ns."""
        return _end_ns(self.cloud)


@dataclass(frozen=True, slots=True)
class CloudRecording:
    """What `open_cloud_recording` found. Poses are None where the recording does not tell; `notes` say what was chosen."""

    path: Path
    cloud_topic: str
    imu_topic: str | None
    odom_topic: str | None
    lidar_from_imu: SE3 | None
    base_from_lidar: SE3 | None
    notes: tuple[str, ...]
    clouds: int = 0

    def scans(self) -> Iterator[CloudScan]:
        """Yield the clouds in the order of the recording; those whose stamp does not increase are left out, so are measurements.

        Raises BadInputError for damage on the way.
        """
        with open_bag(self.path) as bag:
            yield from _Joiner(self).join(bag)


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


class _Joiner:
    """Holds each cloud back until every other stream has passed its end."""

    def __init__(self, recording: CloudRecording) -> None:
        self._topics = recording
        self._imu, self._odometry = _Stream(), _Stream()
        self._clouds: deque[PointCloud] = deque()
        self._last_ns = -1

    def join(self, bag: BagReader) -> Iterator[CloudScan]:
        names = (self._topics.cloud_topic, self._topics.imu_topic, self._topics.odom_topic)
        for _, message, _ in bag.messages({name for name in names if name is not None}):
            if isinstance(message, PointCloud) and message.stamp_ns > self._last_ns:
                self._clouds.append(returns_in_order(message))
                self._last_ns = message.stamp_ns
            elif isinstance(message, Imu):
                self._imu.add(message)
            elif isinstance(message, Odometry):
                self._odometry.add(message)
            while self._clouds and (len(self._clouds) > HELD_MAX or self._is_covered(_end_ns(self._clouds[0]))):
                yield self._next()
        while self._clouds:
            yield self._next()

    def _is_covered(self, end_ns: int) -> bool:
        needed = ((self._topics.imu_topic, self._imu), (self._topics.odom_topic, self._odometry))
        return all(name is None or stream.last_ns >= end_ns for name, stream in needed)

    def _next(self) -> CloudScan:
        cloud = self._clouds.popleft()
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


def open_cloud_recording(path: Path, choices: CloudChoices | None = None) -> CloudRecording:
    """Look into a bag and choose what is unambiguous. Raises BadInputError that names topic or file."""
    choices = choices or CloudChoices()
    with open_bag(path) as bag:
        cloud_topic = choose_topic(bag, PointCloud, choices.cloud_topic, "--cloud-topic")
        if cloud_topic is None:
            raise BadInputError(f"{path}: no topic with clouds, only {listed_topics(bag)}")
        imu_topic = None if choices.imu_topic == NONE else choose_topic(bag, Imu, choices.imu_topic, "--imu-topic")
        odom_topic = (
            None if choices.odom_topic == NONE else choose_topic(bag, Odometry, choices.odom_topic, "--odom-topic")
        )
        frames = RecordedFrames()
        for topic, message, _ in bag.messages(types={Transforms}):
            if isinstance(message, Transforms):
                frames.add(message, is_static=topic.endswith("tf_static"))
        clouds = sum(t.count for t in bag.topics() if t.name == cloud_topic)
        cloud, imu = _first(bag, cloud_topic), None if imu_topic is None else _first(bag, imu_topic)
    assert isinstance(cloud, PointCloud)
    lidar_from_imu = choices.lidar_from_imu
    if lidar_from_imu is None and isinstance(imu, Imu):
        lidar_from_imu = _pose(frames, cloud.frame, imu.frame)
    base_from_lidar = next((p for b in BASE_FRAMES if (p := _pose(frames, b, cloud.frame)) is not None), None)
    seconds = float(np.ptp(cloud.time)) if len(cloud.time) else 0.0
    notes = (
        *bag.notes,
        f"clouds: {cloud_topic} in frame {plain_frame(cloud.frame)!r}, the first {seconds:.3f} s long",
        "inertial measurements: "
        + ("none" if imu_topic is None else f"{imu_topic}, pose in the LiDAR's frame {_known(lidar_from_imu)}"),
        f"odometry: {odom_topic or 'none'}",
        f"mount of the LiDAR: {_known(base_from_lidar)}",
    )
    return CloudRecording(path, cloud_topic, imu_topic, odom_topic, lidar_from_imu, base_from_lidar, notes, clouds)


def _first(bag: BagReader, topic: str) -> object:
    return next(bag.messages({topic})).message


def _pose(frames: RecordedFrames, target: str, source: str) -> SE3 | None:
    if plain_frame(target) == plain_frame(source):
        return SE3()
    try:
        return frames.lookup(target, source)
    except TransformError:
        return None


def _known(pose: SE3 | None) -> str:
    if pose is None:
        return "unknown"
    x, y, z = pose.translation
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m"


def _end_ns(cloud: PointCloud) -> int:
    return cloud.stamp_ns + (round(float(cloud.time[-1]) * 1e9) if len(cloud.time) else 0)
