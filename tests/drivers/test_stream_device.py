"""Sensors behind a local socket: bit for bit, in host time, losses counted, failures named."""

import socket
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.devices import DeviceHealth, DeviceState
from ambler.core.errors import BadInputError, DeviceError
from ambler.drivers import stream_server
from ambler.drivers.stream_device import (
    QUEUE,
    SensorStream,
    StreamBattery,
    StreamCamera,
    StreamImu,
    StreamLidar,
    StreamRangeSensor,
)
from ambler.drivers.stream_frame import StreamFrame, StreamKind, StreamReader
from ambler.drivers.stream_server import StreamServer
from ambler.nodes.devices.sensors import ImuNode
from ambler.runtime.topics import IMU
from ambler.wire.ros_messages import encode
from tests.devices.fakes import HOST, FakeBattery, Stepper, wait_until
from tests.hand_made_context import HandMadeContext

pytestmark = pytest.mark.live

OFFSET = -987_654_321_012
"""What the other side's clock says less what ours says, nanoseconds."""
MODEL = CameraModel("camera", 4, 3, 2.0, 2.0, 1.5, 1.0)


def device_ns(now_ns: int) -> int:
    return now_ns + OFFSET


class Sensor:
    """Sends what `make` builds every `period_ns`, stamped `age_ns` ago; keeps what it sent."""

    poll_period = 0.005

    def __init__(self, name: str, make: Any, period_ns: int = 10_000_000, age_ns: int = 0) -> None:
        self.name, self._make, self._period_ns, self._age_ns = name, make, period_ns, age_ns
        self._next_ns = 0
        self.sent: list[Any] = []

    def read(self, now_ns: int) -> Sequence[Any]:
        if now_ns < self._next_ns:
            return ()
        self._next_ns = now_ns + self._period_ns
        self.sent.append(self._make(now_ns - self._age_ns))
        return self.sent[-1:]


class Eye(Sensor):
    """A camera that takes pictures only while they are wanted."""

    frame, model, wanted_ns = "eye", MODEL, 0

    def request(self, until_ns: int) -> None:
        self.wanted_ns = until_ns

    def read(self, now_ns: int) -> Sequence[Any]:
        return super().read(now_ns) if now_ns < self.wanted_ns else ()


def scan(stamp_ns: int) -> m.LaserScan:
    ranges = np.random.default_rng(stamp_ns % 1000).uniform(0.1, 30.0, 360).astype(np.float32)
    return m.LaserScan(stamp_ns, "laser", -1.0, 0.02, 1e-5, 0.05, 0.1, 30.0, ranges, np.empty(0, np.float32))


def imu(stamp_ns: int) -> m.Imu:
    return m.Imu(stamp_ns, "chip", (0.1, 1 / 3, -0.2), (0.0, 0.1, 9.81))


def echo(stamp_ns: int) -> m.Range:
    return m.Range(stamp_ns, "left", 0.5, 0.02, 4.0, 1.25)


def picture(stamp_ns: int) -> m.Image:
    return m.Image(stamp_ns, "eye", np.arange(12, dtype=np.uint8).reshape(3, 4))


class Rig:
    """A server and one client with a device of every kind."""

    def __init__(self, address: str, imu_period_ns: int = 10_000_000) -> None:
        self.laser, self.chip = Sensor("laser", scan, age_ns=80_000_000), Sensor("imu", imu, imu_period_ns)
        self.left, self.eye, self.cells = Sensor("left", echo), Eye("eye", picture), FakeBattery()
        self.server = StreamServer(address, [self.laser, self.chip, self.left], [self.eye], [self.cells], device_ns)
        self.stepper = Stepper(self.server.step)
        self.stream = stream = SensorStream(self.server.address, HOST)
        self.lidar, self.imu = StreamLidar(stream, "laser", "front_lidar"), StreamImu(stream, "imu", "imu_link")
        self.range, self.camera = (
            StreamRangeSensor(stream, "left", "left_us"),
            StreamCamera(stream, "eye", "cam", MODEL),
        )
        self.battery = StreamBattery(stream, "fake_battery", "base")
        self.devices = (self.lidar, self.imu, self.range, self.camera, self.battery)

    def __enter__(self) -> "Rig":
        self.stepper.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.stepper.__exit__(*error)
        for device in self.devices:
            device.close()
        self.server.close()

    @staticmethod
    def collect(device: Any, count: int) -> list[Any]:
        got: list[Any] = []
        wait_until(lambda: got.extend(device.read(HOST())) or len(got) >= count)
        return got


@pytest.fixture(params=["unix", "tcp"])
def rig(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Rig]:
    with Rig(f"unix:{tmp_path / 'sensors'}" if request.param == "unix" else "tcp:0") as rig:
        yield rig


