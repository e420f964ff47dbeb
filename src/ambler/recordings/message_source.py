"""One walk through a recording for all devices that replay it: each message is decoded once and waits only in the queues of those who
asked for its topic, until they read it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from pathlib import Path

from ambler.core.errors import BadInputError, DeviceError
from ambler.core.messages import Message
from ambler.wire.mcap_reader import RecordedMessage, read_recording, recorded_topics


class Subscription:
    """The messages of one topic, all or those of one writer and one frame, that were walked past and not yet read: (delivery time,
    message)."""

    def __init__(self, topic: str, writer: str, frame: str) -> None:
        self.topic, self.writer, self.frame = topic, writer, frame
        self.queue: deque[tuple[int, Message]] = deque()


class MessageSource:
    """A recording that several devices read in step. Nothing is read before the first device asks, and then only up to the instant that
    it asks for. Raises DeviceError when there is no recording."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.topics = recorded_topics(path)
        except (BadInputError, OSError) as error:
            raise DeviceError(f"{path} cannot be replayed: {error}") from error
        self._subscriptions: list[Subscription] = []
        self._walk: Iterator[RecordedMessage] | None = None
        self._next: RecordedMessage | None = None
        self._lock = threading.Lock()
        self.failure = ""
        """One sentence when the recording is damaged; empty while all is well."""

    @property
    def has_ended(self) -> bool:
        """Say whether every message has been walked past."""
        return self._walk is not None and self._next is None

    def subscribe(self, topic: str, writer: str = "", frame: str = "") -> Subscription:
        """Ask for a topic by its ROS name, from one writer and in one frame or (empty) all. Raises DeviceError when the walk has begun."""
        if self._walk is not None:
            raise DeviceError(f"{self.path} is being replayed already: ask for {topic} before the first read")
        subscription = Subscription(topic, writer, frame)
        self._subscriptions.append(subscription)
        return subscription

    def advance(self, until_ns: int) -> None:
        """Walk past every message that was delivered until an instant."""
        with self._lock:
            if self._walk is None:
                self._walk = read_recording(self.path, {s.topic for s in self._subscriptions})
                self._step()
            while self._next is not None and self._next.log_time_ns <= until_ns:
                self._hand_out(self._next)
                self._step()

    def _hand_out(self, recorded: RecordedMessage) -> None:
        takers = [s for s in self._subscriptions if s.topic == recorded.topic and s.writer in ("", recorded.writer)]
        if not takers:
            return
        try:
            message = recorded.decode()
        except BadInputError as error:
            self.failure = f"{self.path} is damaged: {error}"
            return
        for subscription in takers:
            if subscription.frame in ("", getattr(message, "frame", "")):
                subscription.queue.append((recorded.log_time_ns, message))

    def _step(self) -> None:
        assert self._walk is not None
        try:
            self._next = None if self.failure else next(self._walk, None)
        except BadInputError as error:
            self.failure, self._next = str(error), None
