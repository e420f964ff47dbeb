"""Every verb in the live executor: the map is latched, so whoever subscribes late localizes, too; and a program of all in one run."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambler.apps.judgement import judge
from ambler.apps.run_folder import RunFolder
from ambler.apps.simulated import SimulatedRun
from ambler.runtime.topics import VELOCITY_COMMAND, Topic
from ambler.studies.live_study import VERBS

pytestmark = pytest.mark.live


# Docking live in one process with its camera and its simulator needs 1.2 cores to itself: `ambler eval live` runs it ten times.
@pytest.mark.parametrize("verb", ["navigate_lost", pytest.param("dock", marks=pytest.mark.slow), "undock"])
def test_a_verb_works_in_real_time(verb: str, tmp_path: Path) -> None:
    run = SimulatedRun(replace(VERBS[verb](0), is_realtime=True), RunFolder(tmp_path / "run"))
    try:
        run.run()
        fields = judge(run).fields
    finally:
        run.close()
    assert fields["ended"] == "succeeded", run.text
    assert fields["collisions"] == 0
    if verb == "dock":
        assert fields["dock_error_m"] < 0.005
    if verb == "navigate_lost":
        assert fields["worst_goal_error_m"] < 0.25


def test_a_live_robot_is_under_command_while_its_run_is_ended(tmp_path: Path) -> None:
    """Whoever watches the run hangs just when its time is over: the gate commands on until the map is saved."""
    limit = 4.0
    run = SimulatedRun(replace(VERBS["explore"](0), is_realtime=True, time_limit=limit), RunFolder(tmp_path / "run"))
    commands: list[int] = []
    begin_ns = run.executor.now_ns
    hung: list[int] = []

    def watch(topic: Topic[Any], message: Any, time_ns: int, writer: str) -> None:
        if topic is VELOCITY_COMMAND:
            commands.append(message.stamp_ns - begin_ns)
        if time_ns - begin_ns > (limit - 0.2) * 1e9 and not hung:
            hung.append(time_ns)
            time.sleep(2.0)

    run.executor.tap(watch)
    try:
        run.run()
    finally:
        run.close()
    assert (run.ended, bool(hung)) == ("time_limit", True)
    assert (run.folder.root / "map.yaml").exists()
    assert max(np.diff(commands)) < 1e9
    assert commands[-1] > (limit - 0.1) * 1e9, (
        "the last one lies at most a period before the end, which may come right after the limit"
    )
