"""A scripted run is judged from its recording: errors, contacts and ends that are known beforehand come out as they were put in."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ambler.apps.config import RobotConfig
from ambler.apps.docks import dock_of_world
from ambler.apps.judgement import Verdict, is_good, judge, missing_floor
from ambler.apps.run_folder import RunFolder
from ambler.apps.simulated import SimulatedRun
from ambler.bridges.recorder import Recorder
from ambler.core.grid import GridSpec
from ambler.core.messages import BatteryState, Contact, OccupancyGrid, Odometry, PoseStamped, PowerSupply
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.missions.dock_commands import DockResult
from ambler.nodes.steps import DockStep, ExploreStep, NavigateStep, StepEnd, UndockStep
from ambler.runtime.tasks import ExploreResult
from ambler.runtime.topics import BATTERY, CONTACT, SLAM_POSE, TRUE_MAP, TRUE_POSE
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world
from ambler.studies.docking_study import DockingCase, _outcome

S = 1_000_000_000
WORLD = load_world("dock_hall")
WORLD_FROM_MAP = WORLD.start @ SE2(1.0, -0.5, 0.7)  # a map that the robot made itself
DOCK = dock_of_world(WORLD, "charger_1").world_from_dock
DOCKED = DOCK @ SE2(0.02, -0.015, math.radians(1.5))
GOALS = (SE2(2.0, 0.0, 0.0), SE2(4.0, 0.0, 0.0))
ENDS = (
    StepEnd(NavigateStep(GOALS[0]), "SUCCEEDED", "", None, 0, 4 * S),
    StepEnd(NavigateStep(GOALS[1]), "SUCCEEDED", "", None, 4 * S, 8 * S),
    StepEnd(NavigateStep(SE2(0.0, 9.0, 0.0)), "NO_VALID_PATH", "", None, 8 * S, 9 * S),
    StepEnd(DockStep("charger_1"), "SUCCEEDED", "", DockResult(2, 20.0, 7.0, None, None), 9 * S, 29 * S),
)


def true_pose(seconds: float) -> SE2:
    """Where the robot truly is in the world: along x of the map, 10 cm beside the second goal, then docked."""
    if seconds >= 20.0:
        return DOCKED
    return WORLD_FROM_MAP @ SE2(0.5 * min(seconds, 8.0), 0.1 if seconds > 6.0 else 0.0, 0.0)


def record(folder: Path, contacts: list[tuple[float, str, float]], slam_error: float) -> None:
    """Record 30 s; SLAM is `slam_error` metres off to the left and to the right in turn."""
    recorder, zero, cells = Recorder(folder), np.zeros((6, 6)), np.zeros((40, 60), np.int8)
    grid = GridSpec(0.05, 60, 40, 0.0, 0.0)
    recorder.on_message(TRUE_MAP, OccupancyGrid(0, "world", grid, cells), 0)
    for k in range(301):
        seconds, stamp = 0.1 * k, k * S // 10
        world = true_pose(seconds)
        told = WORLD_FROM_MAP.inverse() @ world @ SE2(0.0, slam_error if k % 2 else -slam_error, 0.0)
        pose = Odometry(stamp, "world", "base", SE3.from_se2(world), (0.5, 0.0, 0.0), (0.0,) * 3, zero, zero)
        recorder.on_message(TRUE_POSE, pose, stamp)
        recorder.on_message(SLAM_POSE, PoseStamped(stamp, "map", SE3.from_se2(told)), stamp)
    for seconds, other, speed in contacts:
        stamp = round(seconds * S)
        recorder.on_message(CONTACT, Contact(stamp, "body", other, (0.0, 0.0, 0.0), speed, 20.0), stamp)
    for stamp, supply in ((0, PowerSupply.DISCHARGING), (29 * S, PowerSupply.CHARGING)):
        recorder.on_message(BATTERY, BatteryState(stamp, "base", 24.0, 1.0, 0.5, supply), stamp)
    recorder.close()


def judged(
    root: Path,
    contacts: list[tuple[float, str, float]] | None = None,
    slam_error: float = 0.0,
    ends: tuple[StepEnd, ...] = ENDS,
    failure: str | None = None,
) -> tuple[Verdict, SimulatedRun]:
    """Record the run, and judge it with a stand-in for its robot."""
    folder = RunFolder(root)
    record(folder.recording, contacts or [], slam_error)
    robot = SimpleNamespace(
        stack=SimpleNamespace(node=lambda name: None),
        folder=folder,
        model=robot_named("amr_omni").model,
        config=RobotConfig(),
        scene=SimpleNamespace(world=WORLD),
        world_from_map=WORLD_FROM_MAP,
        options=SimpleNamespace(is_apart=False, robot="amr_omni", makes_map=True, is_unknown=False, docks_wanted=True),
        steps=tuple(end.step for end in ends),
        end=SimpleNamespace(ends=ends),
    )
    run = SimpleNamespace(
        robot=robot,
        end=robot.end,
        ended="succeeded",
        ended_of=lambda _: "succeeded",
        text_of=lambda _: "",
        recording_failure_of=lambda _: failure,
        run_seconds=30.0,
        wall_seconds=10.0,
        memory_mb=300.0,
        cpu_seconds=20.0,
    )
    return judge(cast(Any, run)), cast(SimulatedRun, run)


def test_drives_are_judged_by_where_the_robot_truly_stood(tmp_path: Path) -> None:
    fields = judged(tmp_path)[0].fields
    assert (fields["goals"], fields["goals_reached"]) == (3, 2)
    assert fields["worst_goal_error_m"] == pytest.approx(0.1, abs=1e-6)
    assert fields["real_time_factor"] == pytest.approx(3.0)


def test_a_docked_robot_is_judged_in_the_docks_frame(tmp_path: Path) -> None:
    fields = judged(tmp_path)[0].fields
    assert fields["dock_error_x_m"] == pytest.approx(0.02, abs=1e-6)
    assert fields["dock_error_y_m"] == pytest.approx(-0.015, abs=1e-6)
    assert fields["dock_error_yaw_deg"] == pytest.approx(1.5, abs=1e-4)
    assert fields["dock_error_m"] == pytest.approx(0.025, abs=1e-6)
    assert (fields["dock_code"], fields["dock_attempts"], fields["dock_final_seconds"]) == ("SUCCEEDED", 2, 7.0)
    assert fields["battery_supply"] == "charging"


def test_an_undocked_robot_is_told_where_it_stands_before_the_dock(tmp_path: Path) -> None:
    undocked = StepEnd(UndockStep("charger_1"), "SUCCEEDED", "", DockResult(0, 5.0, 0.0, None, None), 9 * S, 29 * S)
    fields = judged(tmp_path, ends=(undocked,))[0].fields
    assert (fields["undock_x_m"], fields["undock_y_m"]) == pytest.approx((0.02, -0.015), abs=1e-6)
    assert fields["dock_error_m"] is None, "it did not dock"


def test_the_contacts_of_a_dock_may_be_touched_and_nothing_else(tmp_path: Path) -> None:
    for k, (name, count) in enumerate(
        [("charger_1_contacts", 0), ("charger_1_body", 1), ("charger_1_panel", 1), ("wall_3", 1)]
    ):
        verdict, _ = judged(tmp_path / str(k), [(20.0, name, 0.1)])
        assert verdict.fields["collisions"] == count, name
        assert is_good(verdict) == (count == 0)
    gentle, _ = judged(tmp_path / "gentle", [(5.0, "wall_3", 0.01)])
    assert gentle.fields["collisions"] == 0, "a centimetre per second is a touch"


def test_a_run_is_good_only_when_it_ended_well(tmp_path: Path) -> None:
    verdict, _ = judged(tmp_path)
    assert is_good(verdict)
    for ended in ("failed", "time_limit", "lost"):
        assert not is_good(replace(verdict, fields=verdict.fields | {"ended": ended}))


def test_of_a_run_whose_recording_ends_before_it_nothing_is_thought_to_be_known(tmp_path: Path) -> None:
    verdict, run = judged(tmp_path, failure="no space left on the device")
    assert verdict.fields["ended"] == "not_recorded"
    assert "no space left on the device" in verdict.fields["text"]
    assert not is_good(verdict)
    for name in ("collisions", "path_length_m", "ate_rms_m", "goals_reached", "dock_error_x_m"):
        assert verdict.fields[name] is None, name
    outcome = _outcome(DockingCase("random", 4, SE2(), 3.0), run, verdict.fields)
    assert (outcome.is_docked, outcome.code, outcome.error) == (False, "NOT_RECORDED", None)


def test_slams_error_is_that_of_its_poses(tmp_path: Path) -> None:
    fields = judged(tmp_path, slam_error=0.05)[0].fields
    assert fields["ate_rms_m"] == pytest.approx(0.05, rel=0.02)
    assert fields["ate_unaligned_rms_m"] == pytest.approx(0.05, rel=0.02)
    assert fields["coverage_ratio"] is None, "no map was saved: unknown, not 0"
    assert fields["frontiers_left"] is None, "nothing was explored"


def test_an_exploration_tells_what_it_left_and_whether_it_came_home(tmp_path: Path) -> None:
    explored = StepEnd(ExploreStep(), "SUCCEEDED", "", ExploreResult((), 7, False), 0, 9 * S)
    fields = judged(tmp_path, ends=(explored,))[0].fields
    assert (fields["frontiers_left"], fields["targets_reached"], fields["is_home"]) == (0, 7, False)


def test_a_study_of_dockings_takes_over_what_the_judge_found(tmp_path: Path) -> None:
    case = DockingCase("random", 4, SE2(), 3.0)
    for k, (code, is_docked) in enumerate([("SUCCEEDED", True), ("NO_CHARGE", False)]):
        end = replace(ENDS[-1], code=code)
        verdict, run = judged(tmp_path / str(k), [(20.0, "charger_1_body", 0.1)], ends=(end,))
        outcome = _outcome(case, run, verdict.fields)
        assert (outcome.is_docked, outcome.code, outcome.attempts) == (is_docked, code, 2)
        assert outcome.collisions == 1
        assert outcome.approach_seconds == pytest.approx(13.0)
        if is_docked:
            assert outcome.error == pytest.approx(0.025, abs=1e-6)
            assert outcome.error_yaw_deg == pytest.approx(1.5, abs=1e-4)
            assert outcome.docking_seconds == pytest.approx(7.0)
        else:
            told = (outcome.error_x, outcome.error_y, outcome.error_yaw_deg, outcome.docking_seconds)
            assert told == (None, None, None, None), "a robot that did not dock has no error of docking"


@pytest.mark.parametrize(("share", "is_enough"), [(0.981, True), (0.979, False), (None, True)])
def test_a_finished_exploration_falls_short_that_lacks_reachable_floor(
    share: float | None, is_enough: bool, tmp_path: Path
) -> None:
    verdict = judged(tmp_path)[0]
    told = replace(verdict, fields={**verdict.fields, "ended": "finished", "reachable_coverage_ratio": share})
    assert is_good(told) == is_enough
    assert (missing_floor(told) is None) == is_enough
    if not is_enough:
        assert missing_floor(told) == "the map holds 97.9 % of the floor that the robot can reach; 98 % are asked"
