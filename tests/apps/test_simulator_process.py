"""A robot whose simulator runs in another process: driven, judged by the ground truth recorded there, its cable pulled, its simulator
killed."""

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ambler.apps.robot_port import RobotPort, serve
from ambler.apps.simulator_client import RunningSimulator, SimulatorOptions, live_devices
from ambler.apps.simulator_process import RobotChoice
from ambler.core import messages as m
from ambler.core.devices import DeviceState, RobotDevices
from ambler.core.errors import BadInputError
from ambler.core.protocols import BodyVelocity
from ambler.core.robot import RobotModel, SensorKind, SensorMount
from ambler.core.se2 import SE2
from ambler.core.se3 import SE3
from ambler.drivers.serial_emulator import EmulatorConfig
from ambler.runtime.clock import SystemClock
from ambler.sim.robots import robot_named
from ambler.wire.mcap_reader import read_recording
from tests.devices.fakes import HOST, FakeBase, FakeBattery, FakeImu, wait_until

pytestmark = pytest.mark.live

WATCHDOG = 0.3


def test_any_devices_can_be_offered_to_another_process(tmp_path: Path) -> None:
    base, battery, imu = FakeBase(), FakeBattery(), FakeImu("imu")
    port = RobotPort("r", RobotDevices(base, imus=(imu,), battery=battery), tmp_path, EmulatorConfig(clock_offset=77.0))
    stopped = threading.Event()
    thread = threading.Thread(target=serve, args=([port.step], HOST, stopped))
    thread.start()
    mounts = (SensorMount("imu", SensorKind.IMU, SE3()),)
    model = RobotModel("r", robot_named("diff").model.drive, np.zeros((3, 2)), robot_named("diff").model.limits, mounts)
    devices = live_devices(model, port.places(), HOST)
    assert devices.battery is not None
    devices.base.open()
    devices.battery.open()
    devices.imus[0].open()
    devices.base.command(BodyVelocity(0.25, 0.0, 0.5))
    wait_until(lambda: base.velocity == BodyVelocity(0.25, 0.0, 0.5))
    got: list[m.Imu] = []
    wait_until(lambda: got.extend(devices.imus[0].read(HOST())) or len(got) > 20)
    assert got[-1].angular_velocity == imu.sent[-1].angular_velocity
    assert abs(HOST() - got[-1].stamp_ns) < 0.2e9
    wait_until(lambda: devices.battery.read(HOST()))
    for device in (devices.base, devices.battery, *devices.imus):
        device.close()
    stopped.set()
    thread.join()
    port.close()
    assert base.velocity == BodyVelocity()
    assert list(tmp_path.iterdir()) == []


def test_a_loop_in_real_time_keeps_its_period_and_counts_what_is_late() -> None:
    stopped, instants = threading.Event(), []

    def step(now_ns: int) -> None:
        instants.append(now_ns)
        if len(instants) == 5:
            while HOST() - now_ns < 30_000_000:
                pass
        if len(instants) == 20:
            stopped.set()

    times = serve([step], HOST, stopped, 0.01)
    assert times.turns == 20
    assert times.late >= 1
    assert 0.02 <= times.longest_delay < 0.2
    assert np.median(np.diff(instants)) == pytest.approx(10_000_000, rel=0.3)


@pytest.mark.parametrize("text", ["diff", "=diff", "a=", "a=diff@1,2", "a=diff@x,0,0", "a=diff@nan,0,0"])
def test_a_robot_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(BadInputError, match="expected NAME=ROBOT"):
        RobotChoice.from_text(text)


def test_robots_are_told_in_words() -> None:
    choice = RobotChoice("a", "diff", (-1.5, 0.25, 90.0))
    assert RobotChoice.from_text(choice.to_text()) == choice
    assert choice.to_spec().start == SE2(-1.5, 0.25, np.pi / 2)


CLOCK = SystemClock(from_zero=False)


def now_ns() -> int:
    return CLOCK.now_ns


OPTIONS = SimulatorOptions(
    "lab_empty", ("robot=diff",), physics="kinematic", watchdog=WATCHDOG, clock_offset=-500.0, clock_drift=5e-5
)


@pytest.fixture
def simulator(tmp_path: Path) -> Iterator[RunningSimulator]:
    with RunningSimulator(OPTIONS, tmp_path / "simulator", now_ns) as simulator:
        yield simulator


def open_all(devices: RobotDevices) -> None:
    assert devices.battery is not None
    for device in (devices.base, devices.battery, *devices.lidars, *devices.imus):
        device.open()


