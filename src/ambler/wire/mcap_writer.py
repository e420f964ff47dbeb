"""A small MCAP writer for the recorder's hot path: one `struct` per message, zstd chunks with CRC, all indexes.

Rare records (schemas, channels, chunks, the summary) are serialized by the `mcap` package; its own writer spends five times
as long on a message. Other people's readers check the files in the tests.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any, BinaryIO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Header,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_FIELDS = 22
_ZSTD_LEVEL = 1


class McapWriter:
    """Writes one file to an open binary stream; `finish` must be called, the stream stays open."""

    def __init__(self, stream: BinaryIO, profile: str, library: str, chunk_bytes: int = 1 << 20) -> None:
        self._stream = stream
        self._chunk_bytes = chunk_bytes
        self._compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        self._schemas: list[Any] = []
        self._channels: list[Any] = []
        self._counts: list[int] = []
        self._chunks: list[Any] = []
        self._offset = 0
        self._write(MAGIC)
        self._write(_serialized(Header(profile=profile, library=library)))
        self._begin_chunk()

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a schema and return its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._append(_serialized(schema))
        return len(self._schemas)

    def add_channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str]) -> int:
        """Declare a channel and return its id."""
        number = len(self._channels) + 1
        channel = Channel(id=number, topic=topic, message_encoding=encoding, schema_id=schema, metadata=metadata)
        self._channels.append(channel)
        self._counts.append(0)
        self._append(_serialized(channel))
        return number

    def add_message(self, channel: int, log_time_ns: int, data: bytes, publish_time_ns: int) -> None:
        """Write a message; a full chunk is closed."""
        sequence = self._counts[channel - 1]
        self._index.setdefault(channel, []).append((log_time_ns, self._size))
        head = (
            Opcode.MESSAGE,
            _MESSAGE_FIELDS + len(data),
            channel,
            sequence & 0xFFFFFFFF,
            log_time_ns,
            publish_time_ns,
        )
        self._parts.append(_MESSAGE.pack(*head))
        self._append(data)
        self._size += _MESSAGE.size
        self._counts[channel - 1] = sequence + 1
        if self._size >= self._chunk_bytes:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Write the chunk in progress and hand it to the operating system."""
        if self._index:
            plain = b"".join(self._parts)
            times = [time for entries in self._index.values() for time, _ in entries]
            packed = self._compressor.compress(plain)
            chunk = Chunk(
                compression="zstd",
                data=packed,
                message_start_time=min(times),
                message_end_time=max(times),
                uncompressed_crc=zlib.crc32(plain),
                uncompressed_size=len(plain),
            )
            self._write_chunk(chunk)
            self._begin_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the last chunk, the summary and the end of the file."""
        self.close_chunk()
        self._write(_serialized(DataEnd(data_section_crc=0)))
        summary_start = self._offset
        groups = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
        )
        summary, offsets = bytearray(), bytearray()
        for opcode, records in groups:
            group = b"".join(_serialized(record) for record in records)
            start = summary_start + len(summary)
            offsets += _serialized(SummaryOffset(group_opcode=opcode, group_start=start, group_length=len(group)))
            summary += group
        offset_start = summary_start + len(summary)
        summary += offsets
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start)
        self._write(bytes(summary) + footer + struct.pack("<I", zlib.crc32(bytes(summary) + footer)) + MAGIC)
        self._stream.flush()

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        self._index: dict[int, list[tuple[int, int]]] = {}

    def _append(self, record: bytes) -> None:
        self._parts.append(record)
        self._size += len(record)

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._offset += len(data)

    def _write_chunk(self, chunk: Any) -> None:
        start = self._offset
        self._write(_serialized(chunk))
        chunk_length = self._offset - start
        offsets: dict[int, int] = {}
        for channel, entries in self._index.items():
            offsets[channel] = self._offset
            self._write(_serialized(MessageIndex(channel_id=channel, records=entries)))
        self._chunks.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=start,
                chunk_length=chunk_length,
                message_index_offsets=offsets,
                message_index_length=self._offset - start - chunk_length,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def _statistics(self) -> Any:
        return Statistics(
            message_count=sum(self._counts),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=0,
            metadata_count=0,
            chunk_count=len(self._chunks),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            channel_message_counts={k + 1: count for k, count in enumerate(self._counts)},
        )


def _serialized(record: Any) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
