"""How far the poses that a replay of a live run tells lie from those that the run told itself, at the same stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ambler.core.messages import Odometry, PoseStamped
from ambler.core.se2 import SE2
from ambler.runtime.topics import LOCALIZED_POSE, SLAM_POSE
from ambler.wire.mcap_reader import read_recording

TOLERANCE = 0.05  # metres within which 95 % of the poses of a live run and of its replay must lie
LEAST = 0.5  # share of the recorded poses that the replay must tell, too


@dataclass(frozen=True, slots=True)
class PoseDifference:
    """Distances in metres between `common` poses of equal stamps, of `recorded` ones; infinite when there are none."""

    recorded: int
    common: int
    median_m: float
    p95_m: float

    @property
    def is_within(self) -> bool:
        """Whether the replay tells most of the poses, and 95 % of them within TOLERANCE."""
        return self.common >= LEAST * self.recorded and self.p95_m <= TOLERANCE


def pose_difference(recording: Path, replayed: Sequence[tuple[int, PoseStamped | Odometry]]) -> PoseDifference:
    """Compare the poses of a recording with those of a replay, (stamp ns, message) each."""
    again: dict[int, SE2] = {stamp: message.pose.to_se2() for stamp, message in replayed}
    away, recorded = [], 0
    for entry in read_recording(recording, [SLAM_POSE.ros_name, LOCALIZED_POSE.ros_name]):
        message = entry.decode()
        assert isinstance(message, PoseStamped | Odometry)
        recorded += 1
        if message.stamp_ns in again:
            away.append(message.pose.to_se2().distance_to(again[message.stamp_ns]))
    if not away:
        return PoseDifference(recorded, 0, float("inf"), float("inf"))
    return PoseDifference(recorded, len(away), float(np.median(away)), float(np.percentile(away, 95)))
