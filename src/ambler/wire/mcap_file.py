"""Recordings: a rosbag2 folder of MCAP files (`recording_0.mcap`, ...) and `metadata.yaml`, playable by `ros2 bag play`.

Each file has the profile `ros2`, schemas `ros2msg`, messages `cdr`, zstd chunks with CRC and indexes, written by the `mcap`
package. After every second of log time the chunk in progress is ended and handed to the operating system, so a crash costs at most that
second. The writer remembers every chunk until the end, so there should be few. Nothing depends on the wall clock: the same messages give the same bytes. A topic with several writers
(`/tf`) has one channel for each, with the writer's name in the channel's metadata.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mcap.writer import Writer

from ambler.core.errors import BadInputError
from ambler.core.messages import Message
from ambler.wire.ros_messages import encode, message_definition, ros_type_of
from ambler.wire.rosbag_metadata import FileSummary, TopicSummary, qos_text, write_metadata

_LIBRARY = "ambler"
CHUNK_BYTES = 1 << 20


@dataclass(slots=True)
class _Topic:
    """A channel of the recording and how many messages it got."""

    name: str
    ros_type: str
    is_latched: bool
    count: int = 0


class _File:
    """One MCAP file; schemas and channels are registered at their first message."""

    def __init__(self, path: Path) -> None:
        self.name = path.name
        self.start_ns = self.end_ns = self.count = 0
        self.bytes_written = 0
        self._flushed_ns = 0
        self._stream = path.open("xb")
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES)
        self._writer.start("ros2", _LIBRARY)
        self._stream.flush()
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._sequences: dict[int, int] = {}

    def add(self, topic: _Topic, data: bytes, log_time_ns: int, publish_time_ns: int, writer: str) -> None:
        channel = self._channels.get((topic.name, writer))
        if channel is None:
            channel = self._register(topic, writer)
        self._writer.add_message(channel, log_time_ns, data, publish_time_ns, self._sequences[channel])
        self._sequences[channel] = (self._sequences[channel] + 1) & 0xFFFFFFFF
        if self.count == 0:
            self.start_ns = self.end_ns = self._flushed_ns = log_time_ns
        self.start_ns = min(self.start_ns, log_time_ns)
        self.end_ns = max(self.end_ns, log_time_ns)
        self.count += 1
        self.bytes_written += len(data)

    def flush_if_older(self, log_time_ns: int, period_ns: int) -> None:
        if log_time_ns - self._flushed_ns >= period_ns:
            self._writer.flush()  # type: ignore[no-untyped-call]
            self._flushed_ns = log_time_ns

    def close(self) -> FileSummary:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()
        return FileSummary(self.name, self.start_ns, self.end_ns, self.count)

    def _register(self, topic: _Topic, writer: str) -> int:
        schema = self._schemas.get(topic.ros_type)
        if schema is None:
            text = message_definition(topic.ros_type).encode()
            schema = self._schemas[topic.ros_type] = self._writer.register_schema(topic.ros_type, "ros2msg", text)
        metadata = {"offered_qos_profiles": qos_text(topic.is_latched)}
        if writer:
            metadata["writer"] = writer
        channel = self._writer.register_channel(topic.name, "cdr", schema, metadata)
        self._channels[topic.name, writer] = channel
        self._sequences[channel] = 0
        return channel


class McapRecorder:
    """Writes messages into a new recording folder. `log_time` is the time of delivery on the bus.

    A new file begins when `file_bytes` of messages (uncompressed) are in the current one.
    Raises BadInputError when the folder already holds a recording.
    """

    def __init__(self, folder: Path, *, flush_period: float = 1.0, file_bytes: int = 2 << 30) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.glob("*.mcap")):
            raise BadInputError(f"{folder} already holds a recording; name another folder")
        self._flush_period_ns = int(flush_period * 1e9)
        self._file_bytes = file_bytes
        self._topics: dict[str, _Topic] = {}
        self._finished: list[FileSummary] = []
        self._file: _File | None = self._next_file()

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""
        return sum(topic.count for topic in self._topics.values())

    def write(
        self,
        topic: str,
        message: Message,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        *,
        is_latched: bool = False,
        writer: str = "",
    ) -> None:
        """Encode and write one message under its ROS name; `writer` is the node that published it."""
        raw, ros_type = encode(message), ros_type_of(type(message))
        self.write_bytes(topic, ros_type, raw, log_time_ns, publish_time_ns, is_latched=is_latched, writer=writer)

    def write_bytes(
        self,
        topic: str,
        ros_type: str,
        data: bytes,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        *,
        is_latched: bool = False,
        writer: str = "",
    ) -> None:
        """Write one message that is CDR already. A topic keeps the type of its first message (BadInputError otherwise)."""
        if self._file is None:
            raise BadInputError(f"the recording {self.folder} is closed")
        if self._file.bytes_written >= self._file_bytes:
            self._finished.append(self._file.close())
            self._file = self._next_file()
        entry = self._topics.get(topic)
        if entry is None:
            entry = self._topics[topic] = _Topic(topic, ros_type, is_latched)
        elif entry.ros_type != ros_type:
            raise BadInputError(f"{topic} is recorded as {entry.ros_type}, not {ros_type}")
        self._file.flush_if_older(log_time_ns, self._flush_period_ns)
        publish_time = log_time_ns if publish_time_ns is None else publish_time_ns
        self._file.add(entry, data, log_time_ns, publish_time, writer)
        entry.count += 1

    def close(self) -> None:
        """Finish the file and write `metadata.yaml`; calling it again does nothing."""
        if self._file is None:
            return
        self._finished.append(self._file.close())
        self._file = None
        topics = [TopicSummary(t.name, t.ros_type, t.is_latched, t.count) for t in self._topics.values()]
        write_metadata(self.folder, self._finished, topics)

    def _next_file(self) -> _File:
        return _File(self.folder / f"recording_{len(self._finished)}.mcap")
