"""Judges an exploration from its recording alone: ground truth against what the stack believed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import OCC_FREE, GridSpec
from ambler.core.messages import Contact, OccupancyGrid, Odometry, PoseStamped
from ambler.evaluation.truth_frame import start_frame
from ambler.runtime import topics
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

_TOPICS = (topics.TRUE_POSE, topics.SLAM_POSE, topics.MAP, topics.TRUE_MAP, topics.CONTACT)


@dataclass(frozen=True, slots=True, eq=False)
class ExplorationRecord:
    """What a recording says. Poses float64 (N, 3) in the map frame, which begins at the start pose, with stamps int64 (N,); `speeds` float64 (N,) m/s of the
    truth; `coverage` float64 (K, 2) of seconds and the share of the truly free cells known as free; maps as (spec, int8)."""

    true_stamps_ns: NDArray[np.int64]
    true_poses: NDArray[np.float64]
    speeds: NDArray[np.float64]
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    coverage: NDArray[np.float64]
    contacts: tuple[Contact, ...]
    true_map: tuple[GridSpec, NDArray[np.int8]]

    @property
    def path_length(self) -> float:
        """Length of the true path, metres, sampled every 0.2 s so that the gait does not count."""
        return float(np.sum(np.hypot(*np.diff(self.true_poses[::10, :2], axis=0).T)))


def read_exploration(recording: Path) -> ExplorationRecord:
    """Read the record of an exploration; raises BadInputError if the recording cannot be read, or tells no start pose."""
    truth: list[tuple[int, float, float, float, float]] = []
    estimate: list[tuple[int, float, float, float]] = []
    coverage: list[tuple[float, float]] = []
    contacts: list[Contact] = []
    true_map: tuple[GridSpec, NDArray[np.int8]] | None = None
    frame = start_frame(recording)
    for recorded in read_recording(recording, [t.ros_name for t in _TOPICS]):
        message = decode(topics.topic_named(recorded.topic).type, recorded.data)
        if isinstance(message, Odometry):
            pose = frame.pose(message.pose.to_se2())
            truth.append((message.stamp_ns, pose.x, pose.y, pose.yaw, float(np.hypot(*message.linear[:2]))))
        elif isinstance(message, PoseStamped):
            pose = message.pose.to_se2()
            estimate.append((message.stamp_ns, pose.x, pose.y, pose.yaw))
        elif isinstance(message, Contact):
            contacts.append(message)
        elif isinstance(message, OccupancyGrid) and recorded.topic == topics.TRUE_MAP.ros_name:
            true_map = frame.grid(message)
        elif isinstance(message, OccupancyGrid) and true_map is not None:
            coverage.append((recorded.log_time_ns * 1e-9, known_share((message.spec, message.data), true_map)))
    if true_map is None:
        true_map = (GridSpec(0.05, 0, 0, 0.0, 0.0), np.zeros((0, 0), np.int8))
    true_rows, rows = np.array(truth).reshape(-1, 5), np.array(estimate).reshape(-1, 4)
    return ExplorationRecord(
        np.array([t[0] for t in truth], np.int64),
        true_rows[:, 1:4],
        true_rows[:, 4],
        np.array([e[0] for e in estimate], np.int64),
        rows[:, 1:4],
        np.array(coverage).reshape(-1, 2),
        tuple(contacts),
        true_map,
    )


def known_share(built: tuple[GridSpec, NDArray[np.int8]], truth: tuple[GridSpec, NDArray[np.int8]]) -> float:
    """Return the share of the truly free cells that the built map calls free, without alignment."""
    built_spec, built_cells = built
    truth_spec, truth_cells = truth
    free = np.argwhere(truth_cells == OCC_FREE)
    cells = built_spec.cells_of(truth_spec.centers_of(free))
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < built_spec.height) & (cells[:, 1] < built_spec.width)
    known = built_cells[cells[inside, 0], cells[inside, 1]] == OCC_FREE
    return float(np.count_nonzero(known)) / max(1, len(free))
