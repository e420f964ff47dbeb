"""Robots that do not know where they are: switched on anywhere, or carried elsewhere without notice. Both from recorded drives.

The times are robot time plus the whole CPU time that the localization has used so far, so that thinking is not taken for free.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambler.apps.config import RobotConfig
from ambler.apps.robot import MapGrid
from ambler.core.messages import Imu, LaserScan, Message, Odometry, PointCloud, Status
from ambler.core.se2 import SE2, wrap_angle
from ambler.core.se3 import SE3
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.topics import LOCALIZED_POSE, TRUE_POSE, Topic
from ambler.studies.localization_study import Feed, localization_executor, sensor_feed
from ambler.studies.random_drives import DriveCase, RandomDrive, start_of
from ambler.wire.mcap_reader import read_recording

RIGHT_XY, RIGHT_YAW = 0.3, 0.1  # metres, radians: a told pose beyond them is wrong
STILL_RIGHT = 1.0  # seconds for which a found pose must stay right
KIDNAP_AFTER = 5.0  # seconds of the first drive
LOST_CODES = ("LOCALIZATION_LOST", "LOCALIZATION_RELOCALIZING")


@dataclass(frozen=True, slots=True)
class FoundAgain:
    """`noticed`, `found`: seconds until the pose was doubted, and told rightly again (None: never). `wrong`: poses told that were
    not right, of those told after the robot had reason to doubt; `last_state`: the last status code of the localization."""

    noticed: float | None
    found: float | None
    wrong: int
    last_state: str


def relocalize(drive: RandomDrive, robot: str, config: RobotConfig, grid: MapGrid, limit: float) -> FoundAgain:
    """Switch the robot on in a drive without telling it where; it has `limit` seconds."""
    watch = _Watch(_truth(drive), 0)
    _run(watch, robot, config, grid, None, _until(sensor_feed(drive.recording), int(limit * 1e9)))
    return watch.result()


def kidnap(before: RandomDrive, after: RandomDrive, robot: str, config: RobotConfig, grid: MapGrid) -> FoundAgain:
    """Let the robot drive with a known pose, then carry it in no time to where another drive begins; odometry does not notice."""
    jump_ns = int(KIDNAP_AFTER * 1e9)
    truth = [row for row in _truth(before) if row[0] <= jump_ns]
    truth += [(stamp + jump_ns, pose) for stamp, pose in _truth(after)]
    watch = _Watch(truth, jump_ns)
    _run(watch, robot, config, grid, before.map_from_start, _spliced(before.recording, after.recording, jump_ns))
    return watch.result()


class _Watch:
    """Follows what a localization tells and compares it with the truth: (stamp ns, map_from_base) in order of time."""

    def __init__(self, truth: list[tuple[int, SE2]], since_ns: int) -> None:
        self._stamps = np.array([stamp for stamp, _ in truth], np.int64)
        self._poses = [pose for _, pose in truth]
        self._since_ns = since_ns
        self._cpu_start: float | None = None
        self._noticed: float | None = None
        self._found: float | None = None
        self._found_ns = 0
        self._wrong = 0
        self._state = ""
        self.executor: LockstepExecutor | None = None

    def on_message(self, topic: Topic[Any], message: Message, time_ns: int, writer: str = "") -> None:
        """Take what was delivered; stops the executor when the robot has been right again for a while."""
        if time_ns < self._since_ns:
            return
        if self._cpu_start is None:
            self._cpu_start = time.process_time()
        elapsed = (time_ns - self._since_ns) * 1e-9 + time.process_time() - self._cpu_start
        if isinstance(message, Status) and writer == "localization":
            self._state = message.code
            if message.code in LOST_CODES and self._noticed is None:
                self._noticed = elapsed
        elif topic is LOCALIZED_POSE and isinstance(message, Odometry) and message.stamp_ns >= self._since_ns:
            self._judge(message, elapsed)

    def _judge(self, told: Odometry, elapsed: float) -> None:
        """Before the robot has noticed anything its pose is only late, not a claim; from then on it must be right."""
        is_right = self._is_right(told)
        if self._since_ns > 0 and self._noticed is None:
            if is_right:
                self._found = None
            return
        if not is_right:
            self._wrong += 1
            self._found = None
        elif self._found is None:
            self._found, self._found_ns = elapsed, told.stamp_ns
        elif told.stamp_ns - self._found_ns > STILL_RIGHT * 1e9 and self.executor is not None:
            self.executor.stop()

    def _is_right(self, told: Odometry) -> bool:
        at = min(int(np.searchsorted(self._stamps, told.stamp_ns)), len(self._poses) - 1)
        true, pose = self._poses[at], told.pose.to_se2()
        return pose.distance_to(true) < RIGHT_XY and abs(wrap_angle(pose.yaw - true.yaw)) < RIGHT_YAW

    def result(self) -> FoundAgain:
        return FoundAgain(self._noticed, self._found, self._wrong, self._state)


def _run(watch: _Watch, robot: str, config: RobotConfig, grid: MapGrid, pose: SE2 | None, feed: Feed) -> None:
    localization = replace(config.localization, initial_pose=pose, covariance=(0.01, 0.01, 0.003))
    executor = watch.executor = localization_executor(replace(config, localization=localization), robot, grid)
    with executor:
        executor.tap(watch.on_message)
        executor.run(feed=feed)


def _truth(drive: RandomDrive) -> list[tuple[int, SE2]]:
    """True poses of a drive in the map of its world."""
    rows = []
    for recorded in read_recording(drive.recording, [TRUE_POSE.ros_name]):
        message = recorded.decode_as(Odometry)
        rows.append((message.stamp_ns, drive.truth.pose(message.pose.to_se2())))
    return rows


def _until(feed: Feed, end_ns: int) -> Feed:
    for topic, message, time_ns in feed:
        if time_ns > end_ns:
            return
        yield topic, message, time_ns


def _spliced(before: Path, after: Path, jump_ns: int) -> Feed:
    """Play one drive until the jump, then another: later stamps, and its odometry continued from where the first one's ended."""
    odom_at_jump = SE2()
    for topic, message, time_ns in _until(sensor_feed(before), jump_ns):
        if isinstance(message, Odometry):
            odom_at_jump = message.pose.to_se2()
        yield topic, message, time_ns
    first: SE2 | None = None
    for topic, message, time_ns in sensor_feed(after):
        assert isinstance(message, (LaserScan, PointCloud, Odometry, Imu))
        moved = replace(message, stamp_ns=message.stamp_ns + jump_ns)
        if isinstance(moved, Odometry):
            first = moved.pose.to_se2() if first is None else first
            continued = odom_at_jump @ first.inverse() @ moved.pose.to_se2()
            moved = replace(moved, pose=SE3.from_se2(continued))
        yield topic, moved, time_ns + jump_ns + 1_000_000


def pairs_far_apart(
    drives: Sequence[DriveCase], count: int, rng: np.random.Generator
) -> list[tuple[DriveCase, DriveCase]]:
    """Draw `count` pairs of drives of one world whose starts lie at least 2 m apart."""
    starts = [start_of(drive).as_array()[:2] for drive in drives]
    pairs: list[tuple[DriveCase, DriveCase]] = []
    while len(pairs) < count:
        a, b = rng.integers(len(drives), size=2)
        if drives[a].world == drives[b].world and math.dist(starts[a], starts[b]) > 2.0:
            pairs.append((drives[a], drives[b]))
    return pairs
