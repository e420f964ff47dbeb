"""The door of the live view: a WebSocket proxy in front of the Foxglove SDK, which has no authentication and no manners.

It checks the token, adds ROS_DISTRO to the server's introduction (without it the 3-D panel hides its publish tool), and keeps
for each subscription of a slow client only the newest frame, so that a bad line shows the present and never a growing past. Where
the robot is and whether it may drive goes before maps.
Protocol: subprotocol foxglove.sdk.v1; JSON text both ways; binary opcode 1 is message data (u8, u32 subscription, u64 time,
payload), opcode 2 the server's time.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hmac
import http
import json
import logging
import math
import os
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Collection
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets
from websockets.asyncio.client import ClientConnection, connect
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from ambler.bridges.large_frames import LARGE_BYTES, LargeFrameFactory
from ambler.core.errors import BadInputError
from ambler.wire.ros_viewers import DISTRIBUTION

SUBPROTOCOL = Subprotocol("foxglove.sdk.v1")
MESSAGE_DATA, TIME = 1, 2
_SEND_BUFFER_BYTES = 1 << 17
_CLIENT_FRAME_BYTES = 1 << 20
_EVENT_FRAMES = 100
_UNSENT_BYTES = 1 << 14  # what the system may hold back for a slow client: what is there can no longer be overtaken

_logger = logging.getLogger("ambler.live_view")
_logger.addHandler(logging.NullHandler())
_logger.propagate = False

Frame = str | bytes


def check_port(host: str, port: int) -> None:
    """Raise BadInputError when nobody could listen there now, so that it is told before anything else is done."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        raise _cannot_listen(host, port, error) from error


def _cannot_listen(host: str, port: int, error: OSError) -> BadInputError:
    number = error.errno
    reason = os.strerror(number).lower() if number is not None and number in errno.errorcode else str(error)
    return BadInputError(f"the live view cannot listen on {host}:{port}: {reason}; take another --port, or --no-view")


