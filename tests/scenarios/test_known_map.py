"""A robot in a known map: it arrives without being told where it starts, and a recorded drive is localized to the millimetre."""

from pathlib import Path

import numpy as np
import pytest

from ambler.apps.judgement import judge
from ambler.apps.replay import replay_run
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions
from ambler.apps.simulated import SimulatedRun
from ambler.core.se2 import SE2
from ambler.nodes.steps import DockStep, NavigateStep, TeachStep, UndockStep
from ambler.studies.localization_study import METHODS, LocalizationCase, Place, joined_errors, localization_study
from ambler.studies.pool import ThisProcess
from ambler.studies.rail import Rail, Route
from ambler.studies.study import conduct
from tests.scenarios.conftest import explore


def test_a_rail_leads_along_its_way_points() -> None:
    rail, pose = Rail(Route(((2.0, 0.0), (2.0, 1.5)), speed=0.5, rest=0.1)), SE2()
    assert rail.compute_command(0.05, pose).vx == 0.0
    nearest = 9.0
    for k in range(600):
        command = rail.compute_command(0.1 + 0.02 * k, pose)
        pose = pose @ SE2.exp(0.02 * np.array([command.vx, command.vy, command.wz]))
        nearest = min(nearest, pose.distance_to(SE2(2.0, 0.0)))
    assert nearest < 0.3
    assert pose.distance_to(SE2(2.0, 1.5)) < 0.3
    assert command.vx == command.wz == 0.0


@pytest.mark.parametrize("is_lost", [True, False])
def test_a_robot_that_starts_elsewhere_arrives(is_lost: bool, tmp_path: Path) -> None:
    """The goal is told in the drawn map, whose origin is the world's start, wherever the robot begins."""
    options = RunOptions(
        (NavigateStep(SE2(3.0, 1.5, 0.0)),),
        "lab_empty",
        "amr_omni",
        start=SE2() if is_lost else SE2(1.0, 2.5, -1.0),
        is_lost=is_lost,
        may_turn=True,
        port=None,
        physics="kinematic",
    )
    run = SimulatedRun(options, RunFolder(tmp_path / "run"))
    try:
        run.run(60.0)
        fields = judge(run).fields
    finally:
        run.close()
    assert fields["ended"] == "succeeded"
    assert fields["collisions"] == 0
    assert fields["worst_goal_error_m"] < 0.2


def test_a_recorded_drive_is_localized_by_every_method(tmp_path: Path) -> None:
    route = Route(((2.0, 0.5), (3.0, 2.0)), speed=0.5)
    place = Place("lab", "lab_empty", route, 6.0, (SE2(2.0, 1.0, 1.0),), (0, 1, 2))
    cases = [
        LocalizationCase(place, 0, is_moving, 0, stand_time=2.0, methods=METHODS[2:]) for is_moving in (True, False)
    ]
    results = joined_errors(conduct(localization_study(cases), tmp_path, ThisProcess(), tell=lambda line: None))
    assert len(results) == 4
    for (_, method, is_moving), errors in results.items():
        assert errors.rms[:2].max() < 0.015, (method, is_moving)
        assert errors.nees.mean() < 4.0, (method, is_moving)
    assert len(list(tmp_path.rglob("true_pose.csv"))) == 2


def test_a_known_map_program_docks_leaves_drives_and_replays_to_the_same_bits(tmp_path: Path) -> None:
    steps = (DockStep("charger_1"), UndockStep("charger_1"), NavigateStep(SE2(-1.0, 0.5, 0.0)), DockStep("charger_1"))
    options = RunOptions((*steps, TeachStep("charger_1")), "dock_room", "amr_omni", 2, port=None, time_limit=180.0)
    run = explore(tmp_path / "run", options)
    fields = judge(run).fields
    assert fields["ended"] == "succeeded", run.text
    assert (fields["collisions"], fields["goals_reached"]) == (0, 1)
    assert fields["dock_error_m"] < 0.005
    replay = replay_run(run.folder.root, tmp_path / "replay")
    assert replay.comparison.is_equal, str(replay.comparison)
    assert {"/cmd_vel", "/dock_pose", "/localized_pose"} <= {t.topic for t in replay.comparison.topics}
