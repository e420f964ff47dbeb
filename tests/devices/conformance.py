"""What every device must do, whoever supplies it: checks to be run over each implementation by the tests of this folder.

A `Rig` holds one device with what makes it measure. Time is the rig's: real where threads and lines are involved, simulated elsewhere.
"""

import math
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any, Protocol

import pytest

from ambler.core.devices import WATCHDOG_MAX, Device, DeviceState
from ambler.core.protocols import BodyVelocity

READ_MAX = 0.02
"""Processor time and waiting (s) that no reading may exceed; the simulated devices, which simulate in `read`, are excepted."""
_PATIENCE = 5.0


class Rig(Protocol):
    """One device, its clock, and what a test may do to it. `steps_in_read`: the device does work of its own in `read` that a real one
    would not. `body_velocity` and `breaks` are None where the device is no base, or cannot break."""

    device: Any
    steps_in_read: bool

    def now_ns(self) -> int: ...

    def wait(self, seconds: float) -> None:
        """Let time pass; what is beside the device goes on."""
        ...

    body_velocity: Callable[[], BodyVelocity] | None
    breaks: Callable[[], None] | None


def collect(rig: Rig, count: int) -> list[Any]:
    """Read in the device's rhythm until so many messages have come; fails when they do not."""
    got: list[Any] = []
    for _ in range(round(_PATIENCE / rig.device.poll_period)):
        got += rig.device.read(rig.now_ns())
        if len(got) >= count:
            return got
        rig.wait(rig.device.poll_period)
    pytest.fail(f"{rig.device.name} sent {len(got)} of {count} messages in {_PATIENCE} s")


def check_life(rig: Rig) -> None:
    device: Device = rig.device
    assert device.name
    assert 0.001 <= device.poll_period <= 0.5
    assert device.health().state is DeviceState.CLOSED
    assert list(rig.device.read(rig.now_ns())) == []
    device.open()
    device.open()
    assert device.health().state is DeviceState.OPEN
    assert device.health().text == ""
    got = collect(rig, 2)
    assert device.health().messages >= len(got)
    device.close()
    device.close()
    assert device.health().state is DeviceState.CLOSED
    assert list(rig.device.read(rig.now_ns())) == []


def check_stamps(rig: Rig) -> None:
    """Stamps rise, and lie in the past of the rig's clock, by less than a device may delay."""
    rig.device.open()
    got = collect(rig, 2)
    for _ in range(20):
        rig.wait(rig.device.poll_period)
        read = rig.device.read(rig.now_ns())
        now_ns = rig.now_ns()  # after it: a message may arrive between the asking and the reading
        for message in read:
            got.append(message)
            assert -1 <= now_ns - message.stamp_ns < 0.5e9
    stamps = [message.stamp_ns for message in got]
    assert all(a < b for a, b in pairwise(stamps))
    frame = getattr(rig.device, "frame", None)
    assert not frame or {message.frame for message in got} == {frame}


def check_reading_never_waits(rig: Rig) -> None:
    rig.device.open()
    collect(rig, 1)
    slowest = 0.0
    for _ in range(30):
        rig.wait(rig.device.poll_period / 3)
        now_ns, start = rig.now_ns(), time.perf_counter()
        rig.device.read(now_ns)
        again = time.perf_counter()
        assert list(rig.device.read(now_ns)) == [] or not rig.steps_in_read
        slowest = max(slowest, time.perf_counter() - again, 0.0 if rig.steps_in_read else again - start)
    assert slowest < READ_MAX


def check_base(rig: Rig) -> None:
    """Its own watchdog stops it in time; what is no number is a stop; so is closing it."""
    base, velocity = rig.device, rig.body_velocity
    assert velocity is not None
    base.command(BodyVelocity(0.2, 0.0, 0.0))
    rig.wait(0.2)
    assert velocity() == BodyVelocity(), "a base that is closed must not drive"
    base.open()
    assert 0.0 < base.watchdog <= WATCHDOG_MAX
    _drive(rig, 0.3)
    assert velocity().vx == pytest.approx(0.2, rel=0.2)
    rig.wait(base.watchdog + 0.3)
    assert velocity().vx == pytest.approx(0.0, abs=0.01)
    for value in (math.nan, math.inf, -math.inf):
        _drive(rig, 0.3)
        assert velocity().vx > 0.1
        for bad in (BodyVelocity(value, 0.0, 0.0), BodyVelocity(0.2, value, 0.0), BodyVelocity(0.2, 0.0, value)):
            base.command(bad)
        rig.wait(0.3)
        assert velocity().vx == pytest.approx(0.0, abs=0.01)
    _drive(rig, 0.3)
    assert velocity().vx > 0.1
    base.close()
    rig.wait(0.3)
    assert velocity().vx == pytest.approx(0.0, abs=0.01), "a base stops before it is closed"


def check_failure(rig: Rig) -> None:
    """A device whose line breaks is FAILED, with a sentence, returns nothing, and never raises."""
    rig.device.open()
    collect(rig, 2)
    assert rig.breaks is not None
    rig.breaks()
    end = rig.now_ns() + round(_PATIENCE * 1e9)
    while rig.device.health().state is not DeviceState.FAILED:
        assert rig.now_ns() < end
        rig.device.read(rig.now_ns())
        rig.wait(0.01)
    assert rig.device.health().text
    for _ in range(5):
        assert list(rig.device.read(rig.now_ns())) == []
        for act in ("command", "request", "stop_charging"):
            arguments = {"command": (BodyVelocity(0.1, 0.0, 0.0),), "request": (rig.now_ns() + 10**9,)}.get(act, ())
            getattr(rig.device, act, lambda *_: None)(*arguments)
        rig.wait(0.01)
    assert rig.device.health().state is DeviceState.FAILED
    rig.device.close()
    assert rig.device.health().state is DeviceState.CLOSED


def _drive(rig: Rig, seconds: float) -> None:
    """Command 0.2 m/s forwards every 50 ms."""
    for _ in range(round(seconds / 0.05)):
        rig.device.command(BodyVelocity(0.2, 0.0, 0.0))
        rig.wait(0.05)
