"""Small devices whose behaviour a test can state, and what steps the other end of a line beside a test."""

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ambler.core import messages as m
from ambler.core.devices import DeviceHealth, DeviceState
from ambler.core.protocols import BodyVelocity
from ambler.core.se3 import SE3

HOST = time.monotonic_ns


def wait_until(predicate: Callable[[], object], seconds: float = 5.0) -> None:
    """Wait for other threads until something holds; fails when it does not in time."""
    end = time.monotonic() + seconds
    pause = threading.Event()
    while not predicate():
        assert time.monotonic() < end, f"not within {seconds} s"
        pause.wait(0.001)


class FakeBase:
    """A base that keeps its commands with their instants and integrates them; odometry every `period` s."""

    name, poll_period, watchdog = "fake_base", 0.01, 0.5

    def __init__(self, period: float = 0.02) -> None:
        self.commands: list[tuple[int, BodyVelocity]] = []
        self.sent: list[m.Odometry] = []
        self._period_ns, self._next_ns = round(period * 1e9), 0
        self._pose, self._last_ns = SE3((1 / 3, -1e-9, 1e6), (0.5, 0.5, -0.5, 0.5)), None
        self.velocity = BodyVelocity()

    def open(self) -> None: ...

    def close(self) -> None:
        self.command(BodyVelocity())

    def health(self) -> DeviceHealth:
        return DeviceHealth(DeviceState.OPEN)

    def command(self, velocity: BodyVelocity) -> None:
        self.velocity = velocity
        self.commands.append((HOST(), velocity))

    def read(self, now_ns: int) -> Sequence[m.Odometry]:
        if now_ns < self._next_ns:
            return ()
        elapsed = self._period_ns * 1e-9
        self._next_ns = now_ns + self._period_ns
        v = self.velocity
        self._pose = self._pose @ SE3.from_rpy((v.vx * elapsed, v.vy * elapsed, 0.0), 1e-3, -2e-3, v.wz * elapsed)
        covariance = np.eye(6)
        self.sent.append(
            m.Odometry(now_ns, "odom", "base", self._pose, (v.vx, v.vy, 0.1), (0.2, 0.3, v.wz), covariance, covariance)
        )
        return self.sent[-1:]


class FakeBattery:
    """A battery that tells its state ten times a second."""

    name, poll_period = "fake_battery", 0.1

    def __init__(self) -> None:
        self.stops = 0
        self._next_ns = 0

    def open(self) -> None: ...

    def close(self) -> None: ...

    def health(self) -> DeviceHealth:
        return DeviceHealth(DeviceState.OPEN)

    def stop_charging(self) -> None:
        self.stops += 1

    def read(self, now_ns: int) -> Sequence[m.BatteryState]:
        if now_ns < self._next_ns:
            return ()
        self._next_ns = now_ns + 100_000_000
        return [m.BatteryState(now_ns, "base", 25.3, -1.7, 0.81, m.PowerSupply.DISCHARGING)]


class Stepper:
    """Calls `step(now_ns)` every two milliseconds in a thread of its own, as firmware or a simulator would."""

    def __init__(self, step: Callable[[int], object], now_ns: Callable[[], int] = HOST) -> None:
        self._step, self._now_ns = step, now_ns
        self._stopped = threading.Event()
        self._turn = threading.Lock()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._stopped.wait(0.002):
            with self._turn:
                self._step(self._now_ns())

    def paused(self) -> threading.Lock:
        """Let a test act between two steps: `with stepper.paused(): ...`."""
        return self._turn

    def __enter__(self) -> "Stepper":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()


class FakeImu:
    """An inertial unit whose samples differ; one every `period` s."""

    poll_period = 0.005

    def __init__(self, name: str, period: float = 0.01) -> None:
        self.name = self.frame = name
        self.sent: list[m.Imu] = []
        self._period_ns, self._next_ns = round(period * 1e9), 0

    def open(self) -> None: ...

    def close(self) -> None: ...

    def health(self) -> DeviceHealth:
        return DeviceHealth(DeviceState.OPEN)

    def read(self, now_ns: int) -> Sequence[m.Imu]:
        if now_ns < self._next_ns:
            return ()
        self._next_ns = now_ns + self._period_ns
        self.sent.append(m.Imu(now_ns, self.frame, (0.1 * len(self.sent), 1 / 3, -0.2), (0.0, 0.1, 9.81)))
        return self.sent[-1:]


class FakeSensor:
    """Sends what `make` builds for an instant, every `period` s: a sensor, a camera, or a battery."""

    poll_period, frame = 0.005, "fake"

    def __init__(self, name: str, make: Callable[[int], Any], period: float = 0.01) -> None:
        self.name, self._make = name, make
        self._period_ns, self._next_ns = round(period * 1e9), 0
        self.stops = self.wanted_ns = 0

    def request(self, until_ns: int) -> None:
        self.wanted_ns = until_ns

    def stop_charging(self) -> None:
        self.stops += 1

    def read(self, now_ns: int) -> Sequence[Any]:
        if now_ns < self._next_ns:
            return ()
        self._next_ns = now_ns + self._period_ns
        return [self._make(now_ns)]
