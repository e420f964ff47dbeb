"""The whole robot docks and leaves again: localization, navigation, camera, docking, gate and physics, in a room with a dock."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import pytest

from ambler.apps.judgement import judge
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions, checked_scene
from ambler.apps.simulated import SimulatedRun
from ambler.core.errors import BadInputError
from ambler.core.messages import BatteryState, PowerSupply, Status, VelocityCommand
from ambler.core.se2 import SE2
from ambler.docking.database import DockDatabase
from ambler.nodes.steps import DockStep, Step, TeachStep, UndockStep
from ambler.runtime.topics import BATTERY, IMAGE, STATUS, VELOCITY_COMMAND
from ambler.safety.approach_permit import SPEED
from ambler.sim.world_file import load_world
from ambler.wire.mcap_reader import read_recording

NAME = "charger_1"
NEAR = SE2(-1.9, -0.1, 0.1)  # 0.9 m before the staging pose, in the dock's frame


def options(*steps: Step, start: SE2 | None = None, **changes: Any) -> RunOptions:
    near = load_world("dock_room").from_start().docks[0].world_from_dock @ NEAR
    start = None if "starts_docked" in changes else near if start is None else start
    return RunOptions(steps, "dock_room", "amr_omni", 3, start=start, port=None, **changes)


def go(folder: Path, wanted: RunOptions, seconds: float = 60.0) -> tuple[SimulatedRun, dict[str, Any]]:
    run = SimulatedRun(wanted, RunFolder(folder))
    try:
        run.run(seconds)
        return run, judge(run).fields
    finally:
        run.close()


@pytest.fixture(scope="module")
def docked(tmp_path_factory: pytest.TempPathFactory) -> tuple[SimulatedRun, dict[str, Any]]:
    return go(tmp_path_factory.mktemp("docked") / "run", options(DockStep(NAME)))


def test_it_docks_within_the_contacts_tolerance(docked: tuple[SimulatedRun, dict[str, Any]]) -> None:
    run, fields = docked
    assert fields["ended"] == "succeeded"
    assert fields["collisions"] == 0
    assert fields["dock_attempts"] == 1
    assert fields["battery_supply"] == "charging"
    assert float(str(fields["dock_error_m"])) < 0.003
    assert abs(float(str(fields["dock_error_yaw_deg"]))) < 0.1
    assert float(str(fields["dock_final_seconds"])) < 10.0
    assert run.end is not None
    assert [state for _, state in run.end.states] == ["staging", "aligning", "approaching", "confirming"]


def test_pictures_are_taken_only_while_they_can_show_the_dock(docked: tuple[SimulatedRun, dict[str, Any]]) -> None:
    run, _ = docked
    stamps, said = [], {}
    for r in read_recording(run.folder.recording, [IMAGE.ros_name, STATUS.ros_name]):
        if r.topic == IMAGE.ros_name:
            stamps.append(r.log_time_ns)
        else:
            status = r.decode_as(Status)
            said.setdefault(status.code, r.log_time_ns)
    assert stamps, "there are pictures"
    gaps = [(b - a) * 1e-9 for a, b in itertools.pairwise(stamps)]
    assert math.isclose(min(gaps), 0.08, abs_tol=0.011)
    assert stamps[-1] <= said["SUCCEEDED"] + 600_000_000, "the lease ends by itself"


def test_near_the_dock_the_robot_is_slow(docked: tuple[SimulatedRun, dict[str, Any]]) -> None:
    run, _ = docked
    begin = None
    speeds = []
    for r in read_recording(run.folder.recording, [VELOCITY_COMMAND.ros_name, STATUS.ros_name]):
        if r.topic == STATUS.ros_name:
            if r.decode_as(Status).code == "APPROACHING":
                begin = r.log_time_ns + 200_000_000
        elif begin is not None and r.log_time_ns > begin:
            v = r.decode_as(VelocityCommand)
            speeds.append(math.hypot(v.vx, v.vy))
    assert speeds
    assert 0.1 < max(speeds) <= SPEED + 1e-6


def test_the_battery_drains_on_the_way_and_charges_in_the_dock(docked: tuple[SimulatedRun, dict[str, Any]]) -> None:
    run, _ = docked
    told = [r.decode_as(BatteryState) for r in read_recording(run.folder.recording, [BATTERY.ros_name])]
    assert told[0].supply is PowerSupply.DISCHARGING
    assert told[-1].supply is PowerSupply.CHARGING
    assert told[-1].current > 10.0
    away = [b.share for b in told if b.supply is PowerSupply.DISCHARGING]
    assert away[-1] < away[0]


def test_each_docking_refines_the_database(docked: tuple[SimulatedRun, dict[str, Any]]) -> None:
    run, _ = docked
    dock = DockDatabase.load(run.folder.root / "docks.yaml").dock(NAME)
    assert dock.dockings == 1
    assert dock.map_from_dock.distance_to(run.scene.world.from_start().docks[0].world_from_dock) < 0.03


def test_it_is_taught_and_leaves(tmp_path: Path) -> None:
    wanted = options(TeachStep(NAME), UndockStep(NAME), starts_docked=NAME)
    run, fields = go(tmp_path / "run", wanted, 20.0)
    assert fields["ended"] == "succeeded"
    assert fields["collisions"] == 0
    assert fields["battery_supply"] == "discharging"
    assert abs(fields["undock_x_m"] + 1.0) < 0.08, "it stands at the staging pose"
    taught = DockDatabase.load(run.folder.root / "docks.yaml").dock(NAME)
    assert taught.map_from_dock.distance_to(run.scene.world.from_start().docks[0].world_from_dock) < 0.03


def test_a_charger_without_power_is_left_with_a_named_failure(tmp_path: Path) -> None:
    once = {"docking": {"mission": {"attempts": 1, "confirm_time": 1.0}}}
    _, fields = go(tmp_path / "run", options(DockStep(NAME), faults=("no_power",), profile=once), 40.0)
    assert fields["ended"] == "no_charge"
    assert "no current" in str(fields["dock_text"])
    assert fields["collisions"] == 0
    assert float(str(fields["dock_error_x_m"])) < -0.9, "it has backed out"


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (RunOptions((DockStep("bay"),), "dock_room", "amr_omni"), "charger_1"),
        (RunOptions((DockStep(NAME),), "two_rooms", "amr_omni"), "dock_hall"),
        (RunOptions((UndockStep("bay"),), "dock_room", "amr_omni", starts_docked="bay"), "no dock 'bay'"),
        (RunOptions((DockStep(NAME),), "dock_room", "spot"), "cannot dock"),
    ],
)
def test_bad_input_is_told_before_anything_moves(wanted: RunOptions, message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        checked_scene(wanted)