def drive(devices: RobotDevices, velocity: BodyVelocity, seconds: float) -> tuple[list[m.Odometry], list[m.LaserScan]]:
    """Command every 20 ms and read everything."""
    pause, end = threading.Event(), time.monotonic() + seconds
    odometry: list[m.Odometry] = []
    scans: list[m.LaserScan] = []
    while time.monotonic() < end:
        devices.base.command(velocity)
        odometry += devices.base.read(now_ns())
        scans += devices.lidars[0].read(now_ns())  # type: ignore[arg-type]
        pause.wait(0.02)
    return odometry, scans


def true_poses(simulator: RunningSimulator) -> list[m.Odometry]:
    recording = Path(simulator.places["robot"].truth)
    return [r.decode_as(m.Odometry) for r in read_recording(recording, {"/ground_truth/pose"})]


def test_a_drive_is_what_the_ground_truth_says_until_the_cable_is_pulled(
    simulator: RunningSimulator,
) -> None:
    devices = live_devices(robot_named("diff").model, simulator.places["robot"], now_ns)
    open_all(devices)
    odometry, scans = drive(devices, BodyVelocity(0.4, 0.0, 0.2), 2.0)
    assert devices.base.health().lost == 0
    assert abs(devices.base.health().clock_jumps) == 0
    last_command_ns = now_ns()
    simulator.unplug("robot")
    wait_until(lambda: devices.base.health().state is DeviceState.FAILED)
    failed_ns = now_ns()
    assert (failed_ns - last_command_ns) * 1e-9 < 0.5
    assert devices.lidars[0].health().state is DeviceState.OPEN
    seen = scans[-1].stamp_ns
    wait_until(lambda: any(s.stamp_ns > seen + 1_000_000_000 for s in devices.lidars[0].read(now_ns())))
    for device in (devices.base, *devices.lidars, *devices.imus):
        device.close()
    simulator.__exit__()

    truth = true_poses(simulator)
    stamps = np.array([t.stamp_ns for t in truth])
    # Odometry and truth are on one clock, although the devices' own stood 500 s behind and drifted: the same speed at the same time.
    begin = next(o.stamp_ns for o in odometry if o.linear[0] > 0.1)
    true_begin = next(t.stamp_ns for t in truth if t.linear[0] > 0.1)
    assert abs(begin - true_begin) * 1e-9 < 0.06
    a, b = odometry[-50], odometry[-1]
    near = [truth[int(np.abs(stamps - o.stamp_ns).argmin())] for o in (a, b)]
    told, true = a.pose.inverse() @ b.pose, near[0].pose.inverse() @ near[1].pose
    assert told.translation[0] == pytest.approx(true.translation[0], rel=0.08)
    assert true.translation[0] > 0.3
    assert len(scans) >= 12
    assert {s.frame for s in scans} == {"laser"}
    # The base's own watchdog stopped it: standing within its time, the line's delay, and braking from 0.4 m/s.
    moving = [t.stamp_ns for t in truth if t.linear[0] > 0.01]
    assert (moving[-1] - last_command_ns) * 1e-9 < WATCHDOG + 0.05 + 0.4 / 1.0 + 0.15
    assert (moving[-1] - last_command_ns) * 1e-9 > 0.1
    assert simulator.loop_times["turns"] > 300


def test_a_killed_simulator_fails_every_device(simulator: RunningSimulator) -> None:
    devices = live_devices(robot_named("diff").model, simulator.places["robot"], now_ns)
    open_all(devices)
    drive(devices, BodyVelocity(), 0.2)
    simulator._process.kill()
    everything = (devices.base, *devices.lidars, *devices.imus)
    wait_until(lambda: all(d.health().state is DeviceState.FAILED for d in everything))
    devices.base.command(BodyVelocity(0.1, 0.0, 0.0))
    assert [list(d.read(now_ns())) for d in everything] == [[]] * len(everything)
    for device in everything:
        device.close()


def test_a_simulator_that_cannot_start_says_why(tmp_path: Path) -> None:
    for options, reason in (
        (SimulatorOptions("nowhere", ("robot=diff",)), "nowhere"),
        (SimulatorOptions("lab_empty", ("robot=tank",)), "tank"),
    ):
        with pytest.raises(BadInputError, match=reason), RunningSimulator(options, tmp_path, now_ns):
            pass


def test_places_travel_as_json(tmp_path: Path) -> None:
    port = RobotPort("r", RobotDevices(FakeBase()), tmp_path)
    assert json.loads(json.dumps(port.places("t").to_json())) == {
        "base": str(tmp_path / "r.base"),
        "sensors": f"unix:{tmp_path / 'r.sensors'}",
        "truth": "t",
    }
    port.close()
