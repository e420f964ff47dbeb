"""The sensors' end of a local socket: reads devices and sends what they measured to every client. It owns no thread: whoever runs it
calls `step`, which never waits; what a slow client does not fetch is dropped, the oldest first, and shows as a gap in its numbers."""

from __future__ import annotations

import json
import socket
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from ambler.core.devices import Battery, Camera
from ambler.core.errors import BadInputError, DeviceError
from ambler.core.messages import Message
from ambler.drivers.stream_frame import SECONDS, VERSION, StreamFrame, StreamKind, StreamReader, socket_of
from ambler.wire.ros_messages import encode, ros_type_of

PENDING_MAX = 4 << 20
"""Bytes that wait for a client."""
TIME_PERIOD_NS = 100_000_000
LONGEST_REQUEST = 3600.0
"""Seconds for which a client may ask for pictures at once."""
_CHUNK = 1 << 16


class ReadableDevice(Protocol):
    """What a server needs of any sensor."""

    @property
    def name(self) -> str: ...

    def read(self, now_ns: int) -> Sequence[Message]: ...


class _Client:
    """One connection: what waits to be sent, the first piece perhaps sent in part."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        self.connection = connection
        self.reader = StreamReader()
        self.dropped = 0
        self._pending: deque[memoryview] = deque()
        self._size = 0

    def put(self, data: bytes) -> None:
        while self._size + len(data) > PENDING_MAX and len(self._pending) > 1:
            self._size -= len(self._pending[1])
            del self._pending[1]
            self.dropped += 1
        self._pending.append(memoryview(data))
        self._size += len(data)

    def flush(self) -> None:
        """Send what the connection takes; raises OSError when it is broken."""
        while self._pending:
            try:
                count = self.connection.send(self._pending[0])
            except BlockingIOError:
                return
            self._size -= count
            self._pending[0] = self._pending[0][count:]
            if not self._pending[0]:
                self._pending.popleft()

    def received(self) -> list[StreamFrame]:
        """Return what it asks for; raises OSError when it is gone, BadInputError when it speaks something else."""
        try:
            data = self.connection.recv(_CHUNK)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionResetError("closed")
        return list(self.reader.feed(data))


class StreamServer:
    """Serves devices, told apart by their names, at an address (see `socket_of`; `tcp:0` chooses a port). `clock` maps
    instants to those of a clock that the devices are to have: stamps, too, are told in it. Raises DeviceError when the address is taken."""

    def __init__(
        self,
        address: str,
        sensors: Sequence[ReadableDevice] = (),
        cameras: Sequence[Camera] = (),
        batteries: Sequence[Battery] = (),
        clock: Callable[[int], int] | None = None,
    ) -> None:
        self._cameras = {camera.name: camera for camera in cameras}
        self._batteries = {battery.name: battery for battery in batteries}
        self._devices = {device.name: device for device in (*sensors, *cameras, *batteries)}
        self._clock = clock
        self._sequences = dict.fromkeys(self._devices, 0)
        self._socket, self._path = _listen(address)
        self.address = address if self._path is not None else f"tcp:{self._socket.getsockname()[1]}"
        self._clients: list[_Client] = []
        self._told_ns = 0

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._clients)

    @property
    def dropped(self) -> int:
        """Messages that clients now connected did not fetch in time."""
        return sum(client.dropped for client in self._clients)

    def step(self, now_ns: int) -> None:
        """Take clients and their requests, read the devices, send."""
        self._accept(now_ns)
        for client in tuple(self._clients):
            self._serve(client, now_ns)
        for device in self._devices.values():
            for message in device.read(now_ns):
                self._publish(device.name, message, now_ns)
        if now_ns - self._told_ns >= TIME_PERIOD_NS:
            self._told_ns = now_ns
            self._put(StreamFrame(StreamKind.TIME, sent_ns=self._device_ns(now_ns)))
        for client in tuple(self._clients):
            try:
                client.flush()
            except OSError:
                self._drop(client)

    def disconnect(self) -> None:
        """Throw every client out."""
        for client in tuple(self._clients):
            self._drop(client)

    def close(self) -> None:
        """Throw every client out and give the address back."""
        self.disconnect()
        self._socket.close()
        if self._path is not None:
            self._path.unlink(missing_ok=True)

    def _publish(self, name: str, message: Message, now_ns: int) -> None:
        self._sequences[name] = (self._sequences[name] + 1) & 0xFFFFFFFF
        if self._clients:
            told: Any = message
            if self._clock is not None:
                told = replace(told, stamp_ns=self._clock(told.stamp_ns))
            ros_type, sent_ns = ros_type_of(type(message)), self._device_ns(now_ns)
            self._put(StreamFrame(StreamKind.MESSAGE, name, ros_type, self._sequences[name], sent_ns, encode(told)))

    def _device_ns(self, now_ns: int) -> int:
        return now_ns if self._clock is None else self._clock(now_ns)

    def _put(self, frame: StreamFrame) -> None:
        data = frame.encode()
        for client in self._clients:
            client.put(data)

    def _accept(self, now_ns: int) -> None:
        try:
            client = _Client(self._socket.accept()[0])
        except BlockingIOError:
            return
        hello = json.dumps({"version": VERSION, "devices": sorted(self._devices)}).encode()
        client.put(StreamFrame(StreamKind.HELLO, sent_ns=self._device_ns(now_ns), body=hello).encode())
        self._clients.append(client)

    def _serve(self, client: _Client, now_ns: int) -> None:
        try:
            for frame in client.received():
                self._obey(frame, now_ns)
        except (OSError, BadInputError):
            self._drop(client)

    def _obey(self, frame: StreamFrame, now_ns: int) -> None:
        if frame.kind == StreamKind.PICTURES and frame.device in self._cameras and len(frame.body) == SECONDS.size:
            seconds = SECONDS.unpack(frame.body)[0]
            if 0.0 < seconds < LONGEST_REQUEST:
                self._cameras[frame.device].request(now_ns + round(seconds * 1e9))
        elif frame.kind == StreamKind.STOP_CHARGING and frame.device in self._batteries:
            self._batteries[frame.device].stop_charging()

    def _drop(self, client: _Client) -> None:
        client.connection.close()
        self._clients.remove(client)


def _listen(address: str) -> tuple[socket.socket, Path | None]:
    server, place = socket_of(address)
    try:
        server.bind(place)
    except OSError as error:
        server.close()
        raise DeviceError(f"{address} cannot be served: {error.strerror or error}") from error
    server.listen()
    server.setblocking(False)
    return server, Path(place) if isinstance(place, str) else None
