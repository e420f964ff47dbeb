"""A simulated robot's devices, recorded in a lockstep run, drive the same nodes again: every message bit for bit, at its nanosecond."""

import math
from pathlib import Path

import pytest

from ambler.apps.recorded_robot import recorded_devices
from ambler.apps.simulated_robot import lone_robot_nodes
from ambler.bridges.recorder import Recorder
from ambler.core.errors import DeviceError
from ambler.core.messages import VelocityCommand
from ambler.nodes.devices.table import device_nodes
from ambler.recordings.devices import RecordedBase
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.tasks import CAMERA_PICTURES, PicturesRequest
from ambler.runtime.topics import VELOCITY_COMMAND
from ambler.sim.robots import robot_named
from ambler.sim.world import SimulationConfig
from ambler.sim.world_file import load_world
from ambler.wire.mcap_reader import RecordedMessage, read_recording

TRUTH = "/ground_truth/"


class Wander(Node):
    """Drives in a wave; wants pictures."""

    name, latency, outputs = "wander", 0.002, (VELOCITY_COMMAND,)

    def __init__(self, *, wants_pictures: bool) -> None:
        self._wants_pictures = wants_pictures
        self.calls = (CAMERA_PICTURES,) if wants_pictures else ()

    def start(self) -> None:
        self.ctx.timer(0.05, self._drive)
        if self._wants_pictures:
            self.ctx.timer(0.5, lambda: self.ctx.call(CAMERA_PICTURES, PicturesRequest(0.4), lambda _: None))

    def _drive(self) -> None:
        t = self.ctx.now_ns * 1e-9
        self.ctx.publish(VELOCITY_COMMAND, VelocityCommand(self.ctx.now_ns, 0.3, 0.0, 0.4 * math.sin(t)))


def run(nodes: list[Node], folder: Path, seconds: float) -> list[RecordedMessage]:
    recorder = Recorder(folder)
    with LockstepExecutor(Stack(nodes)) as executor:
        executor.tap(recorder.on_message)
        executor.run(seconds)
    recorder.close()
    return [r for r in read_recording(folder) if not r.topic.startswith(TRUTH)]


@pytest.mark.parametrize(("robot", "world"), [("diff+ultrasonic", "lab_empty"), ("amr_omni", "dock_hall")])
def test_recorded_devices_give_every_bit_again(robot: str, world: str, tmp_path: Path) -> None:
    simulated = robot_named(robot)
    has_camera = bool(simulated.cameras)
    config = SimulationConfig(seed=3, physics="kinematic")
    nodes = lone_robot_nodes(load_world(world), simulated, config)
    first = run([*nodes, Wander(wants_pictures=has_camera)], tmp_path / "first", 2.0)
    devices = recorded_devices(tmp_path / "first", simulated.model)
    again = [*device_nodes(simulated.model, devices), Wander(wants_pictures=has_camera)]
    second = run(again, tmp_path / "second", 2.0)
    assert sorted({r.topic for r in first}) == sorted({r.topic for r in second})
    assert len(first) > 500
    assert second == first
    assert isinstance(devices.base, RecordedBase)
    assert len(devices.base.commands) == sum(r.topic == "/cmd_vel" for r in first)
    assert len(devices.cameras) == has_camera
    assert len(devices.ranges) == len(simulated.ultrasonics)


def test_a_recording_without_devices_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="cannot be replayed"):
        recorded_devices(tmp_path, robot_named("diff").model)