def test_messages_come_bit_for_bit_in_the_frame_of_the_mount(rig: Rig) -> None:
    rig.lidar.open()
    rig.imu.open()
    scans, samples = rig.collect(rig.lidar, 10), rig.collect(rig.imu, 10)
    ranges = [s.ranges.tobytes() for s in rig.laser.sent]
    first = ranges.index(scans[0].ranges.tobytes())
    assert [s.ranges.tobytes() for s in scans] == ranges[first : first + len(scans)]
    assert scans[0].angle_increment == np.float32(0.02)
    assert {s.frame for s in scans} == {"front_lidar"}
    assert samples[0].angular_velocity == (0.1, 1 / 3, -0.2)
    assert rig.lidar.health().lost == 0


def test_a_scan_that_takes_long_keeps_the_stamp_of_its_first_ray(rig: Rig) -> None:
    """80 ms pass between stamp and sending: they are no offset of the clock."""
    rig.lidar.open()
    got = rig.collect(rig.lidar, 60)
    sent = {s.ranges.tobytes(): s.stamp_ns for s in rig.laser.sent}
    true = np.array([sent[s.ranges.tobytes()] for s in got])
    error = np.array([s.stamp_ns for s in got]) - true
    assert np.abs(np.median(error)) < 3_000_000
    assert (np.diff([s.stamp_ns for s in got]) > 0).all()
    assert rig.lidar.health().clock_offset == pytest.approx(-OFFSET * 1e-9, abs=0.01)


def test_ranges_and_batteries(rig: Rig) -> None:
    rig.range.open()
    rig.battery.open()
    assert rig.collect(rig.range, 1)[0].range == 1.25
    assert rig.collect(rig.battery, 1)[0].voltage == np.float32(25.3)
    rig.battery.stop_charging()
    wait_until(lambda: rig.cells.stops == 1)


def test_a_camera_takes_pictures_while_they_are_wanted(rig: Rig) -> None:
    rig.camera.open()
    rig.range.open()
    rig.collect(rig.range, 5)
    assert list(rig.camera.read(HOST())) == []
    until_ns = HOST() + 300_000_000
    rig.camera.request(until_ns)
    assert rig.collect(rig.camera, 5)[0].data.tolist() == np.arange(12).reshape(3, 4).tolist()
    assert rig.eye.wanted_ns == pytest.approx(until_ns, abs=20_000_000)
    rig.camera.request(HOST() - 1)
    assert rig.camera.model is MODEL


def test_a_server_that_goes_fails_all_its_devices_and_a_new_one_heals_them(rig: Rig) -> None:
    for device in rig.devices:
        device.open()
    rig.collect(rig.imu, 3)
    with rig.stepper.paused():
        rig.server.disconnect()
    wait_until(lambda: all(d.health().state is DeviceState.FAILED for d in rig.devices))
    assert "broke" in rig.imu.health().text
    assert [list(d.read(HOST())) for d in rig.devices] == [[]] * 5
    rig.imu.open()
    rig.collect(rig.imu, 3)
    assert rig.lidar.health().state is DeviceState.OPEN
    rig.collect(rig.lidar, 3)


def test_a_server_that_hangs_is_noticed(rig: Rig) -> None:
    rig.imu.open()
    rig.collect(rig.imu, 3)
    with rig.stepper.paused():
        wait_until(lambda: rig.imu.health().state is DeviceState.FAILED)
    assert "nothing valid came" in rig.imu.health().text


def test_a_node_that_reads_late_loses_the_oldest_and_knows_it(tmp_path: Path) -> None:
    with Rig(f"unix:{tmp_path / 'sensors'}", imu_period_ns=0) as rig:
        rig.imu.open()
        wait_until(lambda: rig.imu.health().messages > QUEUE + 20)
        assert len(rig.imu.read(HOST())) == QUEUE
        assert rig.imu.health().lost >= 20


def test_a_slow_client_loses_messages_and_the_server_never_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream_server, "PENDING_MAX", 20_000)
    laser = Sensor("laser", scan, 0)
    server = StreamServer(f"unix:{tmp_path / 's'}", [laser])
    slow = socket.socket(socket.AF_UNIX)
    slow.connect(str(tmp_path / "s"))
    for i in range(1000):
        server.step(i)
    assert len(laser.sent) == 1000
    assert server.dropped > 500
    laser._next_ns = 2**62
    reader, frames = StreamReader(), []
    slow.settimeout(0.2)
    while not frames or frames[-1].sequence < 1000:
        frames += list(reader.feed(slow.recv(1 << 16)))
        server.step(1000)
    messages = [f for f in frames if f.kind == StreamKind.MESSAGE]
    assert 1000 - len(messages) == server.dropped
    assert all(f.body == encode(laser.sent[f.sequence - 1]) for f in messages)
    slow.close()
    server.close()


def test_gaps_in_the_numbers_of_messages_are_counted(rig: Rig) -> None:
    rig.imu.open()
    rig.collect(rig.imu, 3)
    assert rig.imu.health().lost == 0
    with rig.stepper.paused():
        rig.server._sequences["imu"] += 5
    rig.collect(rig.imu, 10)
    assert rig.imu.health().lost == 5


