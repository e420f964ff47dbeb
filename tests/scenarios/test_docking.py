"""The whole robot docks and leaves again: localization, navigation, camera, docking, gate and physics, in a room with a dock."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest

from ambler.apps.docking import DockingOptions, DockingRun
from ambler.apps.navigation import NavigationOptions
from ambler.apps.run_folder import RunFolder
from ambler.core.errors import BadInputError
from ambler.core.messages import BatteryState, PowerSupply, Status, VelocityCommand
from ambler.core.se2 import SE2
from ambler.docking.database import DockDatabase
from ambler.missions.dock_commands import DockConfig
from ambler.nodes.dock_pilot import Errand, ErrandKind
from ambler.nodes.docking import DockingNodeConfig
from ambler.runtime.topics import BATTERY, IMAGE, STATUS, VELOCITY_COMMAND
from ambler.safety.approach_permit import SPEED
from ambler.sim.world_file import load_world
from ambler.wire.mcap_reader import read_recording

NAME = "charger_1"
NEAR = load_world("dock_room").start.inverse() @ SE2(5.0, 2.9, 0.1)  # 0.9 m before the staging pose, in the map


def options(kinds: tuple[ErrandKind, ...], start: SE2 | None = NEAR, **changes: object) -> DockingOptions:
    faults = changes.pop("faults", ())
    navigation = NavigationOptions(world="dock_room", port=None, seed=3, faults=faults)  # type: ignore[arg-type]
    return DockingOptions(navigation, tuple(Errand(kind, NAME) for kind in kinds), start=start, **changes)  # type: ignore[arg-type]


def go(folder: Path, wanted: DockingOptions, seconds: float = 60.0) -> tuple[DockingRun, dict[str, object]]:
    run = DockingRun(wanted, RunFolder(folder))
    try:
        run.run(seconds)
        return run, run.judge()
    finally:
        run.close()


@pytest.fixture(scope="module")
def docked(tmp_path_factory: pytest.TempPathFactory) -> tuple[DockingRun, dict[str, object]]:
    return go(tmp_path_factory.mktemp("docked") / "run", options((ErrandKind.DOCK,)))


def test_it_docks_within_the_contacts_tolerance(docked: tuple[DockingRun, dict[str, object]]) -> None:
    run, fields = docked
    assert fields["ended"] == "done"
    assert fields["collisions"] == 0
    assert fields["dock_attempts"] == 1
    assert fields["battery_supply"] == "charging"
    assert float(str(fields["dock_error_m"])) < 0.003
    assert abs(float(str(fields["dock_error_yaw_deg"]))) < 0.1
    assert float(str(fields["dock_final_seconds"])) < 10.0
    assert run.rounds is not None
    assert [state for _, state in run.rounds.states] == ["staging", "aligning", "approaching", "confirming"]


def test_pictures_are_taken_only_while_they_can_show_the_dock(docked: tuple[DockingRun, dict[str, object]]) -> None:
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


def test_near_the_dock_the_robot_is_slow(docked: tuple[DockingRun, dict[str, object]]) -> None:
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


def test_the_battery_drains_on_the_way_and_charges_in_the_dock(docked: tuple[DockingRun, dict[str, object]]) -> None:
    run, _ = docked
    told = [r.decode_as(BatteryState) for r in read_recording(run.folder.recording, [BATTERY.ros_name])]
    assert told[0].supply is PowerSupply.DISCHARGING
    assert told[-1].supply is PowerSupply.CHARGING
    assert told[-1].current > 10.0
    away = [b.share for b in told if b.supply is PowerSupply.DISCHARGING]
    assert away[-1] < away[0]


def test_each_docking_refines_the_database(docked: tuple[DockingRun, dict[str, object]]) -> None:
    run, _ = docked
    dock = DockDatabase.load(run.folder.root / "docks.yaml").dock(NAME)
    assert dock.dockings == 1
    assert dock.map_from_dock.distance_to(run.world.from_start().docks[0].world_from_dock) < 0.03


def test_it_is_taught_and_leaves(tmp_path: Path) -> None:
    wanted = options((ErrandKind.TEACH, ErrandKind.UNDOCK), None, starts_docked=NAME)
    run, fields = go(tmp_path / "run", wanted, 20.0)
    assert fields["ended"] == "done"
    assert fields["collisions"] == 0
    assert fields["battery_supply"] == "discharging"
    assert abs(float(str(fields["dock_error_x_m"])) + 1.0) < 0.08, "it stands at the staging pose"
    taught = DockDatabase.load(run.folder.root / "docks.yaml").dock(NAME)
    assert taught.map_from_dock.distance_to(run.world.from_start().docks[0].world_from_dock) < 0.03


def test_a_charger_without_power_is_left_with_a_named_failure(tmp_path: Path) -> None:
    once = DockingNodeConfig(mission=DockConfig(attempts=1, confirm_time=1.0))
    _, fields = go(tmp_path / "run", options((ErrandKind.DOCK,), faults=("no_power",), docking=once), 40.0)
    assert fields["ended"] == "no_charge"
    assert "no current" in str(fields["dock_text"])
    assert fields["collisions"] == 0
    assert float(str(fields["dock_error_x_m"])) < -0.9, "it has backed out"


def test_bad_input_is_told_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="charger_1"):
        DockingRun(
            DockingOptions(NavigationOptions(world="dock_room", port=None), (Errand(ErrandKind.DOCK, "bay"),)),
            RunFolder(tmp_path / "a"),
        )
    with pytest.raises(BadInputError, match="dock_hall"):
        DockingRun(DockingOptions(NavigationOptions(world="two_rooms", port=None), ()), RunFolder(tmp_path / "b"))
    with pytest.raises(BadInputError, match="no dock 'bay'"):
        DockingRun(options((), None, starts_docked="bay"), RunFolder(tmp_path / "c"))
