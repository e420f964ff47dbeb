"""The share of a run that its recoveries took, out of what the navigator said."""

from __future__ import annotations

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.core.messages import Status
from ambler.evaluation.exploration_run import ExplorationRecord

S = 1_000_000_000


def record(*told: tuple[float, str], node: str = "navigator", seconds: float = 100.0) -> ExplorationRecord:
    stamps = np.array([0, round(seconds * S)], np.int64)
    none = np.zeros((0, 3))
    statuses = tuple(Status(round(t * S), node, code, "") for t, code in told)
    grid = (GridSpec(0.05, 0, 0, 0.0, 0.0), np.zeros((0, 0), np.int8))
    return ExplorationRecord(
        stamps, np.zeros((2, 3)), np.zeros(2), stamps[:0], none, np.zeros((0, 2)), (), grid, statuses
    )


def test_recovering_and_waiting_count_until_the_next_state() -> None:
    told = ((0, "PLANNING"), (1, "FOLLOWING"), (20, "RECOVERING"), (24, "PLANNING"), (25, "FOLLOWING"), (60, "WAITING"))
    assert record(*told, (61, "FOLLOWING"), (90, "SUCCEEDED")).recovery_ratio == pytest.approx(0.05)


def test_what_lasts_to_the_end_counts_to_the_end() -> None:
    assert record((0, "FOLLOWING"), (90, "RECOVERING")).recovery_ratio == pytest.approx(0.10)


def test_words_beside_the_states_end_nothing() -> None:
    told = ((0, "FOLLOWING"), (90, "RECOVERING"), (91, "GOAL_REFUSED"), (92, "CLICKED_GOAL_OVER"), (95, "FOLLOWING"))
    assert record(*told).recovery_ratio == pytest.approx(0.05)


def test_other_nodes_do_not_recover() -> None:
    assert record((0, "RECOVERING"), node="docking").recovery_ratio == 0.0


def test_without_a_run_there_is_no_share() -> None:
    nothing = record()
    empty = ExplorationRecord(
        *(getattr(nothing, n)[:0] for n in ("true_stamps_ns", "true_poses", "speeds")),
        *(getattr(nothing, n) for n in ("stamps_ns", "poses", "coverage", "contacts", "true_map")),
    )
    assert empty.recovery_ratio is None