def test_opening_names_what_is_wrong(rig: Rig, tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="has no rear, only eye, fake_battery, imu, laser, left"):
        StreamImu(rig.stream, "rear", "rear").open()
    with pytest.raises(DeviceError, match="received already"):
        StreamImu(rig.stream, "imu", "imu")
    for address, reason in (
        (f"unix:{tmp_path / 'no'}", "No such file"),
        ("udp:5", "neither"),
        ("tcp:99999", "neither"),
    ):
        with pytest.raises(DeviceError, match=reason):
            StreamImu(SensorStream(address, HOST), "imu", "imu").open()
    with pytest.raises(DeviceError, match="cannot be served"):
        StreamServer(rig.server.address)


def test_another_kind_of_message_fails_by_name(rig: Rig) -> None:
    wrong = StreamImu(SensorStream(rig.server.address, HOST), "laser", "imu")
    wrong.open()
    wait_until(lambda: wrong.health().state is DeviceState.FAILED)
    assert "laser sends sensor_msgs/msg/LaserScan, which a StreamImu does not" in wrong.health().text
    wrong.close()


@pytest.mark.parametrize("noise", [b"HTTP/1.1 200 OK\r\n\r\n", b"\xff" * 64, b"\x14\x00\x00\x00" + b"\xff" * 20])
def test_what_is_no_server_of_sensors_is_refused(noise: bytes) -> None:
    server = socket.create_server(("127.0.0.1", 0))

    def babble() -> None:
        connection, _ = server.accept()
        connection.sendall(noise)
        connection.recv(1)
        connection.close()

    thread = threading.Thread(target=babble)
    thread.start()
    with pytest.raises(DeviceError):
        StreamImu(SensorStream(f"tcp:{server.getsockname()[1]}", HOST), "imu", "imu").open()
    thread.join()
    server.close()


def test_garbage_from_a_client_costs_that_client_only(rig: Rig) -> None:
    rig.imu.open()
    kind, _, rest = rig.server.address.partition(":")
    bad = socket.socket(socket.AF_UNIX if kind == "unix" else socket.AF_INET)
    bad.connect(rest if kind == "unix" else ("127.0.0.1", int(rest)))
    wait_until(lambda: rig.server.clients == 2)
    bad.sendall(b"\xff" * 100)
    wait_until(lambda: rig.server.clients == 1)
    rig.collect(rig.imu, 5)
    bad.close()


@pytest.mark.parametrize("size", [1, 3, 1000])
def test_frames_cut_anywhere_are_put_together(size: int) -> None:
    frames = [
        StreamFrame(StreamKind.MESSAGE, "laser", "sensor_msgs/msg/LaserScan", 7, -5, encode(scan(3))),
        StreamFrame(StreamKind.TIME, sent_ns=2**62),
        StreamFrame(StreamKind.PICTURES, "câmera", body=b"\x00" * 8),
    ]
    data, reader = b"".join(f.encode() for f in frames), StreamReader()
    assert [f for i in range(0, len(data), size) for f in reader.feed(data[i : i + size])] == frames
    with pytest.raises(BadInputError):
        list(StreamReader().feed(b"\x10\x00\x00\x00" + b"\x01\xff\xff" + bytes(13)))


def test_a_sensor_says_once_that_there_is_something_to_read(rig: Rig) -> None:
    """Whoever reads only when it is told misses nothing, and is not told again before it has read."""
    told: list[int] = []
    rig.imu.announce(lambda: told.append(rig.imu.health().messages))
    rig.imu.open()
    wait_until(lambda: rig.imu.health().messages > 5)
    assert told == [1]
    got: list[Any] = []
    rig.imu.announce(lambda: got.extend(rig.imu.read(HOST())))
    first = list(rig.imu.read(HOST()))
    wait_until(lambda: len(got) >= 10)
    sent = [sample.angular_velocity for sample in rig.chip.sent]
    assert [sample.angular_velocity for sample in (*first, *got)] == sent[: len(first) + len(got)]
    assert [sample.stamp_ns for sample in (*first, *got)] == sorted({s.stamp_ns for s in (*first, *got)})


def test_a_node_reads_a_sensor_when_it_is_told_and_others_in_their_rhythm() -> None:
    class Silent:
        name, frame, poll_period = "a", "a", 0.005
        reads = 0

        def open(self) -> None: ...

        def health(self) -> DeviceHealth:
            return DeviceHealth(DeviceState.OPEN)

        def read(self, now_ns: int) -> Sequence[Any]:
            self.reads += 1
            return ()

    class Announcing(Silent):
        def announce(self, tell: Any) -> None:
            self.tell = tell

    for device, reads in ((Silent(), 21), (Announcing(), 1)):
        context = HandMadeContext()
        context.start(ImuNode(device, IMU))  # type: ignore[arg-type]
        context.run(0.1)
        assert device.reads == reads
        if isinstance(device, Announcing):
            device.tell()
            context.run(0.001)
            assert device.reads == 2
