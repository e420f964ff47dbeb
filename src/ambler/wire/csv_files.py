"""Recordings as CSV: one row per message of a topic, one column per number in it, named by its path (`pose.translation.0`)."""

from __future__ import annotations

import csv
import dataclasses
import enum
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ambler.core.errors import BadInputError
from ambler.core.messages import Message
from ambler.wire.mcap_reader import read_recording
from ambler.wire.ros_messages import decode

F64 = NDArray[np.float64]

LOG_TIME = "log_time_ns"
MOST_COLUMNS = 2000


def recording_to_csv(recording: Path, topic: str, message_class: type[Message], path: Path) -> int:
    """Write every message of `topic` (its ROS name) in a recording as a row; returns the number of rows.

    The first column is the time of delivery. All messages must have as many numbers as the first: clouds and scans of changing size
    do not fit a table. Raises BadInputError for those, for more than 2000 columns, and for a recording without the topic.
    """
    names: list[str] = []
    rows = 0
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        for recorded in read_recording(recording, [topic]):
            cells = dict(_cells("", decode(message_class, recorded.data)))
            if not names:
                names = list(cells)
                if len(names) > MOST_COLUMNS:
                    raise BadInputError(f"{topic}: {len(names)} numbers per message do not fit a table")
                writer.writerow([LOG_TIME, *names])
            if list(cells) != names:
                raise BadInputError(f"{topic}: the messages have different numbers of values and do not fit a table")
            writer.writerow([recorded.log_time_ns, *cells.values()])
            rows += 1
    if rows == 0:
        raise BadInputError(f"{recording} has no message on {topic}")
    return rows


def read_columns(path: Path) -> dict[str, F64]:
    """Read the numeric columns of a CSV file with a header, float64 (N,) each; stamps (`..._ns`) stay exact below 2^53 ns (104 days)."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    if len(rows) < 2:
        raise BadInputError(f"{path} has no rows")
    columns: dict[str, F64] = {}
    for name, *values in zip(*rows, strict=True):
        try:
            columns[name] = np.array(values, np.float64)
        except ValueError:
            continue  # words, not numbers
    return columns


def _cells(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of everything in a message that is a number or a word."""
    prefix = f"{name}." if name else ""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _cells(prefix + field.name, getattr(value, field.name))
    elif isinstance(value, enum.Enum):
        yield name, value.value
    elif isinstance(value, np.ndarray):
        for index, item in enumerate(value.ravel().tolist()):
            yield f"{prefix}{index}", item
    elif isinstance(value, (tuple, list)):
        for index, item in enumerate(value):
            yield from _cells(f"{prefix}{index}", item)
    else:
        yield name, value
