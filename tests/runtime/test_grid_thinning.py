"""Large grids are recorded more rarely, the last one always, and a replay compares those that were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ambler.bridges.recorder import Recorder
from ambler.core.grid import GridSpec
from ambler.core.messages import CostGrid, OccupancyGrid, PoseStamped
from ambler.core.se3 import SE3
from ambler.evaluation.recording_compare import ReplayComparison
from ambler.runtime import topics
from ambler.runtime.grid_thinning import CELLS_PER_SECOND, GridThinning
from ambler.wire.mcap_reader import read_recording

SECOND = 1_000_000_000


def _map(edge: int, second: int) -> OccupancyGrid:
    cells = np.zeros((edge, edge), np.int8)
    cells.reshape(-1)[second] = 100
    return OccupancyGrid(second * SECOND, "map", GridSpec(0.05, edge, edge, 0.0, 0.0), cells)


def _taken(edge: int, seconds: int, writer: str = "slam2d") -> list[int]:
    thinning = GridThinning()
    return [k for k in range(seconds) if thinning.takes(topics.MAP, _map(edge, k), k * SECOND, writer)]


def test_small_grids_are_all_recorded_and_large_ones_by_their_cells() -> None:
    assert CELLS_PER_SECOND >= 700 * 700, "an office is recorded whole, every second"
    assert _taken(700, 10) == list(range(10))
    assert _taken(1500, 20) == [0, 5, 10, 15], "2.25 million cells: every 4.5 s at most"
    assert _taken(1500, 5, writer="") == list(range(5)), "what came from outside is fed to a replay"


def test_a_clock_that_is_set_back_ends_no_recording() -> None:
    """Live, times of delivery are the system's."""
    thinning = GridThinning()
    seconds = [4000, 4001, 400, 401, 402]
    taken = [k for k in seconds if thinning.takes(topics.MAP, _map(1000, k), k * SECOND, "slam2d")]
    assert taken == [4000, 400, 402]


def test_each_topic_counts_for_itself_and_what_is_no_grid_is_recorded() -> None:
    thinning = GridThinning()
    costs = CostGrid(0, "map", GridSpec(0.05, 1000, 1000, 0.0, 0.0), np.zeros((1000, 1000), np.uint8))
    pose = PoseStamped(0, "map", SE3())
    for k in range(4):
        assert thinning.takes(topics.MAP, _map(1000, k), k * SECOND, "slam2d") == (k % 2 == 0)
        assert thinning.takes(topics.GLOBAL_COSTMAP, costs, k * SECOND + 1, "planner") == (k % 2 == 0)
        assert thinning.takes(topics.SLAM_POSE, pose, k * SECOND, "slam2d")
    assert [(grid.topic, grid.time_ns) for grid in thinning.rest()] == [
        (topics.MAP, 3 * SECOND),
        (topics.GLOBAL_COSTMAP, 3 * SECOND + 1),
    ]
    assert not thinning.rest()


@pytest.mark.parametrize("changed", [None, 2, 4, 7])
def test_the_last_map_is_in_the_recording_and_a_replay_of_it_is_equal(tmp_path: Path, changed: int | None) -> None:
    recorder = Recorder(tmp_path / "run")
    for k in range(8):
        recorder.on_message(topics.MAP, _map(1000, k), k * SECOND, "slam2d")
        recorder.on_message(topics.SLAM_POSE, PoseStamped(k * SECOND, "map", SE3()), k * SECOND, "slam2d")
    recorder.close()
    told = [recorded for recorded in read_recording(tmp_path / "run") if recorded.topic == topics.MAP.ros_name]
    assert [recorded.log_time_ns // SECOND for recorded in told] == [0, 2, 4, 6, 7]
    assert np.flatnonzero(told[-1].decode_as(OccupancyGrid).data) == 7
    comparison = ReplayComparison(read_recording(tmp_path / "run"), [topics.MAP.ros_name])
    for k in range(8):
        comparison.on_message(topics.MAP, _map(1000, 99 if k == changed else k), k * SECOND, "slam2d")
    assert comparison.result().is_equal == (changed is None)
