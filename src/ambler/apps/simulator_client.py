"""A live robot's side of the simulator in another process: starts it, and builds the drivers that reach its robots."""

from __future__ import annotations

import contextlib
import json
import select
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from ambler.apps.robot_port import PortPlaces
from ambler.core.camera import CameraModel
from ambler.core.devices import RobotDevices
from ambler.core.errors import BadInputError, DeviceError
from ambler.core.robot import RobotModel, SensorKind
from ambler.drivers.serial_base import SerialBase, SerialBaseConfig
from ambler.drivers.stream_device import SensorStream, StreamCamera, StreamImu, StreamLidar, StreamRangeSensor

START_TIMEOUT = 120.0
"""Seconds for a first start, in which kernels are compiled."""
STOP_TIMEOUT = 10.0


@dataclass(frozen=True, slots=True)
class SimulatorOptions:
    """What to simulate: `robots` as NAME=ROBOT or NAME=ROBOT@X,Y,DEG. `clock_offset` (s) and `clock_drift` (s/s) are those of the
    devices' clocks, `watchdog` (s) that of the bases."""

    world: str
    robots: tuple[str, ...]
    seed: int = 0
    physics: str = "contact"
    is_perfect: bool = False
    watchdog: float = 0.2
    clock_offset: float = 0.0
    clock_drift: float = 0.0

    def words(self) -> list[str]:
        """Return the arguments of the process."""
        pairs = {
            "--world": self.world,
            "--seed": self.seed,
            "--physics": self.physics,
            "--watchdog": self.watchdog,
            "--clock-offset": self.clock_offset,
            "--clock-drift": self.clock_drift,
        }
        words = [f"{key}={value}" for key, value in pairs.items()]
        return [*words, *(f"--robot={robot}" for robot in self.robots), *(("--perfect",) if self.is_perfect else ())]


class RunningSimulator:
    """The simulator in a process of its own, from entering the context until leaving it. `places` says where each robot is reached.

    `now_ns` is the executor's clock: ground truth is stamped by it. Raises BadInputError when the process refuses its arguments, and
    DeviceError when it does not get ready. The texts of its errors go to `simulator.log` in `folder`.
    """

    def __init__(self, options: SimulatorOptions, folder: Path, now_ns: Callable[[], int]) -> None:
        self._options, self._folder = options, folder
        self._offset_ns = now_ns() - time.monotonic_ns()
        self.places: dict[str, PortPlaces] = {}
        self.loop_times: dict[str, float] = {}
        """How the simulator's loop did, once it has ended: turns, longest_delay (s), late."""

    def __enter__(self) -> Self:
        self._folder.mkdir(parents=True, exist_ok=True)
        words = [*self._options.words(), f"--folder={self._folder}", f"--host-offset-ns={self._offset_ns}"]
        with (self._folder / "simulator.log").open("w") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "ambler.apps.simulator_process", *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        try:
            self.places = {name: PortPlaces(**places) for name, places in json.loads(self._first_line()).items()}
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def unplug(self, robot: str) -> None:
        """Pull the cable of a robot's base; raises DeviceError when the simulator is gone."""
        self._order(f"unplug {robot}")

    def plug(self, robot: str) -> None:
        """Plug the cable of a robot's base in again; raises DeviceError when the simulator is gone."""
        self._order(f"plug {robot}")

    def _order(self, line: str) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise DeviceError("the simulator is gone") from error

    def _first_line(self) -> str:
        assert self._process.stdout is not None
        if not select.select((self._process.stdout,), (), (), START_TIMEOUT)[0]:
            raise DeviceError(f"the simulator was not ready within {START_TIMEOUT:g} s")
        line = self._process.stdout.readline()
        if line:
            return line
        code, told = self._process.wait(), (self._folder / "simulator.log").read_text().strip()
        reason = told.splitlines()[-1] if told else f"code {code}"
        raise BadInputError(reason) if code == 2 else DeviceError(f"the simulator ended: {reason}")

    def _end(self) -> None:
        process = self._process
        try:
            told, _ = process.communicate(timeout=STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return
        with contextlib.suppress(ValueError, IndexError):
            self.loop_times = json.loads(told.splitlines()[-1])


def live_devices(
    robot: RobotModel,
    places: PortPlaces,
    now_ns: Callable[[], int],
    cameras: Mapping[str, CameraModel] | None = None,
    base: SerialBaseConfig | None = None,
) -> RobotDevices:
    """Return the drivers of a robot that is reached at `places`, none of them open: its base and battery over the line, and over the
    socket a sensor for every mount, named by its frame. `cameras` are their calibrations by frame; a camera without one is left out."""
    line = SerialBase(Path(places.base), now_ns, base)
    stream = SensorStream(places.sensors, now_ns)
    scanners: Sequence[str] = [mount.frame for mount in (*robot.scanners, *robot.clouds)]
    known = cameras if cameras is not None else {}
    return RobotDevices(
        base=line,
        lidars=tuple(StreamLidar(stream, frame, frame) for frame in scanners),
        imus=tuple(StreamImu(stream, mount.frame, mount.frame) for mount in robot.of_kind(SensorKind.IMU)),
        ranges=tuple(StreamRangeSensor(stream, mount.frame, mount.frame) for mount in robot.rangers),
        cameras=_cameras(stream, robot, SensorKind.CAMERA, known),
        depth_cameras=_cameras(stream, robot, SensorKind.DEPTH, known),
        battery=line.battery,
    )


def _cameras(
    stream: SensorStream, robot: RobotModel, kind: SensorKind, known: Mapping[str, CameraModel]
) -> tuple[StreamCamera, ...]:
    mounts = [mount for mount in robot.of_kind(kind) if mount.frame in known]
    return tuple(StreamCamera(stream, mount.frame, mount.frame, known[mount.frame]) for mount in mounts)
