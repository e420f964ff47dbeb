"""Every implementation of the devices of `core/devices.py`, each with what makes it measure."""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.protocols import BodyVelocity
from ambler.drivers.joystick import AxisRange, EvdevJoystick, JoystickLayout
from ambler.drivers.serial_base import SerialBase
from ambler.drivers.serial_emulator import EmulatorConfig, SerialEmulator
from ambler.drivers.stream_device import (
    SensorStream,
    StreamBattery,
    StreamCamera,
    StreamImu,
    StreamLidar,
    StreamRangeSensor,
)
from ambler.drivers.stream_server import StreamServer
from ambler.recordings import devices as recorded
from ambler.recordings.message_source import MessageSource
from ambler.sim.robot_devices import robot_devices
from ambler.sim.robots import robot_named
from ambler.sim.world import BodySpec, SimulationConfig, World
from ambler.sim.world_file import load_world
from ambler.wire.mcap_file import McapRecorder
from tests.devices.fakes import HOST, FakeBase, FakeBattery, FakeSensor, Stepper

MODEL = CameraModel("camera", 4, 3, 2.0, 2.0, 1.5, 1.0)
MS = 1_000_000
START = 1_790_000_000_000_000_000


def scan(stamp_ns: int) -> m.LaserScan:
    ranges = np.full(90, 2.0, np.float32)
    return m.LaserScan(stamp_ns, "front", -1.0, 0.02, 0.0, 0.05, 0.1, 30.0, ranges, np.empty(0, np.float32))


def imu(stamp_ns: int) -> m.Imu:
    return m.Imu(stamp_ns, "front", (0.1, 1 / 3, -0.2), (0.0, 0.1, 9.81))


def echo(stamp_ns: int) -> m.Range:
    return m.Range(stamp_ns, "front", 0.5, 0.02, 4.0, 1.25)


def picture(stamp_ns: int) -> m.Image:
    return m.Image(stamp_ns, "front", np.zeros((3, 4), np.uint8))


def depth_picture(stamp_ns: int) -> m.Image:
    return m.Image(stamp_ns, "front", np.full((3, 4), 1234, np.uint16))


def battery(stamp_ns: int) -> m.BatteryState:
    return m.BatteryState(stamp_ns, "base", 25.0, -1.0, 0.8, m.PowerSupply.DISCHARGING)


def odometry(stamp_ns: int) -> m.Odometry:
    zero, unit = (0.0, 0.0, 0.0), np.eye(6)
    return m.Odometry(stamp_ns, "odom", "base", m.SE3(), zero, zero, unit, unit)


def joystick(stamp_ns: int) -> m.JoystickState:
    return m.JoystickState(stamp_ns, "front", np.zeros(2, np.float32), np.zeros(3, np.uint8))


class LiveRig:
    """A device in real time."""

    steps_in_read = False
    body_velocity: Callable[[], BodyVelocity] | None = None
    breaks: Callable[[], None] | None = None

    def __init__(self, device: Any) -> None:
        self.device = device

    def now_ns(self) -> int:
        return HOST()

    def wait(self, seconds: float) -> None:
        threading.Event().wait(seconds)


@contextlib.contextmanager
def serial_rig(folder: Path, part: str) -> Iterator[LiveRig]:
    body, config = FakeBase(0.01), EmulatorConfig(watchdog=0.45, clock_offset=-99.0, clock_drift=1e-4)
    emulator = SerialEmulator(body, FakeBattery(), config, folder / "line")
    stepper = Stepper(emulator.step)
    base = SerialBase(folder / "line", HOST)
    rig = LiveRig(base if part == "base" else base.battery)
    rig.body_velocity = lambda: body.velocity

    def pull() -> None:
        with stepper.paused():
            emulator.unplug()

    rig.breaks = pull
    with stepper:
        yield rig
        rig.device.close()
    emulator.unplug()


STREAM_MAKERS = {
    "lidar": scan,
    "imu": imu,
    "range": echo,
    "camera": picture,
    "depth_camera": depth_picture,
    "battery": battery,
}


