"""A base behind a pseudo-terminal: commands there, odometry back, noise, a pulled cable, the watchdog, throughput."""

import itertools
import math
import os
import random
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ambler.core.devices import DeviceState
from ambler.core.errors import DeviceError
from ambler.core.messages import Odometry
from ambler.core.protocols import BodyVelocity
from ambler.drivers.serial_base import QUEUE, SerialBase, SerialBaseConfig
from ambler.drivers.serial_emulator import EmulatorConfig, SerialEmulator
from ambler.drivers.serial_frame import ODOMETRY, Frame, FrameKind
from tests.devices.fakes import HOST, FakeBase, FakeBattery, Stepper, wait_until

WATCHDOG = 0.2


class Rig:
    """A driver and, beside it, an emulated base."""

    def __init__(self, link: Path, config: EmulatorConfig | None = None, period: float = 0.01) -> None:
        self.body, self.cells = FakeBase(period), FakeBattery()
        self.emulator = SerialEmulator(self.body, self.cells, config or EmulatorConfig(watchdog=WATCHDOG), link)
        self.stepper = Stepper(self.emulator.step)
        self.base = SerialBase(link, HOST)

    def __enter__(self) -> "Rig":
        self.stepper.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.stepper.__exit__(*error)
        self.base.close()
        self.base.battery.close()
        self.emulator.unplug()

    def collect(self, count: int) -> list[Odometry]:
        got: list[Odometry] = []
        wait_until(lambda: got.extend(self.base.read(HOST())) or len(got) >= count)
        return got


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    with Rig(tmp_path / "base") as rig:
        yield rig


def test_commands_arrive_bit_for_bit_and_in_order(rig: Rig) -> None:
    rig.base.open()
    assert rig.base.robot_name == "emulated base 1"
    assert rig.base.watchdog == pytest.approx(WATCHDOG)
    wanted = [BodyVelocity(0.1 * i, -1 / 3, math.pi * i) for i in range(50)]
    for i, velocity in enumerate(wanted):
        rig.base.command(velocity)
        wait_until(lambda i=i: rig.emulator.commands > i)
    assert [v for _, v in rig.body.commands] == wanted


def test_odometry_comes_back_bit_for_bit(rig: Rig) -> None:
    rig.base.open()
    rig.base.command(BodyVelocity(0.3, -0.1, 0.7))
    got = rig.collect(30)
    sent = [o.pose for o in rig.body.sent]
    first = sent.index(got[0].pose)
    assert [o.pose for o in got] == sent[first : first + len(got)]
    assert [(o.linear, o.angular) for o in got] == [
        (o.linear, o.angular) for o in rig.body.sent[first : first + len(got)]
    ]
    assert (got[0].frame, got[0].child) == ("odom", "base")
    assert rig.base.health().lost == 0
    assert rig.base.health().messages >= len(got)


def test_stamps_are_those_of_the_host_whatever_the_bases_clock_says(tmp_path: Path) -> None:
    config = EmulatorConfig(watchdog=WATCHDOG, clock_offset=-1234.5, clock_drift=1e-4)
    with Rig(tmp_path / "base", config) as rig:
        rig.base.open()
        got = rig.collect(100)
        sent = {o.pose: o.stamp_ns for o in rig.body.sent}
        error = np.array([o.stamp_ns - sent[o.pose] for o in got]) * 1e-9
        assert (np.diff([o.stamp_ns for o in got]) > 0).all()
        assert np.abs(np.median(error)) < 0.005
        assert error.min() > -0.002
        # The base's clock, as microseconds that wrapped, stands behind by whole wraps and by its offset.
        offset = rig.base.health().clock_offset
        assert offset is not None
        wraps, expected = 2**32 * 1e-6, 1234.5 - 1e-4 * HOST() * 1e-9
        assert abs((offset - expected + wraps / 2) % wraps - wraps / 2) < 0.02


def test_a_jump_of_the_bases_clock_is_counted_and_named(tmp_path: Path) -> None:
    with Rig(tmp_path / "base") as rig:
        rig.base.open()
        rig.collect(150)
        rig.emulator.config = EmulatorConfig(watchdog=WATCHDOG, clock_offset=-7.25)
        rig.collect(50)
        health = rig.base.health()
        assert (health.state, health.clock_jumps) == (DeviceState.OPEN, 1)
        assert "-7.2" in health.text
        newest = rig.collect(20)[-1]
        assert abs(HOST() - newest.stamp_ns) < 0.1e9


