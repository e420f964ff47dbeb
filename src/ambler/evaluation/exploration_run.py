"""Judges an exploration from its recording alone: ground truth against what the stack believed."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.grid import OCC_FREE, GridSpec
from ambler.core.messages import Contact, OccupancyGrid, Odometry, PoseStamped, Status
from ambler.evaluation.truth_frame import TruthFrame, start_frame
from ambler.runtime import topics
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

_TOPICS = (
    *(topics.TRUE_POSE, topics.SLAM_POSE, topics.LOCALIZED_POSE),
    *(topics.MAP, topics.TRUE_MAP, topics.CONTACT, topics.STATUS),
)
NAVIGATOR = "navigator"
RECOVERING = ("RECOVERING", "GIVING_WAY")  # what it says of itself while it does not drive to its goal


@dataclass(frozen=True, slots=True, eq=False)
class ExplorationRecord:
    """What a recording says. Poses float64 (N, 3) in one map frame, with stamps int64 (N,); `speeds` float64 (N,) m/s of the
    truth; `coverage` float64 (K, 2) of seconds and the share of the truly free cells known as free; maps as (spec, int8); `recovery_seconds` is how long navigations were
    recovering."""

    true_stamps_ns: NDArray[np.int64]
    true_poses: NDArray[np.float64]
    speeds: NDArray[np.float64]
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    coverage: NDArray[np.float64]
    contacts: tuple[Contact, ...]
    true_map: tuple[GridSpec, NDArray[np.int8]]
    recovery_seconds: float = 0.0

    @property
    def path_length(self) -> float:
        """Length of the true path, metres, sampled every 0.2 s so that the gait does not count."""
        return float(np.sum(np.hypot(*np.diff(self.true_poses[::10, :2], axis=0).T)))


def read_exploration(
    recording: Path, frame: TruthFrame | None = None, truth_in: Path | None = None
) -> ExplorationRecord:
    """Read the record of a run; truth is told in the map `frame` (None: the one that begins at the start pose). `truth_in` is the recording
    that holds the ground truth, where it is another one. Raises BadInputError if a recording cannot be read, or tells no start pose."""
    source = truth_in if truth_in is not None else recording
    frame = frame if frame is not None else start_frame(source)
    told = read_recording(recording, [t.ros_name for t in _TOPICS])
    if truth_in is not None:
        told = chain(read_recording(truth_in, [t.ros_name for t in _TOPICS if t.is_truth]), told)
    truth, estimate = _Rows(4), _Rows(3)
    coverage: list[tuple[float, float]] = []
    contacts: list[Contact] = []
    states: list[tuple[int, str]] = []
    true_map: tuple[GridSpec, NDArray[np.int8]] | None = None
    known: KnownShare | None = None
    for recorded in told:
        topic = topics.topic_named(recorded.topic)
        message = decode(topic.type, recorded.data)
        if topic is topics.TRUE_POSE and isinstance(message, Odometry):
            pose = frame.pose(message.pose.to_se2())
            truth.add(message.stamp_ns, pose.x, pose.y, pose.yaw, math.hypot(*message.linear[:2]))
        elif isinstance(message, PoseStamped | Odometry):  # of SLAM, or of localization
            pose = message.pose.to_se2()
            estimate.add(message.stamp_ns, pose.x, pose.y, pose.yaw)
        elif isinstance(message, Status):
            if message.node.rpartition("/")[2] == NAVIGATOR:
                states.append((message.stamp_ns, message.code))
        elif isinstance(message, Contact):
            contacts.append(message)
        elif topic is topics.TRUE_MAP and isinstance(message, OccupancyGrid):
            true_map = frame.grid(message)
            known = KnownShare(true_map)
        elif isinstance(message, OccupancyGrid) and known is not None:
            begun_ns = truth.stamps_ns[0] if truth.stamps_ns else recorded.log_time_ns
            coverage.append(((recorded.log_time_ns - begun_ns) * 1e-9, known.of(message.spec, message.data)))
    if true_map is None:
        true_map = (GridSpec(0.05, 0, 0, 0.0, 0.0), np.zeros((0, 0), np.int8))
    (true_stamps_ns, true_rows), (stamps_ns, poses) = truth.arrays(), estimate.arrays()
    return ExplorationRecord(
        *(true_stamps_ns, true_rows[:, :3], true_rows[:, 3]),
        *(stamps_ns, poses),
        np.array(coverage).reshape(-1, 2),
        tuple(contacts),
        true_map,
        seconds_in(RECOVERING, states),
    )


class _Rows:
    """Stamped rows of numbers, packed: as tuples, those of an hour would take tens of megabytes."""

    def __init__(self, width: int) -> None:
        self._width = width
        self.stamps_ns = array("q")
        self._values = array("d")

    def add(self, stamp_ns: int, *values: float) -> None:
        self.stamps_ns.append(stamp_ns)
        self._values.extend(values)

    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return stamps (N,) and rows (N, width)."""
        return np.array(self.stamps_ns, np.int64), np.array(self._values, np.float64).reshape(-1, self._width)


def seconds_in(wanted: Collection[str], states: Sequence[tuple[int, str]]) -> float:
    """Return how long a machine was in one of the wanted states that tells (stamp in ns, state) whenever it enters one."""
    return 1e-9 * sum(b[0] - a[0] for a, b in pairwise(states) if a[1] in wanted)


class KnownShare:
    """Tells of maps which share of the truly free cells they call free, without alignment. `truth`: geometry and int8 [iy, ix]."""

    def __init__(self, truth: tuple[GridSpec, NDArray[np.int8]]) -> None:
        self._spec, cells = truth
        self._is_free = cells == OCC_FREE
        self._count = max(1, int(np.count_nonzero(self._is_free)))

    def of(self, spec: GridSpec, cells: NDArray[np.int8]) -> float:
        """Return the share of a map."""
        rows, columns = _indices(self._spec, spec)
        inside_y, inside_x = (
            np.flatnonzero((k >= 0) & (k < n)) for k, n in ((rows, spec.height), (columns, spec.width))
        )
        is_free = _block(self._is_free, inside_y, inside_x)
        is_known = _block(cells, rows[inside_y], columns[inside_x]) == OCC_FREE
        return float(np.count_nonzero(is_free & is_known)) / self._count


def _block(grid: NDArray[Any], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[Any]:
    """Return rows and columns of a grid: where they follow one another without a copy, because a hall has millions of cells and thousands of maps."""
    if len(rows) == 0 or len(columns) == 0:
        return grid[:0, :0]
    if (np.diff(rows) == 1).all() and (np.diff(columns) == 1).all():
        return grid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return grid[np.ix_(rows, columns)]


def _indices(of: GridSpec, within: GridSpec) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and the columns of another grid in which the middles of a grid's rows and columns lie."""
    rows = np.stack((np.arange(of.height), np.zeros(of.height, np.intp)), axis=1)
    columns = np.stack((np.zeros(of.width, np.intp), np.arange(of.width)), axis=1)
    return within.cells_of(of.centers_of(rows))[:, 0], within.cells_of(of.centers_of(columns))[:, 1]
