"""Where the devices of a robot are reached from another process: its base and battery at a pseudo-terminal, its sensors at a socket."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from ambler.core.devices import RobotDevices
from ambler.drivers.serial_emulator import EmulatorConfig, SerialEmulator
from ambler.drivers.stream_server import StreamServer

STEP = 0.005


@dataclass(frozen=True, slots=True)
class PortPlaces:
    """Where one robot is reached: the path of the serial line, the address of the sensors, and the recording of its ground truth."""

    base: str
    sensors: str
    truth: str = ""

    def to_json(self) -> dict[str, str]:
        """Return the places as a flat object."""
        return asdict(self)


class RobotPort:
    """The devices of one robot, opened and offered in `folder` as `NAME.base` and `NAME.sensors`. `clock` says which offset (s) and
    drift (s/s) their clocks have. It knows Protocols only: any devices can be offered."""

    def __init__(self, name: str, devices: RobotDevices, folder: Path, clock: EmulatorConfig | None = None) -> None:
        config = clock if clock is not None else EmulatorConfig(name=name)
        self.name = name
        cameras = (*devices.cameras, *devices.depth_cameras)
        self._devices = [devices.base, *devices.lidars, *devices.imus, *devices.ranges, *cameras]
        if devices.battery is not None:
            self._devices.append(devices.battery)
        for device in self._devices:
            device.open()
        self.line = SerialEmulator(devices.base, devices.battery, config, folder / f"{name}.base")
        sensors = (*devices.lidars, *devices.imus, *devices.ranges)
        self.server = StreamServer(f"unix:{folder / f'{name}.sensors'}", sensors, cameras, clock=config.device_ns)

    def places(self, truth: str = "") -> PortPlaces:
        """Return where the robot is reached."""
        return PortPlaces(str(self.line.path), self.server.address, truth)

    def step(self, now_ns: int) -> None:
        """Take commands and requests, send what was measured."""
        self.line.step(now_ns)
        self.server.step(now_ns)

    def close(self) -> None:
        """Stop the base, close the devices, give the places back."""
        for device in self._devices:
            device.close()
        self.line.unplug()
        self.server.close()


@dataclass(slots=True)
class LoopTimes:
    """How a loop in real time did: its turns, the longest delay of one (s), and how many began more than a period late."""

    turns: int = 0
    longest_delay: float = 0.0
    late: int = 0


def serve(
    steps: Sequence[Callable[[int], None]], now_ns: Callable[[], int], stopped: threading.Event, period: float = STEP
) -> LoopTimes:
    """Call every step in turn each `period` seconds with the time, until `stopped` is set. Turns that are missed are left out."""
    times, due = LoopTimes(), time.monotonic()
    while not stopped.is_set():
        delay = time.monotonic() - due
        times.turns += 1
        times.late += delay > period
        times.longest_delay = max(times.longest_delay, delay)
        instant_ns = now_ns()
        for step in steps:
            step(instant_ns)
        due += period if delay <= period else delay
        stopped.wait(max(due - time.monotonic(), 0.0))
    return times
