"""The live view for Foxglove and Lichtblick: what the bus delivers goes to viewers, a pose clicked there comes back as a goal or as the robot's place.

The bridge is a tap of the executor. It never blocks the run: messages wait in one slot per topic, a thread of its own encodes
what somebody subscribed to, at most as often as `view_rates` allows by the wall clock. The SDK's server listens on a private
loopback port; viewers meet `FoxgloveFront`.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from typing import Any

import foxglove
from foxglove.websocket import Capability, ClientChannel, StatusLevel

from ambler.bridges.client_orders import order_from_client
from ambler.bridges.client_poses import ESTIMATE_SCHEMA, POSE_SCHEMA, pose_from_client
from ambler.bridges.foxglove_front import FoxgloveFront
from ambler.bridges.foxglove_listener import ViewerListener
from ambler.bridges.view_memory import ViewMemory, is_kept
from ambler.bridges.view_rates import EVENTS, Counts, Outbox, Stamped
from ambler.core.errors import BadInputError
from ambler.core.messages import Message
from ambler.runtime import topics as table
from ambler.runtime.names import NameProfile, named
from ambler.runtime.topics import Topic
from ambler.wire.ros_messages import encode, ros_type_of
from ambler.wire.ros_viewers import viewer_bytes, viewer_definition

ClientCallback = Callable[[Topic[Any], Message], None]

_TICK = 1.0 / 30.0
_BACKLOG_FRAMES = 32
# Poses that viewers may publish, and their type; the 3-D panels of both families use these names for a clicked goal and for where the robot is.
CLIENT_POSES: Mapping[str, tuple[Topic[Any], str]] = {
    table.GOAL.ros_name: (table.GOAL, POSE_SCHEMA),
    "/move_base_simple/goal": (table.GOAL, POSE_SCHEMA),
    "/initialpose": (table.SET_POSE, ESTIMATE_SCHEMA),
}
# What viewers may not publish: on a bad line nobody can let go of a stick.
VELOCITIES = (table.TELEOP_REQUEST, table.STEER_REQUEST)
# What else they may order.
CLIENT_ORDERS: Mapping[str, Topic[Any]] = {
    t.ros_name: t for t in table.order_topics() if t not in (table.GOAL, table.SET_POSE, *VELOCITIES)
}
CLIENT_TOPICS = (*CLIENT_POSES, *CLIENT_ORDERS)


class FoxgloveBridge:
    """Serves viewers on `host:port` until `close`; port 0 takes a free one, which `port` then names.

    `on_client_message(topic, message)` is called on a thread of the bridge; it must only hand the message over.
    `names` says under which ROS names topics are shown (`runtime.names`); `rates_hz` overrides the wall-clock limits by ROS name (`math.inf`: every message that can be sent).
    A run makes it before anything else, so that a port that cannot be had leaves nothing behind, and says later where what viewers
    publish goes (`on_client_message`, with the same prefix as the tap that shows a robot).
    Raises BadInputError when the port is in use or none.
    """

    def __init__(
        self,
        port: int = 8765,
        host: str = "127.0.0.1",
        token: str | None = None,
        on_client_message: ClientCallback | None = None,
        *,
        name: str = "ambler",
        topics: Iterable[Topic[Any]] | None = None,
        rates_hz: Mapping[str, float] | None = None,
        names: NameProfile = "own",
    ) -> None:
        if not 0 <= port <= 65535:
            raise BadInputError(f"--port {port}: a port is a number from 0 (any free one) to 65535")
        shown = tuple(named(t, names) for t in (table.all_topics() if topics is None else topics) if not t.is_bulk)
        limits = rates_hz or {}
        self._outboxes = {topic.name: Outbox(topic, limits.get(topic.ros_name)) for topic in shown}
        self._memory = ViewMemory()
        self._resend: deque[str] = deque()
        self._newest_ns = self._broadcast_ns = 0
        self._reports: deque[str] = deque(maxlen=_BACKLOG_FRAMES)
        self.on_client_message = on_client_message
        self._context = context = foxglove.Context()  # the SDK keeps no reference to it
        foxglove.set_log_level(logging.ERROR)
        self._server = foxglove.start_server(
            name=name,
            host="127.0.0.1",
            port=0,
            capabilities=[Capability.ClientPublish, Capability.Time],
            server_listener=ViewerListener(self._on_subscribed, self._on_client_data),
            supported_encodings=["cdr", "json"],
            context=context,
            message_backlog_size=_BACKLOG_FRAMES,
        )
        self._channels = {topic.name: _open_channel(topic, context) for topic in shown}
        events = [topic.ros_name for topic in shown if issubclass(topic.type, EVENTS)]
        self._front = FoxgloveFront(host, port, self._server.port, token, events)
        self._loop = asyncio.new_event_loop()
        self._is_closing = threading.Event()
        ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._run, args=(ready,), name="live-view", daemon=True)
        self._thread.start()
        try:
            ready.result()
        except BaseException:
            self._thread.join()
            self._server.stop()
            raise

    @property
    def port(self) -> int:
        """The port on which viewers connect."""
        return self._front.port

    @property
    def dropped_frames(self) -> int:
        """Frames that newer ones replaced on the way to slow clients that have left."""
        return self._front.dropped_frames

    def counts(self) -> dict[str, Counts]:
        """Return sent and skipped messages by ROS name."""
        return {box.topic.ros_name: box.counts for box in self._outboxes.values()}

    def on_message(self, topic: Topic[Any], message: Message, time_ns: int, writer: str = "") -> None:
        """Show a message; returns at once."""
        self._newest_ns = time_ns
        box = self._outboxes.get(topic.name)
        if box is None:
            return
        self._memory.keep(topic, message, time_ns, writer)
        if self._channels[topic.name].has_sinks():
            box.put(message, time_ns)

    def close(self) -> None:
        """Disconnect all viewers and free the port; calling it again does nothing."""
        if self._is_closing.is_set():
            return
        self._is_closing.set()
        self._thread.join()
        self._server.stop()
        for channel in self._channels.values():
            channel.close()

    def _run(self, ready: Future[None]) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve(ready))
        except Exception as error:
            if ready.done():
                raise
            ready.set_exception(error)  # whoever makes the bridge must not wait for ever
        finally:
            self._loop.close()

    async def _serve(self, ready: Future[None]) -> None:
        try:
            await self._front.start()
        except BadInputError as error:
            ready.set_exception(error)
            return
        ready.set_result(None)
        while not self._is_closing.is_set():
            self._send_due()
            await asyncio.sleep(_TICK)
        await self._front.stop()

    def _send_due(self) -> None:
        now = time.monotonic()
        while self._resend:
            name = self._resend.popleft()
            self._send(name, self._memory.newest(name))
        for name in self._memory.due(now):
            if name in self._channels and self._channels[name].has_sinks():
                self._send(name, self._memory.newest(name))
        for name, box in self._outboxes.items():
            self._send(name, box.take(now))
        while self._reports:
            self._server.publish_status(self._reports.popleft(), StatusLevel.Warning)
        newest_ns = self._newest_ns
        if newest_ns != self._broadcast_ns and newest_ns >= 0:
            self._server.broadcast_time(newest_ns)
            self._broadcast_ns = newest_ns

    def _send(self, name: str, messages: list[Stamped]) -> None:
        for message, time_ns in messages:
            data = viewer_bytes(ros_type_of(type(message)), encode(message))
            self._channels[name].log(data, log_time=time_ns)

    def _on_subscribed(self, ros_name: str) -> None:
        self._broadcast_ns = -1  # a new viewer does not know the time
        for name, box in self._outboxes.items():
            if box.topic.ros_name == ros_name and is_kept(box.topic):
                self._resend.append(name)

    def _on_client_data(self, channel: ClientChannel, data: bytes) -> None:
        pose, order, take = CLIENT_POSES.get(channel.topic), CLIENT_ORDERS.get(channel.topic), self.on_client_message
        sent = (channel.encoding, channel.schema_name, data, self._newest_ns)
        try:
            if take is not None and pose is not None:
                take(pose[0], pose_from_client(*sent, pose[1]))
            elif take is not None and order is not None:
                take(order, order_from_client(order.type, *sent))
        except BadInputError as error:
            self._reports.append(f"{channel.topic} refused: {error}")


def _open_channel(topic: Topic[Any], context: foxglove.Context) -> foxglove.Channel:
    ros_type = ros_type_of(topic.type)
    schema = foxglove.Schema(name=ros_type, encoding="ros2msg", data=viewer_definition(ros_type).encode())
    return foxglove.Channel(topic.ros_name, message_encoding="cdr", schema=schema, context=context)
