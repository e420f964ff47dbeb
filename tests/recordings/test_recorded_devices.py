"""A run with devices, recorded, and the same nodes on recorded devices: every message at the same nanosecond, every bit equal."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambler.bridges.recorder import Recorder
from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.devices import DeviceState
from ambler.core.errors import DeviceError
from ambler.core.protocols import BodyVelocity
from ambler.recordings import message_source
from ambler.recordings.devices import RecordedBase, RecordedBattery, RecordedCamera, RecordedImu, RecordedLidar
from ambler.recordings.message_source import MessageSource
from ambler.runtime import topics
from ambler.runtime.lockstep import LockstepExecutor
from ambler.runtime.node import Node
from ambler.runtime.stack import Stack
from ambler.runtime.topics import Topic
from ambler.wire.mcap_file import McapRecorder
from ambler.wire.mcap_reader import RecordedMessage, read_recording
from ambler.wire.ros_messages import encode

MS = 1_000_000


class Delayed:
    """A sensor whose messages arrive with delays of a fixed chance, several at once or none."""

    def __init__(self, seed: int, make: Any, rate: float, period: float) -> None:
        rng = np.random.default_rng(seed)
        stamps = (np.arange(int(3 * rate)) * 1e9 / rate).astype(np.int64)
        arrivals = np.maximum.accumulate(stamps + rng.integers(0, 120 * MS, len(stamps)))
        self._coming = [(int(a), make(int(s))) for a, s in zip(arrivals, stamps, strict=True)]
        self.poll_period = period

    def read(self, now_ns: int) -> Sequence[m.Message]:
        out = [message for arrival, message in self._coming if arrival <= now_ns]
        self._coming = self._coming[len(out) :]
        return out


class DeviceNode(Node):
    """Publishes what a device gives."""

    def __init__(self, name: str, device: Any, topic: Topic[Any], latency: float = 1e-6) -> None:
        self.name, self.latency, self.outputs = name, latency, (topic,)
        self._device, self._topic = device, topic

    def start(self) -> None:
        self.ctx.timer(self._device.poll_period, self._poll)

    def _poll(self) -> None:
        for message in self._device.read(self.ctx.now_ns):
            self.ctx.publish(self._topic, message)


def odometry(stamp_ns: int) -> m.Odometry:
    rng = np.random.default_rng(stamp_ns)
    v = rng.normal(size=10)
    q = v[3:7] / np.linalg.norm(v[3:7])
    pose = m.SE3(tuple(map(float, v[:3])), tuple(map(float, q)))
    return m.Odometry(
        stamp_ns, "odom", "base", pose, (v[7], v[8], v[9]), (0.1, 0.2, 1 / 3), rng.normal(size=(6, 6)), np.eye(6)
    )


def scan(frame: str) -> Any:
    def make(stamp_ns: int) -> m.LaserScan:
        ranges = np.random.default_rng(stamp_ns).uniform(0.1, 30.0, 90).astype(np.float32)
        return m.LaserScan(stamp_ns, frame, -1.0, 0.02, 1e-5, 0.05, 0.1, 30.0, ranges, np.empty(0, np.float32))

    return make


def run(folder: Path, devices: Sequence[tuple[str, Any, Topic[Any], float]]) -> list[RecordedMessage]:
    recorder = Recorder(folder)
    with LockstepExecutor(Stack([DeviceNode(n, d, t, latency) for n, d, t, latency in devices])) as executor:
        executor.tap(recorder.on_message)
        executor.run(3.0)
    recorder.close()
    return list(read_recording(folder))


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[RecordedMessage]]:
    folder = tmp_path_factory.mktemp("original")
    devices = [
        ("base", Delayed(1, odometry, 50.0, 0.01), topics.WHEEL_ODOMETRY, 1e-6),
        ("front", Delayed(2, scan("front"), 20.0, 0.005), topics.SCANNERS, 0.003),
        ("rear", Delayed(3, scan("rear"), 20.0, 0.02), topics.SCANNERS, 1e-6),
    ]
    return folder, run(folder, devices)


def test_a_replay_is_bit_equal_and_on_time(original: tuple[Path, list[RecordedMessage]], tmp_path: Path) -> None:
    folder, messages = original
    source = MessageSource(folder)
    base = RecordedBase(source, "/wheel_odom", poll_period=0.01)
    front = RecordedLidar(source, "/scanners", poll_period=0.005, writer="front", latency=0.003)
    rear = RecordedLidar(source, "/scanners", poll_period=0.02, frame="rear")
    for device in (base, front, rear):
        device.open()
    again = run(
        tmp_path / "again",
        [
            ("base", base, topics.WHEEL_ODOMETRY, 1e-6),
            ("front", front, topics.SCANNERS, 0.003),
            ("rear", rear, topics.SCANNERS, 1e-6),
        ],
    )
    assert len(messages) > 250
    assert again == messages
    assert front.health().messages == sum(r.writer == "front" for r in messages)


def test_a_message_comes_neither_early_nor_late_by_a_nanosecond(tmp_path: Path) -> None:
    recorder = McapRecorder(tmp_path / "r")
    message = m.Imu(0, "imu", (0.0, 0.0, 1.0), (0.0, 0.0, 9.8))
    recorder.write("/imu", message, 10_001_000)
    recorder.close()
    device = RecordedImu(MessageSource(tmp_path / "r"), "/imu", poll_period=0.01)
    device.open()
    assert list(device.read(9_999_999)) == []
    assert encode(device.read(10_000_000)[0]) == encode(message)
    assert list(device.read(20_000_000)) == []
    assert device.health().text == "the recording has ended"
    assert device.health().state is DeviceState.OPEN


def test_only_what_is_due_is_read_from_the_file(
    original: tuple[Path, list[RecordedMessage]], monkeypatch: pytest.MonkeyPatch
) -> None:
    walked = []
    monkeypatch.setattr(
        message_source, "read_recording", lambda *a: (walked.append(r) or r for r in read_recording(*a))
    )
    folder, messages = original
    source = MessageSource(folder)
    base = RecordedBase(source, "/wheel_odom", poll_period=0.01)
    front = RecordedLidar(source, "/scanners", poll_period=0.005, writer="front")
    base.open()
    front.open()
    assert walked == []
    half = 1_500 * MS
    base.read(half)
    due = [r for r in messages if r.log_time_ns <= half + 1000]
    assert len(walked) == len(due) + 1
    assert len(front._subscription.queue) == sum(r.writer == "front" for r in due)
    front.read(half)
    assert len(front._subscription.queue) == 0


def test_a_base_keeps_what_it_is_told(original: tuple[Path, list[RecordedMessage]]) -> None:
    base = RecordedBase(MessageSource(original[0]), "/wheel_odom", poll_period=0.01)
    base.open()
    base.command(BodyVelocity(0.1, 0.2, 0.3))
    base.command(BodyVelocity())
    assert base.commands == [BodyVelocity(0.1, 0.2, 0.3), BodyVelocity()]
    assert base.watchdog <= 0.5


def test_opening_names_what_is_wrong(original: tuple[Path, list[RecordedMessage]], tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="holds no recording"):
        MessageSource(tmp_path)
    source = MessageSource(original[0])
    with pytest.raises(DeviceError, match=r"holds no /battery_state, only /scanners, /wheel_odom"):
        RecordedBattery(source, "/battery_state", poll_period=0.1).open()
    model = CameraModel("camera", 4, 3, 1.0, 1.0, 1.5, 1.0)
    with pytest.raises(DeviceError, match="LaserScan, which a RecordedCamera does not send"):
        RecordedCamera(source, "/scanners", model, poll_period=0.01).open()
    base = RecordedBase(source, "/wheel_odom", poll_period=0.01)
    base.open()
    base.read(0)
    with pytest.raises(DeviceError, match="before the first read"):
        RecordedLidar(source, "/scanners", poll_period=0.01)


def test_a_cut_off_recording_is_replayed_up_to_the_cut(
    original: tuple[Path, list[RecordedMessage]], tmp_path: Path
) -> None:
    data = (original[0] / "recording_0.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 2 // 3])
    base = RecordedBase(MessageSource(cut), "/wheel_odom", poll_period=0.01)
    base.open()
    got = base.read(4_000 * MS)
    whole = [r for r in original[1] if r.topic == "/wheel_odom"]
    assert 20 < len(got) < len(whole)
    assert [encode(o) for o in got] == [r.data for r in whole[: len(got)]]


def test_damage_inside_a_recording_fails_the_device_by_name(
    original: tuple[Path, list[RecordedMessage]], tmp_path: Path
) -> None:
    data = bytearray((original[0] / "recording_0.mcap").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "bad.mcap").write_bytes(data)
    base = RecordedBase(MessageSource(tmp_path / "bad.mcap"), "/wheel_odom", poll_period=0.01)
    base.open()
    for now_ns in range(0, 4_000 * MS, 10 * MS):
        base.read(now_ns)
    assert base.health().state is DeviceState.FAILED
    assert "is damaged" in base.health().text