@contextlib.contextmanager
def stream_rig(folder: Path, part: str) -> Iterator[LiveRig]:
    sensor = FakeSensor("front", STREAM_MAKERS[part])
    kinds = {"camera": "cameras", "depth_camera": "cameras", "battery": "batteries"}
    server = StreamServer(
        f"unix:{folder / 's'}", **{kinds.get(part, "sensors"): [sensor]}, clock=lambda now_ns: now_ns + 12_345_678_901
    )
    stream, stepper = SensorStream(server.address, HOST), Stepper(server.step)
    device: Any = {
        "lidar": lambda: StreamLidar(stream, "front", "front_lidar"),
        "imu": lambda: StreamImu(stream, "front", "imu_link"),
        "range": lambda: StreamRangeSensor(stream, "front", "left_us"),
        "camera": lambda: StreamCamera(stream, "front", "camera_link", MODEL),
        "depth_camera": lambda: StreamCamera(stream, "front", "depth_link", MODEL),
        "battery": lambda: StreamBattery(stream, "front", "base"),
    }[part]()
    rig = LiveRig(device)

    def end() -> None:
        with stepper.paused():
            server.disconnect()

    rig.breaks = end
    with stepper:
        yield rig
        device.close()
    server.close()


@contextlib.contextmanager
def joystick_rig(folder: Path) -> Iterator[LiveRig]:
    os.mkfifo(folder / "event0")
    ends = [os.open(folder / "event0", os.O_RDWR)]
    layout = JoystickLayout({0: AxisRange(-128, 127), 1: AxisRange(-128, 127)}, (304,))
    rig = LiveRig(EvdevJoystick(folder / "event0", layout))
    rig.breaks = lambda: os.close(ends.pop())
    yield rig
    rig.device.close()
    for end in ends:
        os.close(end)


class SteppedRig:
    """A device in simulated time, read in steps of 5 ms while a test waits."""

    steps_in_read = False
    body_velocity: Callable[[], BodyVelocity] | None = None
    breaks: Callable[[], None] | None = None

    def __init__(self, device: Any, step: Callable[[int], object] = lambda now_ns: None) -> None:
        self.device, self._step = device, step
        self._now_ns = START

    def now_ns(self) -> int:
        return self._now_ns

    def wait(self, seconds: float) -> None:
        end = self._now_ns + round(seconds * 1e9)
        while self._now_ns < end:
            self._now_ns = min(self._now_ns + 5 * MS, end)
            self._step(self._now_ns)


RECORDED: dict[str, tuple[type[recorded.RecordedDevice[Any]], Callable[[int], Any]]] = {
    "base": (recorded.RecordedBase, odometry),
    "lidar": (recorded.RecordedLidar, scan),
    "imu": (recorded.RecordedImu, imu),
    "range": (recorded.RecordedRangeSensor, echo),
    "camera": (recorded.RecordedCamera, picture),
    "depth_camera": (recorded.RecordedCamera, depth_picture),
    "battery": (recorded.RecordedBattery, battery),
    "joystick": (recorded.RecordedJoystick, joystick),
}


@contextlib.contextmanager
def recorded_rig(folder: Path, part: str) -> Iterator[SteppedRig]:
    kind, make = RECORDED[part]
    recorder = McapRecorder(folder / "recording")
    for k in range(1, 800):
        recorder.write("/topic", make(START + 20 * k * MS - 7 * MS), START + 20 * k * MS + 1000)
    recorder.close()
    options: dict[str, Any] = {"model": MODEL} if part.endswith("camera") else {}
    if part not in ("base", "battery"):
        options["frame"] = "front"
    device = kind(MessageSource(folder / "recording"), "/topic", poll_period=0.005, **options)
    yield SteppedRig(device)


@contextlib.contextmanager
def simulated_rig(robot: str, part: str) -> Iterator[SteppedRig]:
    world = World(load_world("lab_empty"), [BodySpec("r", robot_named(robot))], SimulationConfig(physics="kinematic"))
    devices = robot_devices(world, "r")
    world.advance(START)
    device: Any = {
        "base": lambda: devices.base,
        "lidar": lambda: devices.lidars[0],
        "imu": lambda: devices.imus[0],
        "range": lambda: devices.ranges[0],
        "camera": lambda: devices.cameras[0],
        "depth_camera": lambda: devices.depth_cameras[0],
        "battery": lambda: devices.battery,
    }[part]()
    rig = SteppedRig(device, world.advance)
    rig.steps_in_read = True
    body = world.body("r")

    def velocity() -> BodyVelocity:
        history = body.history
        if len(history) < 2:
            return BodyVelocity()
        x = (history[-2][1].inverse() @ history[-1][1]).translation[0]
        return BodyVelocity(x / 0.005, 0.0, 0.0)

    rig.body_velocity = velocity
    yield rig
    device.close()
