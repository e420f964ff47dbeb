"""Limits of a run under a fault: each one can be broken alone, and nothing unknown passes."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ambler.core.grid import GridSpec
from ambler.evaluation.exploration_run import ExplorationRecord
from ambler.evaluation.fault_limits import FaultLimits, FaultOutcome, broken_limits, top_speed_while_standing

LIMITS = FaultLimits(("finished", "lost"), (0.5, 0.7), 0.10, ("STALE_POINTS",), (15.0, 19.0))
GOOD = FaultOutcome("lost", 0, 0.6, 0.05, 0.01, "GATE STALE_POINTS: laser")


def record(seconds: np.ndarray, speeds: np.ndarray) -> ExplorationRecord:
    n = len(seconds)
    stamps = np.round(seconds * 1e9).astype(np.int64)
    poses, none = np.zeros((n, 3)), np.zeros((0, 2))
    return ExplorationRecord(
        stamps, poses, speeds, stamps, poses, none, (), (GridSpec(0.05, 0, 0, 0.0, 0.0), np.zeros((0, 0), np.int8))
    )


def test_what_holds_breaks_nothing() -> None:
    assert broken_limits(LIMITS, GOOD) == ()
    assert broken_limits(FaultLimits(), FaultOutcome("finished", 0)) == (), "no limit asks for what is unknown"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"collisions": 1}, "1 collisions"),
        ({"collisions": None}, "unknown collisions"),
        ({"ended": "time_limit"}, "ended as time_limit"),
        ({"coverage_ratio": 0.49}, "coverage is 0.490"),
        ({"coverage_ratio": 0.71}, "coverage is 0.710"),
        ({"coverage_ratio": None}, "coverage is unknown"),
        ({"ate_rms_m": 0.11}, "trajectory error is 0.110 m"),
        ({"ate_rms_m": math.nan}, "trajectory error is nan m"),
        ({"top_speed": 0.03}, "drove at 0.030 m/s"),
        ({"top_speed": None}, "drove at unknown m/s"),
        ({"log": "all is well"}, "does not say STALE_POINTS"),
    ],
)
def test_every_limit_breaks_alone_and_says_how(change: dict[str, Any], words: str) -> None:
    broken = broken_limits(LIMITS, replace(GOOD, **change))
    assert len(broken) == 1
    assert words in broken[0]


def test_the_robot_may_brake_before_it_must_stand() -> None:
    seconds = np.arange(0.0, 25.0, 0.02)
    speeds = np.where((seconds < 16.0) | (seconds >= 19.0), 0.5, 0.004)
    assert top_speed_while_standing(record(seconds, speeds), (15.0, 19.0)) == pytest.approx(0.004)
    assert top_speed_while_standing(record(seconds, speeds), (14.5, 19.0)) == pytest.approx(0.5)
    assert top_speed_while_standing(record(seconds, speeds), (15.0, 19.5)) == pytest.approx(0.5)
    assert top_speed_while_standing(record(seconds, speeds), (15.0, math.inf)) == pytest.approx(0.5)
    assert top_speed_while_standing(record(seconds, speeds), (40.0, math.inf)) is None, "nothing was recorded then"


def test_limits_read_as_one_line() -> None:
    assert str(LIMITS) == "finished or lost, coverage 50% … 70%, error ≤ 10 cm, stands, says STALE_POINTS"
    assert str(FaultLimits(coverage=(0.95, 1.0))) == "finished, coverage ≥ 95%"
