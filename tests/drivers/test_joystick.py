"""A joystick from a recorded stream of events through a pipe, and from a kernel that a test plays."""

import os
import struct
import tty
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ambler.core.devices import DeviceState
from ambler.core.errors import DeviceError
from ambler.drivers import joystick
from ambler.drivers.joystick import EVENT, AxisRange, EvdevJoystick, JoystickLayout

RECORDED = Path(__file__).parent / "gamepad.events"
"""A stick pushed forward and released, turned left, two buttons pressed: 24-byte records of `struct input_event`."""
X, Y, A, B = 0, 1, 304, 305
LAYOUT = JoystickLayout({X: AxisRange(-32768, 32767, 500), Y: AxisRange(-32768, 32767, 500)}, (A, B))
MS = 1_000_000


def event(milliseconds: float, kind: int, code: int, value: int) -> bytes:
    return EVENT.pack(*divmod(round(milliseconds * 1000), 1_000_000), kind, code, value)


def report(milliseconds: float, *events: tuple[int, int, int]) -> bytes:
    return b"".join(event(milliseconds, *e) for e in (*events, (0, 0, 0)))


class Pipe:
    """A named pipe with the joystick at its end."""

    def __init__(self, folder: Path) -> None:
        path = folder / "event0"
        os.mkfifo(path)
        self._end = os.open(path, os.O_RDWR)
        self.joystick = EvdevJoystick(path, LAYOUT)
        self.joystick.open()

    def send(self, data: bytes) -> None:
        os.write(self._end, data)

    def unplug(self) -> None:
        os.close(self._end)
        self._end = -1

    def close(self) -> None:
        self.joystick.close()
        if self._end >= 0:
            self.unplug()


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[Pipe]:
    pipe = Pipe(tmp_path)
    yield pipe
    pipe.close()


