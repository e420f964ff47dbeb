"""Sensors behind a local socket: whatever has a driver in another process or language needs to speak these frames only.

One `SensorStream` is one connection, shared by its devices; it translates the other side's clock by when frames were sent, so that how
long a sensor takes to measure does not count as an offset of its clock.
"""

from __future__ import annotations

import json
import select
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.devices import DeviceHealth
from ambler.core.errors import BadInputError, DeviceError
from ambler.drivers.device_clock import DeviceClock, DeviceStamps
from ambler.drivers.shared_link import WAKE_PERIOD, LinkBrokenError, SharedLink
from ambler.drivers.stream_frame import SECONDS, VERSION, StreamFrame, StreamKind, StreamReader, socket_of
from ambler.wire.ros_messages import decode_any

M = TypeVar("M", bound=m.Message)

QUEUE = 64
"""Messages of one device that wait for a node that is late; then the oldest are lost, and counted."""
_CHUNK = 1 << 18


class SensorStream(SharedLink):
    """A connection to a `StreamServer` at `unix:PATH` or `tcp:PORT`. `now_ns` is the host's clock, the executor's."""

    _expected = "a server of sensors"

    def __init__(self, address: str, now_ns: Callable[[], int]) -> None:
        super().__init__(address, now_ns)
        self.devices: tuple[str, ...] = ()
        """The names that the server offers, once it was opened."""
        self._receivers: dict[str, tuple[object, Callable[[StreamFrame, int], None]]] = {}

    def receive(self, device: str, user: object, receiver: Callable[[StreamFrame, int], None]) -> None:
        """From now on give the messages of a device to `receiver`, with the host's instant of their arrival, in this stream's thread.
        Raises DeviceError when another device receives them."""
        if device in self._receivers:
            raise DeviceError(f"{device} of {self.place} is received already")
        self._receivers[device] = (user, receiver)

    def send(self, kind: StreamKind, device: str, body: bytes = b"") -> None:
        """Send a frame if the connection takes it. Never waits, never raises."""
        self.transmit(lambda: StreamFrame(kind, device, sent_ns=self.now_ns(), body=body).encode())

    def _new_clock(self) -> DeviceClock:
        return DeviceClock()

    def _connect(self) -> None:
        self._reader = StreamReader()
        self._socket, place = socket_of(self.place)
        try:
            self._socket.connect(place)
        except OSError as error:
            self._socket.close()
            raise DeviceError(f"{self.place} cannot be reached: {error.strerror or error}") from error
        self._socket.setblocking(False)

    def _disconnect(self) -> None:
        self._socket.close()

    def _ask_who(self) -> None:
        """Nothing to ask: a server says hello by itself."""

    def _write(self, data: bytes) -> bool:
        try:
            return self._socket.send(data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            raise LinkBrokenError(error.strerror or str(error)) from error

    def _turn(self) -> bool:
        if not select.select((self._socket,), (), (), WAKE_PERIOD)[0]:
            return False
        try:
            data = self._socket.recv(_CHUNK)
        except OSError as error:
            raise LinkBrokenError(error.strerror or str(error)) from error
        if not data:
            raise LinkBrokenError("closed by the server")
        arrival_ns, is_any = self.now_ns(), False
        try:
            for frame in self._reader.feed(data):
                is_any = True
                self._take(frame, arrival_ns)
        except BadInputError as error:
            raise LinkBrokenError(str(error)) from error
        return is_any

    def _take(self, frame: StreamFrame, arrival_ns: int) -> None:
        self.clock.observe(frame.sent_ns, arrival_ns)
        if frame.kind == StreamKind.HELLO:
            self._greet(frame.body)
        elif frame.kind == StreamKind.MESSAGE:
            user, receiver = self._receivers.get(frame.device, (None, None))
            if receiver is not None and user in self._users:
                receiver(frame, arrival_ns)

    def _greet(self, body: bytes) -> None:
        try:
            hello = json.loads(body)
            version, devices = hello["version"], tuple(map(str, hello["devices"]))
        except (ValueError, KeyError, TypeError) as error:
            raise BadInputError("its greeting is none") from error
        if version != VERSION:
            raise BadInputError(f"it speaks version {version} of the frame, not {VERSION}")
        self.devices = devices
        self._answered.set()


class StreamDevice(Generic[M]):
    """What all devices of a stream share: `name` is the device's at the server, `frame` that of its mount here."""

    types: tuple[type[m.Message], ...] = ()

    def __init__(self, stream: SensorStream, name: str, frame: str, poll_period: float = 0.005) -> None:
        self.name, self.frame, self.poll_period = name, frame, poll_period
        self._stream = stream
        self._queue: deque[M] = deque(maxlen=QUEUE)
        self._tell: Callable[[], None] | None = None
        self._is_told = False
        self._begin()
        stream.receive(name, self, self._on_frame)

    def _begin(self) -> None:
        self._queue.clear()
        self._stamps = DeviceStamps(self._stream.clock)
        self._messages = self._lost = 0
        self._sequence: int | None = None

    def open(self) -> None:
        """Connect unless another device of the stream has done so; raises DeviceError when the server has no such device."""
        if self._stream.is_open(self):
            return
        self._begin()
        self._stream.open(self)
        if self.name not in self._stream.devices:
            self._stream.close(self)
            offered = ", ".join(self._stream.devices)
            raise DeviceError(f"{self._stream.place} has no {self.name}, only {offered}")

    def health(self) -> DeviceHealth:
        return self._stream.health(self, self._messages, self._lost)

    def close(self) -> None:
        self._stream.close(self)
        self._queue.clear()

    def read(self, now_ns: int) -> Sequence[M]:
        """Return what has come since the last call, oldest first; nothing when the connection is broken."""
        self._is_told = False  # before it looks: what comes from now on is told again
        if not self._stream.is_open(self):
            return ()
        return [self._queue.popleft() for _ in range(len(self._queue))]

    def _on_frame(self, frame: StreamFrame, arrival_ns: int) -> None:
        """Called in the stream's thread. Raises BadInputError for bytes that are not what this device sends."""
        decoded = decode_any(frame.ros_type, frame.body)
        if not isinstance(decoded, self.types):
            raise BadInputError(f"{self.name} sends {frame.ros_type}, which a {type(self).__name__} does not")
        message: Any = decoded
        if self._sequence is not None:
            self._lost += (frame.sequence - self._sequence - 1) & 0xFFFFFFFF
        self._sequence = frame.sequence
        if self._stamps.clock is not self._stream.clock:
            self._stamps = DeviceStamps(self._stream.clock)
        stamp_ns = self._stamps.to_host(message.stamp_ns, arrival_ns)
        self._messages += 1
        self._lost += len(self._queue) == QUEUE
        self._queue.append(replace(message, stamp_ns=stamp_ns, frame=self.frame))
        if self._tell is not None and not self._is_told:
            self._is_told = True
            self._tell()


class StreamSensor(StreamDevice[M]):
    """A device that says when it has measured."""

    def announce(self, tell: Callable[[], None]) -> None:
        """Call `tell` in the stream's thread for what comes first after a `read`."""
        self._tell = tell


class StreamLidar(StreamSensor[m.LaserScan | m.PointCloud]):
    """A `Lidar` of a stream."""

    types = (m.LaserScan, m.PointCloud)


class StreamImu(StreamSensor[m.Imu]):
    """An `Imu` of a stream."""

    types = (m.Imu,)


class StreamRangeSensor(StreamSensor[m.Range]):
    """A `RangeSensor` of a stream."""

    types = (m.Range,)


class StreamBattery(StreamDevice[m.BatteryState]):
    """A `Battery` of a stream."""

    types = (m.BatteryState,)

    def stop_charging(self) -> None:
        if self._stream.is_open(self):
            self._stream.send(StreamKind.STOP_CHARGING, self.name)


class StreamCamera(StreamDevice[m.Image]):
    """A `Camera` of a stream; `model` as it was calibrated."""

    types = (m.Image,)

    def __init__(
        self, stream: SensorStream, name: str, frame: str, model: CameraModel, poll_period: float = 0.005
    ) -> None:
        super().__init__(stream, name, frame, poll_period)
        self.model = model

    def request(self, until_ns: int) -> None:
        """Ask for pictures until that instant; the server's clock is another, so it is told how long that is from now."""
        seconds = (until_ns - self._stream.now_ns()) * 1e-9
        if seconds > 0 and self._stream.is_open(self):
            self._stream.send(StreamKind.PICTURES, self.name, SECONDS.pack(seconds))
