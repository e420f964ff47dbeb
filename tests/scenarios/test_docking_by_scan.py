"""The whole robot docks by what its scanners see: a V-shaped notch, strips of retro-reflecting film; nothing moves on when they are gone."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from ambler.apps.scene import RunOptions
from ambler.core.messages import Status
from ambler.core.se2 import SE2
from ambler.docking.database import DockDatabase
from ambler.docking.dock import DockKind
from ambler.nodes.steps import DockStep, Step, TeachStep, UndockStep
from ambler.runtime.topics import DOCK_POSE, IMAGE, STATUS
from ambler.sim.world_file import load_world
from ambler.wire.mcap_reader import read_recording
from tests.scenarios.test_docking import go

AWAY = SE2(-1.6, 0.25, -0.15)
WORLD = load_world("dock_shapes")
KINDS = {"charger_v": DockKind.V_SHAPE, "charger_r": DockKind.REFLECTORS}
DOCKS = {dock.name: dock.world_from_dock for dock in WORLD.from_start().docks}


def options(name: str, *steps: Step, before: SE2 = AWAY, **changes: Any) -> RunOptions:
    """Steps at one dock, from a place `before` it in its frame."""
    start = DOCKS[name] @ before
    return RunOptions(steps, "dock_shapes", "amr_omni", 3, start=start, port=None, **changes)


@pytest.mark.parametrize("name", KINDS)
def test_it_docks_by_its_scanners(name: str, tmp_path: Path) -> None:
    run, fields = go(tmp_path / "run", options(name, DockStep(name), TeachStep(name)))
    assert fields["ended"] == "succeeded"
    assert fields["collisions"] == 0
    assert fields["dock_attempts"] == 1
    assert fields["battery_supply"] == "charging"
    assert float(str(fields["dock_error_m"])) < 0.005
    assert abs(float(str(fields["dock_error_yaw_deg"]))) < 0.2
    assert float(str(fields["dock_final_seconds"])) < 12.0
    taught = DockDatabase.load(run.folder.root / "docks.yaml").dock(name)
    assert taught.kind is KINDS[name]
    assert taught.map_from_dock.distance_to(DOCKS[name]) < 0.03
    topics = [r.topic for r in read_recording(run.folder.recording, [IMAGE.ros_name, DOCK_POSE.ros_name])]
    assert topics.count(DOCK_POSE.ros_name) > 50, "it is seen in nearly every cloud, down to the last centimetres"
    assert IMAGE.ros_name not in topics, "nobody asks the camera"


@pytest.mark.parametrize("name", KINDS)
def test_a_dock_that_lost_its_marks_is_a_named_failure(name: str, tmp_path: Path) -> None:
    brief = {"docking": {"mission": {"stagings": 1, "search_turns": [0.0, 0.35], "search_moves": []}}}
    run, fields = go(tmp_path / "run", options(name, DockStep(name), faults=("unmarked",), profile=brief))
    assert fields["ended"] == "dock_not_seen"
    assert name in str(fields["dock_text"])
    assert fields["collisions"] == 0
    assert float(str(fields["dock_error_x_m"])) < -0.9, "it has not gone in"
    said = [r.decode_as(Status).code for r in read_recording(run.folder.recording, [STATUS.ros_name])]
    assert "APPROACHING" not in said


def test_it_leaves_a_notch(tmp_path: Path) -> None:
    _, fields = go(tmp_path / "run", options("charger_v", UndockStep("charger_v"), before=SE2()), 30.0)
    assert fields["ended"] == "succeeded"
    assert fields["collisions"] == 0
    assert fields["battery_supply"] == "discharging"
    assert math.isclose(fields["undock_x_m"], -1.0, abs_tol=0.08)
    assert abs(fields["undock_y_m"]) < 0.03
