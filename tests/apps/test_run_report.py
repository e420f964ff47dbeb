"""The report of a scripted run: what went wrong is told first and marked on the map, and every number has its words."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ambler.apps.console import Stages
from ambler.apps.run_report import _marks, write_run_report
from ambler.core.grid import GridSpec
from ambler.evaluation.metrics import METRICS
from ambler.wire.map_files import save_map
from tests.apps.test_judgement import GOALS, judged


def reported(root: Path, failure: str | None = None, **options: Any) -> tuple[dict[str, Any], str, list[str]]:
    """Report a run that hit a wall at 5 s; returns report.json, the page, and the words of the marks on the map."""
    verdict, run = judged(root, [(5.0, "wall_3", 0.2)], slam_error=0.05, failure=failure)
    robot = cast(Any, run.robot)
    robot.options = SimpleNamespace(**{**vars(robot.options), "seed": 3, **options})
    robot.folder.config.write_text("robot: {}\n")
    stem = robot.folder.map_stem if robot.options.makes_map else robot.folder.known_map_stem
    save_map(stem, GridSpec(0.05, 100, 80, -1.0, -2.0), np.zeros((80, 100), np.int8))
    errors = np.full(len(verdict.trajectory.errors), 0.01)  # type: ignore[union-attr]
    errors[120] = 0.4
    trajectory = replace(verdict.trajectory, errors=errors, offsets=2.0 * errors)  # type: ignore[type-var]
    verdict = replace(verdict, trajectory=trajectory)
    page = write_run_report(robot, verdict)
    marks = [mark.text for mark in _marks(robot, verdict)]
    return json.loads((root / "report.json").read_text()), page.read_text(), marks


def test_a_collision_and_the_largest_error_are_told_and_marked(tmp_path: Path) -> None:
    record, page, marks = reported(tmp_path)
    assert '<div class="verdict bad"><b>succeeded</b>a collision' in page
    assert marks[:2] == ["goal 1", "goal 2"]
    assert "largest error 40.0 cm at 12.0 s" in marks
    assert "wall_3 hit at 5.0 s" in marks
    assert set(record["pictures"].values()) == {"map.png", "trajectory_error.png", "speed.png"}
    assert set(record["results"]) <= set(METRICS), "a field that nobody explained"
    assert len(GOALS) == 2


def test_what_a_recording_did_not_hold_is_not_told_as_nothing(tmp_path: Path) -> None:
    record, page, _ = reported(tmp_path, failure="no space left")
    assert '<div class="verdict bad"><b>not recorded</b>' in page
    assert "Collisions, as far as they are known" in page
    assert record["passed"]["collisions"] is False
    assert record["results"]["collisions"] is None


def test_in_a_known_map_errors_are_told_as_they_are_and_nothing_of_coverage(tmp_path: Path) -> None:
    record, page, marks = reported(tmp_path, makes_map=False)
    assert "largest error 80.0 cm at 12.0 s" in marks
    assert "in the known map" in page
    assert "Coverage over time" not in page
    assert "coverage.png" not in record["pictures"].values()


def test_long_work_is_told_and_short_work_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    with Stages(patience=0.05, period=0.05) as stages:
        stages.begin("short")
        stages.begin("long")
        timer = stages._timer
        while timer is stages._timer:
            assert timer is not None
            timer.join()
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith("long ... ")
    assert not any("short" in line for line in told)
    assert stages._timer is None