class FrameQueue:
    """Frames on their way to one client: control text in order, data as one slot per subscription (events: a short queue).

    Small frames go first. While a large one had the line nothing else could pass, so small ones then have it for as long; after that a
    large one goes whether small ones wait or not. `clock` tells monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.dropped = 0
        self._clock = clock
        self._control: deque[Frame] = deque()
        self._slots: dict[int, deque[Frame]] = {}
        self._depths: dict[int, int] = {}
        self._large_time = -math.inf
        self._is_small_next = True
        self._ready = asyncio.Event()

    def set_depth(self, subscription: int, depth: int) -> None:
        """Keep up to `depth` frames of a subscription; the default is 1."""
        self._depths[subscription] = depth

    def put_control(self, frame: Frame) -> None:
        """Add a frame that must not be lost."""
        self._control.append(frame)
        self._ready.set()

    def put_data(self, subscription: int, frame: Frame) -> None:
        """Add a frame of a subscription; the oldest one gives way when its slot is full."""
        slot = self._slots.setdefault(subscription, deque())
        if len(slot) >= self._depths.get(subscription, 1):
            slot.popleft()
            self.dropped += 1
        slot.append(frame)
        self._ready.set()

    def note_sent(self, frame: Frame, seconds: float) -> None:
        """Take in for how long a frame had the line."""
        self._is_small_next = len(frame) > LARGE_BYTES
        if self._is_small_next:
            self._large_time = self._clock() + seconds

    async def take(self) -> Frame:
        """Return the next frame: control first, then small and large ones, the subscriptions of each kind in turn."""
        while True:
            self._ready.clear()
            if self._control:
                return self._control.popleft()
            small, large = self._first(is_large=False), self._first(is_large=True)
            patience = None if large is None else self._large_time - self._clock()
            if patience is not None and patience <= 0.0 and not (self._is_small_next and small is not None):
                small = large
            if small is not None:
                return self._pop(small)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._ready.wait(), patience)

    def _first(self, *, is_large: bool) -> int | None:
        """Return the subscription whose turn it is among those with a frame of one kind."""
        return next((s for s, slot in self._slots.items() if (len(slot[0]) > LARGE_BYTES) == is_large), None)

    def _pop(self, subscription: int) -> Frame:
        slot = self._slots.pop(subscription)
        frame = slot.popleft()
        if slot:
            self._slots[subscription] = slot
        return frame


class FoxgloveFront:
    """Listens on `host:port` and connects every accepted client with the SDK's server on the loopback port `upstream_port`."""

    def __init__(
        self,
        host: str,
        port: int,
        upstream_port: int,
        token: str | None = None,
        event_topics: Collection[str] = (),
        ros_distro: str = DISTRIBUTION,
    ) -> None:
        self.host, self.port = host, port
        self.dropped_frames = 0
        self._upstream = f"ws://127.0.0.1:{upstream_port}"
        self._token = token
        self._event_topics = frozenset(event_topics)
        self._ros_distro = ros_distro
        self._server: Server | None = None

    async def start(self) -> None:
        """Open the port (0 takes a free one); raises BadInputError when it is in use or the address is not ours."""
        try:
            self._server = await serve(
                self._serve_client,
                self.host,
                self.port,
                subprotocols=[SUBPROTOCOL],
                process_request=self._authorize,
                compression=None,
                extensions=[LargeFrameFactory()],
                max_size=_CLIENT_FRAME_BYTES,
                write_limit=(0, 0),  # a frame counts as sent when the system has it
                logger=_logger,
            )
        except OSError as error:
            raise _cannot_listen(self.host, self.port, error) from error
        self.port = next(iter(self._server.sockets)).getsockname()[1]

    async def stop(self) -> None:
        """Close the port and all connections."""
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def _authorize(self, connection: ServerConnection, request: Request) -> Response | None:
        if self._token is None:
            return None
        query = parse_qs(urlsplit(request.path).query)
        bearer = request.headers.get("Authorization", "").removeprefix("Bearer ")
        offered = query.get("token", [bearer])[0]
        if hmac.compare_digest(offered.encode(), self._token.encode()):
            return None
        return connection.respond(http.HTTPStatus.UNAUTHORIZED, "wrong or missing token\n")

    async def _serve_client(self, client: ServerConnection) -> None:
        _keep_buffers_short(client.transport.get_extra_info("socket"))
        queue, channels = FrameQueue(), dict[int, str]()
        async with connect(
            self._upstream, subprotocols=[SUBPROTOCOL], compression=None, max_size=None, logger=_logger
        ) as upstream:
            tasks = [
                asyncio.create_task(self._read_upstream(upstream, queue, channels)),
                asyncio.create_task(self._read_client(client, upstream, queue, channels)),
                asyncio.create_task(_write_client(client, queue)),
            ]
            try:
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
                self.dropped_frames += queue.dropped

    async def _read_upstream(self, upstream: ClientConnection, queue: FrameQueue, channels: dict[int, str]) -> None:
        async for frame in upstream:
            if isinstance(frame, str):
                queue.put_control(self._introduced(frame, channels))
            elif frame[0] == MESSAGE_DATA:
                queue.put_data(struct.unpack_from("<I", frame, 1)[0], frame)
            elif frame[0] == TIME:
                queue.put_data(-1, frame)
            else:
                queue.put_control(frame)

    def _introduced(self, text: str, channels: dict[int, str]) -> str:
        """Complete the server's introduction and note which channel carries which topic."""
        operation = json.loads(text)
        if operation.get("op") == "serverInfo":
            operation.setdefault("metadata", {})["ROS_DISTRO"] = self._ros_distro
            return json.dumps(operation)
        if operation.get("op") == "advertise":
            channels.update({channel["id"]: channel["topic"] for channel in operation["channels"]})
        return text

    async def _read_client(
        self, client: ServerConnection, upstream: ClientConnection, queue: FrameQueue, channels: dict[int, str]
    ) -> None:
        async for frame in client:
            if isinstance(frame, str):
                with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError):  # the SDK answers nonsense
                    self._note_subscriptions(json.loads(frame), queue, channels)
            await upstream.send(frame)

    def _note_subscriptions(self, operation: Any, queue: FrameQueue, channels: dict[int, str]) -> None:
        if operation["op"] == "subscribe":
            for subscription in operation["subscriptions"]:
                is_event = channels.get(subscription["channelId"]) in self._event_topics
                queue.set_depth(subscription["id"], _EVENT_FRAMES if is_event else 1)


def _keep_buffers_short(line: socket.socket) -> None:
    line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT_BYTES)


async def _write_client(client: ServerConnection, queue: FrameQueue) -> None:
    with contextlib.suppress(websockets.ConnectionClosed):
        while True:
            frame = await queue.take()
            begin = time.monotonic()
            await client.send(frame)
            queue.note_sent(frame, time.monotonic() - begin)
