"""Recorded devices: they give again what a recording of our own says that the devices of a run gave, at the same instants.

In that run a device's node read at an instant t of its timer and published; the bus delivered, and the recorder stamped, at t plus the
node's latency. So at t a recorded device returns the messages that were delivered until t + latency and not yet returned; with the
same node, period and latency, each is published at the very nanosecond at which it was. Without timers that meet (a live recording),
a message comes at the first reading after its delivery less the latency, which is when it came then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

from ambler.core import messages as m
from ambler.core.camera import CameraModel
from ambler.core.devices import WATCHDOG_MAX, DeviceHealth, DeviceState
from ambler.core.errors import DeviceError
from ambler.core.protocols import BodyVelocity
from ambler.recordings.message_source import MessageSource
from ambler.wire.ros_messages import ros_type_of

M = TypeVar("M", bound=m.Message)

NODE_LATENCY = 1e-6
"""The latency of device nodes, seconds."""


class RecordedDevice(Generic[M]):
    """What all recorded devices share: `topic` is the ROS name on which it was recorded and `writer` the node that published it, empty
    for any; with `frame`, only messages in that frame are its own (several sensors may share a topic). Give `latency` what the node's was, faults included. `poll_period` must be that of the device that was recorded."""

    types: tuple[type[m.Message], ...] = ()

    def __init__(
        self,
        source: MessageSource,
        topic: str,
        *,
        poll_period: float,
        name: str = "",
        frame: str = "",
        writer: str = "",
        latency: float = NODE_LATENCY,
    ) -> None:
        self.name = name or topic
        self.frame = frame
        self.poll_period = poll_period
        self.topic = topic
        self._source = source
        self._latency_ns = max(1000, round(latency * 1e9))
        self._subscription = source.subscribe(topic, writer, frame)
        self._state, self._failure = DeviceState.CLOSED, ""
        self._messages = 0

    def open(self) -> None:
        """Begin; raises DeviceError when the recording does not hold the topic or holds something else on it."""
        if self._state is DeviceState.OPEN:
            return
        kind = self._source.topics.get(self.topic)
        if kind is None:
            raise DeviceError(
                f"{self._source.path} holds no {self.topic}, only {', '.join(sorted(self._source.topics))}"
            )
        if kind not in (ros_type_of(t) for t in self.types):
            raise DeviceError(
                f"{self.topic} of {self._source.path} is a {kind}, which a {type(self).__name__} does not send"
            )
        self._state, self._failure, self._messages = DeviceState.OPEN, "", 0

    def health(self) -> DeviceHealth:
        text = self._failure
        if not text and self._state is DeviceState.OPEN and self._source.has_ended and not self._subscription.queue:
            text = "the recording has ended"
        return DeviceHealth(self._state, text, self._messages)

    def close(self) -> None:
        self._state, self._failure = DeviceState.CLOSED, ""

    def read(self, now_ns: int) -> Sequence[M]:
        """Return what was delivered until `now_ns` plus the latency, oldest first."""
        if self._state is not DeviceState.OPEN:
            return ()
        until_ns = now_ns + self._latency_ns
        self._source.advance(until_ns)
        queue, out = self._subscription.queue, []
        while queue and queue[0][0] <= until_ns:
            out.append(queue.popleft()[1])
        if self._source.failure and not queue and not out:
            self._state, self._failure = DeviceState.FAILED, self._source.failure
        self._messages += len(out)
        return out  # type: ignore[return-value]


class RecordedLidar(RecordedDevice[m.LaserScan | m.PointCloud]):
    """A recorded `Lidar`."""

    types = (m.LaserScan, m.PointCloud)


class RecordedImu(RecordedDevice[m.Imu]):
    """A recorded `Imu`."""

    types = (m.Imu,)


class RecordedRangeSensor(RecordedDevice[m.Range]):
    """A recorded `RangeSensor`."""

    types = (m.Range,)


class RecordedJoystick(RecordedDevice[m.JoystickState]):
    """A recorded `Joystick`."""

    types = (m.JoystickState,)


class RecordedBattery(RecordedDevice[m.BatteryState]):
    """A recorded `Battery`; that charging shall stop changes nothing any more and is counted."""

    types = (m.BatteryState,)
    stops = 0

    def stop_charging(self) -> None:
        self.stops += 1


class RecordedCamera(RecordedDevice[m.Image]):
    """A recorded `Camera`: it has the pictures that were wanted then."""

    types = (m.Image,)

    def __init__(
        self,
        source: MessageSource,
        topic: str,
        model: CameraModel,
        *,
        poll_period: float,
        name: str = "",
        frame: str = "",
        writer: str = "",
        latency: float = NODE_LATENCY,
    ) -> None:
        super().__init__(source, topic, poll_period=poll_period, name=name, frame=frame, writer=writer, latency=latency)
        self.model = model

    def request(self, until_ns: int) -> None:
        """Change nothing: what was not taken then cannot be taken now."""


class RecordedBase(RecordedDevice[m.Odometry]):
    """A recorded `Base`: it drives as it drove, whatever it is told; `commands` keeps what it was told, to be compared."""

    types = (m.Odometry,)
    watchdog = WATCHDOG_MAX

    def __init__(
        self,
        source: MessageSource,
        topic: str,
        *,
        poll_period: float,
        name: str = "",
        writer: str = "",
        latency: float = NODE_LATENCY,
    ) -> None:
        super().__init__(source, topic, poll_period=poll_period, name=name, writer=writer, latency=latency)
        self.commands: list[BodyVelocity] = []

    def command(self, velocity: BodyVelocity) -> None:
        """Keep the command."""
        self.commands.append(velocity)
