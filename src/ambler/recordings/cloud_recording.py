"""Clouds with the inertial measurements and odometry that belong to them, out of bags, as 3-D mapping wants them.

Clouds are large, so a recording is read while it is used, and may be read again.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ambler.core.errors import BadInputError, TransformError
from ambler.core.messages import Imu, Odometry, PointCloud, Transforms
from ambler.core.se3 import SE3
from ambler.recordings.bag_content import BASE_FRAMES, RecordedFrames, choose_topic, listed_topics, plain_frame
from ambler.recordings.cloud_parts import MANY, mean_spacing, scans_of_parts
from ambler.recordings.cloud_scan import CloudScan, ScanJoiner, returns_in_order
from ambler.wire.bags import BagReader, open_bag
from ambler.wire.cloud_columns import times_within

NONE = "none"
LOOK_NS = 3_000_000_000  # of a recording in which a topic shows whether its messages bear stamps


@dataclass(frozen=True, slots=True)
class CloudChoices:
    """What the user decides: topic names (None: the only one; `none` as `imu_topic` or `odom_topic`: without), and the pose of the IMU in
    the LiDAR's frame (None: from the transforms)."""

    cloud_topic: str | None = None
    imu_topic: str | None = None
    odom_topic: str | None = None
    lidar_from_imu: SE3 | None = None


@dataclass(frozen=True, slots=True)
class CloudRecording:
    """What `open_cloud_recording` found. Poses are None where the recording does not tell; `notes` say what was chosen. `idle_stamps` (ns) are those that
    messages of a topic bear whose driver has no clock: what bears it was taken when it was recorded. `spacing`: seconds between two clouds, None where that is not known;
    `clouds` how many scans there will be, about, where they are joined of parts."""

    path: Path
    cloud_topic: str
    imu_topic: str | None
    odom_topic: str | None
    lidar_from_imu: SE3 | None
    base_from_lidar: SE3 | None
    notes: tuple[str, ...]
    clouds: int = 0
    idle_stamps: Mapping[str, int] = field(default_factory=dict)
    spacing: float | None = None

    def scans(self, lidar_clock: float = 0.0) -> Iterator[CloudScan]:
        """Yield the clouds in the order of the recording, whose stamps lag `lidar_clock` s behind those of the measurements; those whose stamp does not increase are left out, and counted in the next scan, so are measurements.

        Raises BadInputError for damage on the way, and where the clock of a topic goes back by more than a second.
        """
        with open_bag(self.path) as bag:
            joiner = ScanJoiner(
                waits_for_imu=self.imu_topic is not None,
                waits_for_odometry=self.odom_topic is not None,
                lidar_clock=lidar_clock,
                spacing=self.spacing,
            )
            names = {name for name in (self.cloud_topic, self.imu_topic, self.odom_topic) if name is not None}
            for topic, message, log_ns in bag.messages(names):
                joiner.add(self._read(topic, message, log_ns))
                yield from joiner.ready()
                if joiner.went_back:
                    break
            yield from joiner.rest()
        if joiner.went_back:
            raise BadInputError(
                f"{self.path}: {joiner.went_back}, and what follows is of other times (cut it there by the times of recording, and map each part)"
            )

    def _read(self, topic: str, message: object, log_ns: int) -> object:
        """Return a message with the times that the topic as a whole tells."""
        if isinstance(message, PointCloud):
            message = replace(message, time=times_within(message.time, self.spacing))
        is_idle = topic in self.idle_stamps and _stamp_of(message) == self.idle_stamps[topic]
        return _recorded_at(message, log_ns) if is_idle else message


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
        idle_stamps = _idle_stamps(bag, {name for name in (cloud_topic, imu_topic, odom_topic) if name is not None})
        spacing = _spacing(bag, cloud_topic, has_stamps=cloud_topic not in idle_stamps)
        cloud, imu = _first(bag, cloud_topic), None if imu_topic is None else _first(bag, imu_topic)
    assert isinstance(cloud, PointCloud)
    lidar_from_imu = choices.lidar_from_imu
    if lidar_from_imu is None and isinstance(imu, Imu):
        lidar_from_imu = _pose(frames, cloud.frame, imu.frame)
    base_from_lidar = next((p for b in BASE_FRAMES if (p := _pose(frames, b, cloud.frame)) is not None), None)
    time = times_within(returns_in_order(cloud).time, spacing)  # of what is no point the times are often none either
    seconds = float(np.ptp(time)) if len(time) else 0.0
    scans, parted = scans_of_parts(clouds, seconds, spacing)
    timeless = "" if seconds > 0.0 else "; no times of its points, so nothing corrects how it moved meanwhile"
    notes = (
        *bag.notes,
        *frames.notes,
        f"clouds: {cloud_topic} in frame {plain_frame(cloud.frame)!r}, the first {seconds:.3f} s long{timeless}",
        *parted,
        "inertial measurements: "
        + ("none" if imu_topic is None else f"{imu_topic}, pose in the LiDAR's frame {_known(lidar_from_imu)}"),
        f"odometry: {odom_topic or 'none'}",
        f"mount of the LiDAR: {_known(base_from_lidar)}",
        *(
            f"{topic}: its messages bear the stamp {stamp_ns * 1e-9:g} s; the times at which they were recorded are taken instead, which are later by an unknown delay"
            for topic, stamp_ns in sorted(idle_stamps.items())
        ),
    )
    poses = (lidar_from_imu, base_from_lidar)
    return CloudRecording(path, cloud_topic, imu_topic, odom_topic, *poses, notes, scans, idle_stamps, spacing)