def test_a_recorded_stream_is_told_report_by_report(pipe: Pipe) -> None:
    pipe.send(RECORDED.read_bytes())
    states = pipe.joystick.read(5_000 * MS)
    axes = np.array([s.axes for s in states])
    assert len(states) == 8
    np.testing.assert_allclose(axes[:, 1], [0.5, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(axes[:, 0], [0.0, 0.0, 0.75, 0.75, 0.75, 0.75, 0.0, 0.0], atol=1e-4)
    assert [tuple(s.buttons) for s in states] == [(0, 0)] * 3 + [(1, 0), (1, 1), (1, 1), (0, 1), (0, 0)]
    # Reports were 20 ms apart by the device's clock; the newest cannot be later than now.
    assert np.diff([s.stamp_ns for s in states]).tolist() == [20 * MS] * 7
    assert states[-1].stamp_ns == 5_000 * MS


@pytest.mark.parametrize("size", [1, 7, 24, 25])
def test_records_cut_anywhere_are_put_together(pipe: Pipe, size: int) -> None:
    data, states = RECORDED.read_bytes(), []
    for i in range(0, len(data), size):
        pipe.send(data[i : i + size])
        states += pipe.joystick.read(1_000 * MS + i)
    assert states[-1].axes.tolist() == [0.0, 0.0]
    assert max(s.axes[1] for s in states) == 1.0


def test_a_state_is_repeated_ten_times_a_second(pipe: Pipe) -> None:
    pipe.send(report(0, (3, Y, -32768)))
    stamps = [s.stamp_ns for t in range(0, 2000, 20) for s in pipe.joystick.read(10_000 * MS + t * MS)]
    assert 20 <= len(stamps) <= 26
    assert max(np.diff(stamps)) <= 100 * MS
    assert min(np.diff(stamps)) > 0


def test_a_joystick_that_is_gone_says_nothing_more_not_even_its_last_words(pipe: Pipe) -> None:
    pipe.send(report(0, (3, Y, -32768)))
    assert pipe.joystick.read(0)[-1].axes[1] == 1.0
    pipe.send(report(10, (3, Y, -20000)))
    pipe.unplug()
    assert list(pipe.joystick.read(20 * MS)) == []
    health = pipe.joystick.health()
    assert (health.state, health.text) == (DeviceState.FAILED, f"{pipe.joystick._path} is gone: it ended")
    assert list(pipe.joystick.read(40 * MS)) == []


def test_a_joystick_that_comes_back_starts_at_rest(pipe: Pipe) -> None:
    pipe.send(report(0, (3, Y, -32768), (1, A, 1)))
    pipe.joystick.read(0)
    pipe.unplug()
    pipe.joystick.read(20 * MS)
    pipe._end = os.open(pipe.joystick._path, os.O_RDWR)
    pipe.joystick.open()
    state = pipe.joystick.read(40 * MS)[0]
    assert (state.axes.tolist(), state.buttons.tolist()) == ([0.0, 0.0], [0, 0])


def test_after_lost_events_nothing_stale_is_left(pipe: Pipe) -> None:
    pipe.send(report(0, (3, Y, -32768), (1, A, 1)))
    assert pipe.joystick.read(0)[-1].axes[1] == 1.0
    pipe.send(event(10, 0, 3, 0) + report(10, (3, Y, -30000)) + report(20, (3, X, 32767)))
    states = pipe.joystick.read(20 * MS)
    assert [s.axes.tolist() for s in states] == [[0.0, 0.0], [0.0 - 1.0, 0.0]]
    assert states[0].buttons.tolist() == [0, 0]
    assert pipe.joystick.health().lost == 1


def test_axes_have_ends_a_middle_and_a_dead_zone() -> None:
    pad = AxisRange(0, 255, 15)
    assert [pad.normalized(v) for v in (0, 255, 300, 128, 140)] == [1.0, -1.0, -1.0, 0.0, 0.0]
    assert AxisRange(-1, 1).normalized(-1) == 1.0
    assert AxisRange(0, 0).normalized(5) == 0.0


def test_what_is_no_joystick_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="No such file"):
        EvdevJoystick(tmp_path / "event9", LAYOUT).open()
    for path in (Path("/dev/null"), RECORDED):
        with pytest.raises(DeviceError, match="no input device"):
            EvdevJoystick(path).open()


class Kernel:
    """Answers the ioctl calls of evdev as the kernel does for a pad with two axes, a hat and two buttons (and one key)."""

    def __init__(self) -> None:
        self.values = {0: (10, 0, 255, 0, 15, 0), 1: (128, 0, 255, 0, 15, 0), 17: (0, -1, 1, 0, 0, 0)}
        self.down = {A}
        self.clock = None

    def ioctl(self, fd: int, request: int, data: bytes) -> bytes:
        if request == 0x400445A0:
            self.clock = struct.unpack("<i", data)[0]
            return data
        if request == 0x80084523:
            return _mask(self.values, 8)
        if request == 0x80604521:
            return _mask((30, A, B), 96)
        if request == 0x80604518:
            return _mask(self.down, 96)
        assert request & ~0x3F == 0x80184540, hex(request)
        return struct.pack("<6i", *self.values[request & 0x3F])


def _mask(numbers: object, size: int) -> bytes:
    return sum(1 << n for n in numbers).to_bytes(size, "little")


def test_the_kernel_tells_layout_and_state(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel()
    monkeypatch.setattr(joystick.fcntl, "ioctl", kernel.ioctl)
    master, slave = os.openpty()
    tty.setraw(slave)
    device = EvdevJoystick(Path(os.ttyname(slave)))
    device.open()
    assert device.layout == JoystickLayout(
        {0: AxisRange(0, 255, 15), 1: AxisRange(0, 255, 15), 17: AxisRange(-1, 1)}, (A, B)
    )
    assert kernel.clock == 1
    first = device.read(0)[0]
    np.testing.assert_allclose(first.axes, [117.5 / 127.5, 0.0, 0.0], atol=1e-6)
    assert first.buttons.tolist() == [1, 0]
    kernel.values[17], kernel.down = (-1, -1, 1, 0, 0, 0), {B}
    os.write(master, event(0, 0, 3, 0) + report(0))
    state = device.read(20 * MS)[0]
    assert state.axes[2] == 1.0
    assert state.buttons.tolist() == [0, 1]
    os.close(master)
    assert list(device.read(40 * MS)) == []
    assert device.health().state is DeviceState.FAILED
    device.close()
    os.close(slave)
