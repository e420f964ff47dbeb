"""ROS 1 bags and SQLite bags that a crash, a full disk or a broken download cut off: what lies before the cut, as a whole bag.

A ROS 1 bag is written in chunks, and its index at the end when it is closed: without it no reader opens it, though every message before the cut
is there. Of a SQLite file that has lost its last pages the rows of the others can be read. MCAP files: `wire.mcap_reader`.
"""

from __future__ import annotations

import io
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from rosbags.interfaces import Connection
from rosbags.rosbag1 import ReaderError, Writer
from rosbags.rosbag1.reader import Header, RecordType, decompressors, read_bytes, read_uint32
from rosbags.rosbag1.writer import WriterError
from rosbags.typesys.msg import normalize_msgtype

_Read = TypeVar("_Read")
_BAG_MAGIC = b"#ROSBAG V2.0\n"
_SQLITE_MAGIC = b"SQLite format 3\x00"
_DAMAGE = (
    ReaderError,
    WriterError,
    struct.error,
    ValueError,
    LookupError,
    OSError,
    EOFError,
    RuntimeError,
    AssertionError,
    MemoryError,
)


def is_whole_bag(file: Path) -> bool:
    """Say whether a ROS 1 bag has its index, and all of it, at its end."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        try:
            stream.seek(len(_BAG_MAGIC))
            header = Header.read(stream, RecordType.BAGHEADER)
            at = header.get_uint64("index_pos")
            count = header.get_uint32("conn_count") + header.get_uint32("chunk_count")
            if at == 0 or at > size:
                return False
            stream.seek(at)
            for _ in range(count):
                Header.read(stream)
                read_bytes(stream, read_uint32(stream))
        except _DAMAGE:
            return False
    return True


def index_copy(file: Path, copy: Path) -> int:
    """Copy every whole message before the cut of a ROS 1 bag into a new, finished one; returns the number of messages."""
    count = 0
    with Writer(copy) as writer:
        known: dict[int, Connection] = {}
        for header, data in _up_to(_DAMAGE, _records_of_chunks(file)):
            if header.get_uint8("op") == RecordType.CONNECTION:
                number, topic = header.get_uint32("conn"), header.get_string("topic")
                if number not in known:
                    known[number] = _add_connection(writer, topic, data)
            elif header.get_uint8("op") == RecordType.MSGDATA:
                writer.write(known[header.get_uint32("conn")], header.get_time("time"), data)
                count += 1
    return count


def _up_to(damage: tuple[type[Exception], ...], read: Iterator[_Read]) -> Iterator[_Read]:
    """Yield what is read before the first damage. What goes wrong in writing a copy, a full disk, is none, and is raised."""
    while True:
        try:
            item = next(read)
        except StopIteration:
            return
        except damage:
            return
        yield item


def _add_connection(writer: Writer, topic: str, data: bytes) -> Connection:
    """Add what a connection record tells. The caller is kept: it tells two publishers of one topic apart."""
    told = Header.read(io.BytesIO(struct.pack("<L", len(data)) + data))
    return writer.add_connection(
        topic,
        normalize_msgtype(told.get_string("type")),
        msgdef=told.get_string("message_definition"),
        md5sum=told.get_string("md5sum"),
        callerid=told.get_string("callerid") if "callerid" in told else None,
    )


def _records_of_chunks(file: Path) -> Iterator[tuple[Header, bytes]]:
    """Yield the records within the chunks of a bag, of the last one those before the cut; ends with whatever error the cut is."""
    with file.open("rb") as stream:
        stream.seek(len(_BAG_MAGIC))
        while True:
            header = Header.read(stream)
            if header.get_uint8("op") != RecordType.CHUNK:
                stream.seek(read_uint32(stream), io.SEEK_CUR)
                continue
            packed = stream.read(read_uint32(stream))
            chunk = decompressors[header.get_string("compression")](packed)
            yield from _records(io.BytesIO(chunk), len(chunk))


def _records(stream: BinaryIO, size: int) -> Iterator[tuple[Header, bytes]]:
    while stream.tell() < size:
        header = Header.read(stream)
        yield header, read_bytes(stream, read_uint32(stream))


def is_whole_database(file: Path) -> bool:
    """Say whether a SQLite file has all the pages that its header tells of (one written by a version before 3.7.0 tells nothing, and counts as whole)."""
    with file.open("rb") as stream:
        head = stream.read(100)
    if len(head) < 100 or not head.startswith(_SQLITE_MAGIC):
        return False
    page, changes, pages, counted = (*struct.unpack(">H", head[16:18]), *struct.unpack(">II", head[24:32]), head[92:96])
    is_told = struct.unpack(">I", counted)[0] == changes
    return not is_told or file.stat().st_size >= (65536 if page == 1 else page) * pages


def rescue_rows(file: Path, copy: Path) -> int:
    """Copy the rows that can be read of a SQLite bag into a new one of the same tables, in their order; returns the number of messages."""
    count = 0
    old = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    new = sqlite3.connect(copy)
    try:
        opens_short = "PRAGMA writable_schema=ON"  # SQLite then opens a file that is shorter than its header says
        list(_up_to((sqlite3.Error,), _rows(old, opens_short)))
        choose = "SELECT name, sql FROM sqlite_master WHERE type = 'table' AND sql IS NOT NULL"
        tables = list(_up_to((sqlite3.Error,), _rows(old, choose)))
        for name, sql in sorted(tables, key=lambda row: row[0] == "messages"):
            if name.startswith("sqlite_"):
                continue
            new.execute(sql)
            for row in _up_to((sqlite3.Error,), _rows(old, f'SELECT * FROM "{name}" NOT INDEXED')):
                try:
                    new.execute(f'INSERT INTO "{name}" VALUES ({", ".join("?" * len(row))})', row)
                except sqlite3.IntegrityError:
                    break  # a row that is none, out of a page that is not there
                count += name == "messages"
        new.commit()
    finally:
        old.close()
        new.close()
    return count


def _rows(database: sqlite3.Connection, query: str) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of a query; whatever is wrong with it shows while they are taken."""
    yield from database.execute(query)
