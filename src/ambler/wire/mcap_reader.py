"""Reads recordings in log order: folders of rosbag2 with MCAP files, single MCAP files, finished or cut off by a crash."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Header, McapRecord, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import Writer

from ambler.core.errors import BadInputError
from ambler.core.messages import Message
from ambler.wire.mcap_file import McapRecorder
from ambler.wire.ros_messages import decode, decode_any
from ambler.wire.rosbag_metadata import METADATA_FILE, is_latched_text

M = TypeVar("M", bound=Message)

_MAGIC = b"\x89MCAP0\r\n"
# Everything that a cut or garbled record can raise in the MCAP library.
_DAMAGE = (
    McapError,
    CRCValidationError,
    struct.error,
    zstandard.ZstdError,
    ValueError,
    KeyError,
    OverflowError,
    RuntimeError,
    MemoryError,
    OSError,
)


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message of a recording as CDR bytes; times are nanoseconds in the clock of the executor that recorded it.

    `writer` is the node that published it, empty in recordings of others.
    """

    topic: str
    ros_type: str
    log_time_ns: int
    publish_time_ns: int
    data: bytes
    is_latched: bool = False
    writer: str = ""

    def decode(self) -> Message:
        """Read the bytes by their ROS type (grids as occupancy); raises BadInputError."""
        return decode_any(self.ros_type, self.data)

    def decode_as(self, message_class: type[M]) -> M:
        """Read the bytes as a message of the class; raises BadInputError."""
        return decode(message_class, self.data)


def recording_files(path: Path) -> list[Path]:
    """Return the MCAP files of a recording in order; raises BadInputError when there is none."""
    if path.is_file():
        return [path]
    metadata = path / METADATA_FILE
    if metadata.is_file():
        try:
            information = yaml.safe_load(metadata.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
            files = [path / str(name) for name in information["relative_file_paths"]]
        except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError) as error:
            raise BadInputError(f"{metadata} is no metadata of rosbag2: {error}") from error
    else:
        files = sorted(path.glob("*.mcap"), key=lambda f: (len(f.name), f.name))
    missing = [f.name for f in files if not f.is_file()]
    if not files or missing:
        raise BadInputError(f"{path} holds no recording" + (f": {missing[0]} is missing" if missing else ""))
    return files


def is_finished(file: Path) -> bool:
    """Say whether an MCAP file has its end; a file without it was cut off by a crash."""
    with file.open("rb") as stream:
        if stream.seek(0, 2) < 2 * len(_MAGIC):
            return False
        stream.seek(-len(_MAGIC), 2)
        return stream.read() == _MAGIC


def cut_off(path: Path) -> tuple[str, ...]:
    """Say in one sentence each which MCAP files of a recording were cut off by a crash: only what lies before the cut is read."""
    files = [path] if path.is_file() else sorted(path.glob("*.mcap"))
    return tuple(f"{file} is cut off: read up to the cut" for file in files if _is_mcap(file) and not is_finished(file))


def read_recording(path: Path, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
    """Yield the messages in log order; messages of one instant keep the order in which they were written.

    Of a file that was cut off, everything before the cut is given. Raises BadInputError for a path without a recording,
    a file that is not MCAP, or damage inside a finished file.
    """
    for file in recording_files(path):
        if is_finished(file):
            yield from _read_finished(file, topics)
        else:
            yield from sorted(_salvage(file, topics), key=lambda recorded: recorded.log_time_ns)


def recorded_topics(path: Path) -> dict[str, str]:
    """Return the ROS type of every topic of a recording by its name; of a file that was cut off it reads all. Raises BadInputError."""
    topics: dict[str, str] = {}
    for file in recording_files(path):
        if not is_finished(file):
            topics |= {recorded.topic: recorded.ros_type for recorded in _salvage(file, None)}
            continue
        with file.open("rb") as stream:
            try:
                summary = make_reader(stream).get_summary()
            except _DAMAGE as error:
                raise BadInputError(f"{file} is damaged: {error or type(error).__name__}") from error
        if summary is not None:
            topics |= {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values() if c.schema_id}
    return topics


def recover_recording(path: Path, folder: Path) -> int:
    """Copy what can be read of a cut-off recording into a new, finished one; returns the number of messages."""
    recorder = McapRecorder(folder)
    for r in read_recording(path):
        recorder.write_bytes(
            r.topic, r.ros_type, r.data, r.log_time_ns, r.publish_time_ns, is_latched=r.is_latched, writer=r.writer
        )
    recorder.close()
    return recorder.message_count


def finish_copy(file: Path, copy: Path) -> int:
    """Copy what can be read of a cut-off MCAP file, of whatever types, into a finished one; returns the number of messages."""
    count = 0
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    records = _records(file)
    header = next(records, None)
    if not isinstance(header, Header):
        return 0
    with copy.open("wb") as stream:
        writer = Writer(stream)
        writer.start(header.profile, header.library)
        for record in records:
            if isinstance(record, Schema):
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:
                known = schemas.get(record.schema_id, 0)
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, known, record.metadata
                )
            elif isinstance(record, McapMessage):
                at = channels[record.channel_id]
                writer.add_message(at, record.log_time, record.data, record.publish_time, record.sequence)
                count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return count


def _is_mcap(file: Path) -> bool:
    with file.open("rb") as stream:
        return stream.read(len(_MAGIC)) == _MAGIC


def _read_finished(file: Path, topics: Collection[str] | None) -> Iterator[RecordedMessage]:
    latched: dict[int, bool] = {}
    with file.open("rb") as stream:
        try:
            for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages(topics):
                yield _recorded(schema, channel, message, latched)
        except _DAMAGE as error:
            raise BadInputError(f"{file} is damaged: {error or type(error).__name__}") from error


def _salvage(file: Path, topics: Collection[str] | None) -> Iterator[RecordedMessage]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    latched: dict[int, bool] = {}
    for record in _records(file):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, McapMessage):
            channel = channels[record.channel_id]
            if topics is None or channel.topic in topics:
                yield _recorded(schemas.get(channel.schema_id), channel, record, latched)


def _records(file: Path) -> Iterator[McapRecord]:
    """Yield the records of an MCAP file up to its end or the first damage; messages only after their channels."""
    known: set[int] = set()
    if not _is_mcap(file):
        raise BadInputError(f"{file} is no MCAP file")
    with file.open("rb") as stream:
        stream.seek(len(_MAGIC))
        records = StreamReader(stream, skip_magic=True, validate_crcs=True).records
        while True:
            try:
                record = next(records, None)
            except _DAMAGE:
                return
            if record is None or (isinstance(record, McapMessage) and record.channel_id not in known):
                return
            if isinstance(record, Channel):
                known.add(record.id)
            yield record


def _recorded(schema: Any, channel: Any, message: Any, latched: dict[int, bool]) -> RecordedMessage:
    if channel.id not in latched:
        latched[channel.id] = is_latched_text(channel.metadata.get("offered_qos_profiles", ""))
    ros_type = "" if schema is None else schema.name
    return RecordedMessage(
        channel.topic,
        ros_type,
        message.log_time,
        message.publish_time,
        message.data,
        latched[channel.id],
        channel.metadata.get("writer", ""),
    )
