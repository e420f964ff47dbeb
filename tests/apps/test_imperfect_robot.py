"""What is off in truth is not told to the robot: mounts, lens, docks and map are those of the drawing."""

from __future__ import annotations

from pathlib import Path

import pytest

from ambler.apps.docks import dock_of_world
from ambler.apps.run_folder import RunFolder
from ambler.apps.scene import RunOptions, checked_scene
from ambler.apps.simulated import SimulatedRun
from ambler.core.errors import BadInputError
from ambler.core.messages import CameraInfo, Transforms
from ambler.docking.database import DockDatabase
from ambler.nodes.steps import DockStep
from ambler.runtime.topics import CAMERA_INFO, STATIC_TRANSFORMS
from ambler.sim.imperfections import draw_imperfections
from ambler.sim.robots import robot_named
from ambler.sim.world_file import load_world
from ambler.wire.mcap_reader import read_recording


def test_the_robot_is_told_what_was_drawn(tmp_path: Path) -> None:
    world, robot = load_world("dock_room"), robot_named("amr_omni")
    off = draw_imperfections(5, dock_of_world(world, "charger_1"))
    options = RunOptions((DockStep("charger_1"),), "dock_room", "amr_omni", 5, port=None, imperfections=off)
    run = SimulatedRun(options, RunFolder(tmp_path))
    try:
        run.run(0.3)
    finally:
        run.close()
    told = [m.decode_as(CameraInfo) for m in read_recording(run.robot.folder.recording, [CAMERA_INFO.ros_name])]
    assert told[0].model.fx == pytest.approx(robot.cameras["camera"].model.fx)
    mounts = {
        edge.child: edge.parent_from_child
        for message in read_recording(run.robot.folder.recording, [STATIC_TRANSFORMS.ros_name])
        for edge in message.decode_as(Transforms).transforms
    }
    drawn = robot.model.sensor("camera").base_from_sensor
    assert mounts["camera"].translation == pytest.approx(drawn.translation, abs=1e-9)
    dock = DockDatabase.load(run.robot.folder.docks).dock("charger_1")
    assert [m.spec.size for m in dock.markers] == [m.size for m in world.docks[0].markers]


def test_imperfections_are_refused_where_they_cannot_be() -> None:
    off = draw_imperfections(5, dock_of_world(load_world("dock_room"), "charger_1"))
    steps = (DockStep("charger_1"),)
    for wrong in (
        RunOptions(steps, "dock_room", "amr_omni", is_perfect=True, imperfections=off),
        RunOptions(steps, "dock_room", "amr_omni", is_apart=True, imperfections=off),
        RunOptions((), "office", "amr_omni", imperfections=off),
    ):
        with pytest.raises(BadInputError):
            checked_scene(wrong)