def test_the_covariance_grows_with_the_path(rig: Rig) -> None:
    rig.base.open()
    rig.base.command(BodyVelocity(1.0, 0.0, 0.0))
    got = rig.collect(40)
    path = sum(math.hypot(*(a.pose.inverse() @ b.pose).translation[:2]) for a, b in itertools.pairwise(got))
    grown = math.sqrt(got[-1].pose_covariance[0, 0] - 1e-6) - math.sqrt(got[0].pose_covariance[0, 0] - 1e-6)
    assert path > 0.05
    assert grown == pytest.approx(SerialBaseConfig().path_error * path, rel=0.1)


def test_the_base_stops_by_itself_when_no_command_comes(rig: Rig) -> None:
    rig.base.open()
    rig.base.command(BodyVelocity(0.5, 0.0, 0.0))
    wait_until(lambda: len(rig.body.commands) == 2)
    (start, velocity), (end, stopped) = rig.body.commands
    assert (velocity.vx, stopped) == (0.5, BodyVelocity())
    assert WATCHDOG - 0.005 <= (end - start) * 1e-9 < WATCHDOG + 0.15  # it counts from when the frame came, just before


def test_a_pulled_cable_fails_the_driver_and_stops_the_base(rig: Rig) -> None:
    rig.base.open()
    rig.base.battery.open()
    rig.base.command(BodyVelocity(0.5, 0.0, 0.0))
    wait_until(lambda: rig.emulator.commands == 1)
    commanded = rig.body.commands[0][0]
    with rig.stepper.paused():
        rig.emulator.unplug()
    wait_until(lambda: rig.base.health().state is DeviceState.FAILED)
    assert "broke" in rig.base.health().text
    assert rig.base.battery.health().state is DeviceState.FAILED
    assert list(rig.base.read(HOST())) == []
    rig.base.command(BodyVelocity(0.5, 0.0, 0.0))
    wait_until(lambda: rig.body.velocity == BodyVelocity())
    assert (rig.body.commands[-1][0] - commanded) * 1e-9 < WATCHDOG + 0.15


def test_a_cable_plugged_in_again_works_after_open(rig: Rig) -> None:
    rig.base.open()
    rig.base.battery.open()
    with rig.stepper.paused():
        rig.emulator.unplug()
    wait_until(lambda: rig.base.health().state is DeviceState.FAILED)
    with pytest.raises(DeviceError, match="cannot be opened"):
        rig.base.open()
    assert rig.base.health().state is DeviceState.FAILED
    with rig.stepper.paused():
        rig.emulator.plug()
    rig.base.open()
    assert rig.collect(3)
    rig.base.command(BodyVelocity(0.25, 0.0, 0.0))
    wait_until(lambda: rig.body.velocity.vx == 0.25)
    wait_until(lambda: rig.base.battery.read(HOST()))


def test_odometry_that_is_turned_by_no_rotation_is_dropped(rig: Rig) -> None:
    """A frame whose quaternion has not the length 1 makes no pose, and what comes after it is heard."""
    rig.base.open()
    rig.collect(3)
    for rotation in ((0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 0.0)):
        payload = ODOMETRY.pack(0, 0.0, 0.0, 0.0, *rotation, *6 * (0.0,))
        with rig.stepper.paused():
            rig.base._on_odometry(Frame(FrameKind.ODOMETRY, 0, 0, payload), HOST())
    got = rig.collect(5)
    assert all(math.hypot(*o.pose.rotation) == pytest.approx(1.0) for o in got)
    assert rig.base.health().state is DeviceState.OPEN


