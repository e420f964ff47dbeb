"""Time in recoveries is told by the states that a navigation enters."""

from pathlib import Path

import numpy as np
import pytest

from ambler.bridges.recorder import Recorder
from ambler.core.grid import GridSpec
from ambler.core.messages import OccupancyGrid, Status
from ambler.core.se2 import SE2
from ambler.evaluation.exploration_run import read_exploration, seconds_in
from ambler.evaluation.truth_frame import TruthFrame
from ambler.runtime.topics import STATUS, TRUE_MAP

S = 1_000_000_000


def test_a_state_lasts_until_the_next_one() -> None:
    states = [(0, "PLANNING"), (1 * S, "RECOVERING"), (4 * S, "PLANNING"), (5 * S, "RECOVERING"), (7 * S, "RECOVERING")]
    assert seconds_in(("RECOVERING",), [*states, (8 * S, "FAILED")]) == 6.0
    assert seconds_in(("RECOVERING",), []) == 0.0


def test_only_the_navigator_of_a_recording_counts(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "recording")
    grid = OccupancyGrid(0, "world", GridSpec(0.05, 4, 4, 0.0, 0.0), np.zeros((4, 4), np.int8))
    recorder.on_message(TRUE_MAP, grid, 0)
    for seconds, node, code in (
        (1, "navigator", "RECOVERING"),
        (2, "explorer", "DRIVING"),
        (3, "gate", "RECOVERING"),
        (4, "navigator", "FOLLOWING"),
        (9, "navigator", "SUCCEEDED"),
    ):
        recorder.on_message(STATUS, Status(seconds * S, node, code, ""), seconds * S)
    recorder.close()
    assert read_exploration(tmp_path / "recording", TruthFrame(SE2())).recovery_seconds == pytest.approx(3.0)
