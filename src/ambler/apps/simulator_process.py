"""The simulator in a process of its own, in real time, niced: a live robot meets its devices behind pseudo-terminals and local sockets
and is not slowed down by the simulator's thread beside its own.

`python -m ambler.apps.simulator_process --world W --robot NAME=ROBOT --folder F` prints one line of JSON when it is ready: for each
robot where it is reached and where its ground truth is recorded. Lines on its standard input pull cables and plug them in (`unplug
NAME`, `plug NAME`); it ends when that is closed, or on SIGTERM or SIGINT, and then prints how its loop did.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import select
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from ambler.apps.robot_port import STEP, RobotPort, serve
from ambler.core.errors import BadInputError
from ambler.core.messages import Contact
from ambler.core.se2 import SE2
from ambler.drivers.serial_emulator import EmulatorConfig
from ambler.runtime.topics import CONTACT, TRUE_MAP, TRUE_POSE, TRUE_START
from ambler.sim.ground_truth import GroundTruth
from ambler.sim.robot_devices import robot_devices
from ambler.sim.robots import robot_named
from ambler.sim.world import BodySpec, SimulationConfig, World
from ambler.sim.world_file import load_world
from ambler.wire.mcap_file import McapRecorder

NICE = 5
MAP_RESOLUTION = 0.05
WARM_UP = 0.5
"""Seconds that the world must have kept up with the clock before the robots are offered: kernels are compiled by then."""
_KEEPS_UP = 0.05


@dataclass(frozen=True, slots=True)
class RobotChoice:
    """A robot to be put into the world: its name, its kind, and its start (x, y in metres, yaw in degrees; None: the world's)."""

    name: str
    robot: str
    start: tuple[float, float, float] | None = None

    @classmethod
    def from_text(cls, text: str) -> RobotChoice:
        """Read NAME=ROBOT or NAME=ROBOT@X,Y,DEG. Raises BadInputError."""
        name, _, rest = text.partition("=")
        robot, _, start = rest.partition("@")
        try:
            numbers = tuple(float(v) for v in start.split(",")) if start else None
        except ValueError:
            numbers = ()
        if (
            not name
            or not robot
            or (numbers is not None and (len(numbers) != 3 or not all(map(math.isfinite, numbers))))
        ):
            raise BadInputError(f"robot {text!r}: expected NAME=ROBOT or NAME=ROBOT@X,Y,DEG")
        return cls(name, robot, None if numbers is None else (numbers[0], numbers[1], numbers[2]))

    def to_text(self) -> str:
        """Return the text that `from_text` reads."""
        start = "" if self.start is None else "@" + ",".join(repr(v) for v in self.start)
        return f"{self.name}={self.robot}{start}"

    def to_spec(self) -> BodySpec:
        """Return the body of the simulation; raises BadInputError."""
        start = None
        if self.start is not None:
            start = SE2(self.start[0], self.start[1], math.radians(self.start[2]))
        return BodySpec(self.name, robot_named(self.robot), start)


class TruthRecorder:
    """Records what truly happens to one robot, stamped by the host's clock, so that a live run can be judged."""

    def __init__(self, truth: GroundTruth, folder: Path, now_ns: int) -> None:
        self._truth, self._recorder = truth, McapRecorder(folder)
        truth.open()
        self._recorder.write(TRUE_START.ros_name, truth.start_pose(now_ns), now_ns, is_latched=True)
        self._recorder.write(TRUE_MAP.ros_name, truth.grid(now_ns, MAP_RESOLUTION), now_ns, is_latched=True)

    def step(self, now_ns: int) -> None:
        """Record what happened until now."""
        for told in self._truth.read(now_ns):
            topic = CONTACT if isinstance(told, Contact) else TRUE_POSE
            self._recorder.write(topic.ros_name, told, now_ns)

    def close(self) -> None:
        """Finish the recording."""
        self._truth.close()
        self._recorder.close()


class SimulatorProcess:
    """A running world with a port for each of its robots; `step` is one turn of the loop."""

    def __init__(self, world: World, folder: Path, now_ns: int, clock: EmulatorConfig) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        world.advance(now_ns)
        # Paths of sockets must be short, whatever folder recordings go to.
        self._doors = tempfile.TemporaryDirectory(prefix="ambler-")
        doors = Path(self._doors.name)
        self._ports = {b.name: RobotPort(b.name, robot_devices(world, b.name), doors, clock) for b in world.bodies}
        truths = {b.name: folder / f"{b.name}.truth" for b in world.bodies}
        self._truths = [TruthRecorder(GroundTruth(world, b), truths[b.name], now_ns) for b in world.bodies]
        self.places = {name: port.places(str(truths[name])) for name, port in self._ports.items()}

    def step(self, now_ns: int) -> None:
        """Advance the world and serve its robots."""
        for port in self._ports.values():
            port.step(now_ns)
        for truth in self._truths:
            truth.step(now_ns)

    def obey(self, line: str) -> None:
        """Pull or plug a cable: `unplug NAME`, `plug NAME`; other lines do nothing."""
        verb, _, name = line.strip().partition(" ")
        port = self._ports.get(name)
        if port is not None and verb == "unplug":
            port.line.unplug()
        elif port is not None and verb == "plug":
            port.line.plug()

    def close(self) -> None:
        """Stop the robots, finish the recordings."""
        for port in self._ports.values():
            port.close()
        for truth in self._truths:
            truth.close()
        self._doors.cleanup()


class _Orders:
    """What comes over the standard input, taken between two turns; its end stops the loop."""

    def __init__(self, process: SimulatorProcess, stopped: threading.Event) -> None:
        self._process, self._stopped = process, stopped
        self._rest = b""

    def step(self, now_ns: int) -> None:
        if not select.select((0,), (), (), 0)[0]:
            return
        data = os.read(0, 4096)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._process.obey(line.decode(errors="replace"))
        if not data:
            self._stopped.set()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the simulator until it is told to end; returns 0, or 2 for bad arguments."""
    options = _parser().parse_args(arguments)
    os.nice(NICE)
    stopped = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopped.set())
    try:
        robots = [RobotChoice.from_text(text).to_spec() for text in options.robot]
        world = World(
            load_world(options.world), robots, SimulationConfig(options.seed, options.perfect, options.physics)
        )
    except BadInputError as error:
        print(error, file=sys.stderr)
        return 2
    offset_ns = options.host_offset_ns if options.host_offset_ns is not None else time.time_ns() - time.monotonic_ns()

    def now_ns() -> int:
        return time.monotonic_ns() + offset_ns

    clock = EmulatorConfig(
        options.world[:24],
        watchdog=options.watchdog,
        clock_offset=options.clock_offset,
        clock_drift=options.clock_drift,
    )
    process = SimulatorProcess(world, Path(options.folder), now_ns(), clock)
    try:
        _warm_up(process, now_ns, stopped)
        print(json.dumps({name: places.to_json() for name, places in process.places.items()}), flush=True)
        times = serve((process.step, _Orders(process, stopped).step), now_ns, stopped)
    finally:
        process.close()
    print(json.dumps(asdict(times)), flush=True)
    return 0


def _warm_up(process: SimulatorProcess, now_ns: Callable[[], int], stopped: threading.Event) -> None:
    kept_up_since = time.monotonic()
    while time.monotonic() - kept_up_since < WARM_UP and not stopped.wait(STEP):
        begin = time.monotonic()
        process.step(now_ns())
        if time.monotonic() - begin > _KEEPS_UP:
            kept_up_since = time.monotonic()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="simulator_process", description=__doc__)
    parser.add_argument("--world", required=True)
    parser.add_argument("--robot", action="append", required=True, help="NAME=ROBOT or NAME=ROBOT@X,Y,DEG; repeatable")
    parser.add_argument("--folder", required=True, help="of the recordings of ground truth")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--physics", choices=("contact", "kinematic"), default="contact")
    parser.add_argument("--perfect", action="store_true", help="no noise, losses, slip and drift")
    parser.add_argument("--watchdog", type=float, default=0.2, help="of the bases, seconds")
    parser.add_argument("--clock-offset", type=float, default=0.0, help="of the devices' clocks, seconds")
    parser.add_argument("--clock-drift", type=float, default=0.0, help="of the devices' clocks, seconds per second")
    parser.add_argument("--host-offset-ns", type=int, help="host's clock less CLOCK_MONOTONIC; default: the wall clock")
    return parser


if __name__ == "__main__":
    sys.exit(main())