def test_whatever_goes_wrong_on_the_line_fails_the_driver(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread of the line does not end without a word."""
    rig.base.open()

    def stumble() -> bool:
        raise ZeroDivisionError("of what came")

    monkeypatch.setattr(rig.base._link, "_turn", stumble)
    wait_until(lambda: rig.base.health().state is DeviceState.FAILED)
    assert "cannot be read: ZeroDivisionError" in rig.base.health().text


def test_a_line_that_falls_silent_fails(rig: Rig) -> None:
    rig.base.open()
    rig.collect(3)
    start = time.monotonic()
    with rig.stepper.paused():
        wait_until(lambda: rig.base.health().state is DeviceState.FAILED)
    assert 0.9 < time.monotonic() - start < 1.6
    assert "nothing valid came" in rig.base.health().text


def test_noise_on_the_line_loses_what_it_hit_and_is_counted(rig: Rig) -> None:
    rng = random.Random(8)
    rig.base.open()
    for _ in range(40):
        with rig.stepper.paused():
            rig.emulator.send_raw(rng.randbytes(rng.randrange(1, 60)))
        rig.collect(1)
    got = rig.collect(20)
    sent = {o.pose for o in rig.body.sent}
    assert all(o.pose in sent for o in got)
    assert rig.base.health().state is DeviceState.OPEN
    assert rig.base.damaged > 10


def test_noise_towards_the_base_never_moves_it(rig: Rig) -> None:
    rng = random.Random(9)
    line = os.open(rig.emulator.path, os.O_WRONLY | os.O_NOCTTY)
    for _ in range(200):
        os.write(line, rng.randbytes(200))
    os.close(line)
    rig.base.open()
    rig.collect(5)
    assert all(v == BodyVelocity() for _, v in rig.body.commands)


def test_a_battery_shares_the_line(rig: Rig) -> None:
    battery = rig.base.battery
    battery.open()
    got = []
    wait_until(lambda: got.extend(battery.read(HOST())) or got)
    assert got[0].voltage == np.float32(25.3)
    assert got[0].current == np.float32(-1.7)
    assert got[0].share == np.float32(0.81)
    assert got[0].supply.name == "DISCHARGING"
    battery.stop_charging()
    wait_until(lambda: rig.cells.stops == 1)
    assert rig.base.health().state is DeviceState.CLOSED
    battery.close()
    assert battery.health().state is DeviceState.CLOSED


def test_a_fault_of_the_base_fails_the_driver_by_name(rig: Rig) -> None:
    rig.base.open()
    with rig.stepper.paused():
        rig.emulator.report_fault(17, "left motor too hot", HOST())
    wait_until(lambda: rig.base.health().state is DeviceState.FAILED)
    assert rig.base.health().text == "the base reports fault 17: left motor too hot"


def test_a_node_that_reads_late_loses_the_oldest_and_knows_it(tmp_path: Path) -> None:
    with Rig(tmp_path / "base", period=0.0) as rig:
        rig.base.open()
        wait_until(lambda: rig.base.health().messages > QUEUE + 50)
        got = rig.base.read(HOST())
        assert len(got) == QUEUE
        assert rig.base.health().lost >= 50


def test_opening_refuses_what_is_no_base(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no line")
    master, slave = os.openpty()
    with pytest.raises(DeviceError, match="answers as a base"):
        SerialBase(Path(os.ttyname(slave)), HOST).open()
    os.close(master)
    os.close(slave)
    for path, reason in ((tmp_path / "nothing", "No such file"), (tmp_path / "file", "no serial line")):
        with pytest.raises(DeviceError, match=reason):
            SerialBase(path, HOST).open()
    with pytest.raises(DeviceError, match="baud"):
        SerialBase(tmp_path / "file", HOST, SerialBaseConfig(baud=12345)).open()


def test_opening_refuses_a_watchdog_that_is_too_long(tmp_path: Path) -> None:
    with Rig(tmp_path / "base", EmulatorConfig(watchdog=0.8)) as rig, pytest.raises(DeviceError, match="800 ms"):
        rig.base.open()


def test_two_programs_cannot_have_one_line(rig: Rig) -> None:
    rig.base.open()
    with pytest.raises(DeviceError, match="in use"):
        SerialBase(rig.emulator.path, HOST).open()


def test_throughput(tmp_path: Path) -> None:
    """The thread of the line takes at least 2000 odometries a second: forty times what a base sends."""
    with Rig(tmp_path / "base", period=0.0) as rig:
        rig.base.open()
        start, before, cpu = time.monotonic(), rig.base.health().messages, time.thread_time()
        with rig.stepper.paused():
            for _ in range(2000):
                rig.emulator.step(HOST())
                if _ % 20 == 0:
                    wait_until(lambda i=_: rig.base.health().messages - before >= i - 20)
        wait_until(lambda: rig.base.health().messages - before >= 2000 - rig.emulator.unsent)
        assert rig.emulator.unsent == 0
        assert time.monotonic() - start < 1.0 + 4.0 * (time.thread_time() - cpu)