def _idle_stamps(bag: BagReader, topics: set[str]) -> dict[str, int]:
    """Return the one stamp (ns) that all messages of a topic bear, as far as its first seconds tell, of the topics of which that is so."""
    seen: dict[str, list[int]] = {topic: [] for topic in topics}
    moving, begin_ns = set[str](), -1
    for topic, message, log_ns in bag.messages(topics):
        begin_ns = log_ns if begin_ns < 0 else begin_ns
        seen[topic].append(_stamp_of(message))
        if seen[topic][-1] != seen[topic][0]:
            moving.add(topic)
        if moving == topics or log_ns - begin_ns > LOOK_NS:
            break
    return {topic: stamps[0] for topic, stamps in seen.items() if topic not in moving and len(stamps) > 1}


def _spacing(bag: BagReader, topic: str, *, has_stamps: bool) -> float | None:
    """Return how many seconds lie between the first clouds, None where fewer than two tell."""
    times_ns: list[int] = []
    for _, message, log_ns in bag.messages({topic}):
        times_ns.append(_stamp_of(message) if has_stamps else log_ns)
        if len(times_ns) > MANY or times_ns[-1] - times_ns[0] > LOOK_NS // 2:
            break
    return mean_spacing(times_ns)


def _stamp_of(message: object) -> int:
    return message.stamp_ns if isinstance(message, (PointCloud, Imu, Odometry)) else -1


def _recorded_at(message: object, log_ns: int) -> object:
    """Return a message as one that was sent when it was recorded; a cloud is sent when its last point has been taken."""
    if isinstance(message, PointCloud):
        times = message.time[np.isfinite(message.time)]
        return replace(message, stamp_ns=log_ns - (round(float(times.max()) * 1e9) if len(times) else 0))
    return replace(message, stamp_ns=log_ns) if isinstance(message, (Imu, Odometry)) else message


def _first(bag: BagReader, topic: str) -> object:
    return next(bag.messages({topic})).message


def _pose(frames: RecordedFrames, target: str, source: str) -> SE3 | None:
    if not plain_frame(target) or not plain_frame(source):
        return None  # who names no frame says nothing of where it is
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
