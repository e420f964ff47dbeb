"""Compares two recordings, or a recording with the outputs of a replay, topic by topic on the CDR bytes.

Equal means: the same number of messages on each topic, in the same order, with the same bytes and (unless told otherwise) at
the same times. The reference is kept as one 16-byte digest per message, so that long recordings fit into memory.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ambler.core.messages import Message
from ambler.runtime.bus import whole
from ambler.runtime.grid_thinning import GridThinning
from ambler.runtime.topics import TRANSFORMS, Topic
from ambler.wire.mcap_reader import RecordedMessage, read_recording
from ambler.wire.ros_messages import encode


@dataclass(frozen=True, slots=True)
class Difference:
    """The first difference on a topic: index of the message, its times (nanoseconds, None where it is absent), what differs."""

    topic: str
    index: int
    reference_time_ns: int | None
    other_time_ns: int | None
    kind: str

    def __str__(self) -> str:
        time_ns = self.reference_time_ns if self.reference_time_ns is not None else self.other_time_ns
        seconds = "?" if time_ns is None else f"{time_ns * 1e-9:.6f} s"
        return f"{self.topic} message {self.index} at {seconds}: {self.kind}"


@dataclass(frozen=True, slots=True)
class TopicComparison:
    """Counts of one topic: messages in the reference, in the other, and equal ones before the first difference."""

    topic: str
    reference_count: int
    other_count: int
    equal_count: int
    first_difference: Difference | None


@dataclass(frozen=True, slots=True)
class RecordingComparison:
    """Outcome per topic, in the order of their names, and the earliest difference of all."""

    topics: tuple[TopicComparison, ...]
    first_difference: Difference | None

    @property
    def is_equal(self) -> bool:
        return self.first_difference is None

    @property
    def equal_count(self) -> int:
        """Number of equal messages over all topics."""
        return sum(t.equal_count for t in self.topics)

    def __str__(self) -> str:
        if self.first_difference is None:
            return f"{self.equal_count} messages on {len(self.topics)} topics are equal"
        return f"first difference: {self.first_difference}"


@dataclass(slots=True)
class _Progress:
    """The reference's digests and times of one topic, and how far the other side has come."""

    digests: list[bytes] = field(default_factory=list)
    times_ns: list[int] = field(default_factory=list)
    other_count: int = 0
    equal_count: int = 0
    difference: Difference | None = None


class ReplayComparison:
    """Takes the messages of a replay one by one (as a tap of the executor) and compares them with a recording.

    `topics` are ROS names; None compares every topic of the recording, and reports topics that only the replay has.
    """

    def __init__(
        self, reference: Iterable[RecordedMessage], topics: Collection[str] | None = None, *, compare_times: bool = True
    ) -> None:
        self._wanted = None if topics is None else frozenset(topics)
        self._compare_times = compare_times
        self._topics: dict[str, _Progress] = {}
        self._tree: Message | None = None
        self._thinning = GridThinning()
        for recorded in reference:
            if self._is_wanted(recorded.topic):
                progress = self._topics.setdefault(recorded.topic, _Progress())
                progress.digests.append(_digest(recorded.data))
                progress.times_ns.append(recorded.log_time_ns)

    def on_message(self, topic: Topic[Any], message: Message, time_ns: int, writer: str = "") -> None:
        """Compare the next message of a topic of the bus, whoever wrote it; transforms merged and large grids left out, as the recorder does it."""
        if not self._thinning.takes(topic, message, time_ns, writer):
            return
        if topic == TRANSFORMS:
            message = self._tree = whole(self._tree, message)
        if self._is_wanted(topic.ros_name):
            self.add(topic.ros_name, encode(message), time_ns)

    def add(self, topic: str, data: bytes, time_ns: int) -> None:
        """Compare the next message of a topic, given as CDR bytes."""
        if not self._is_wanted(topic):
            return
        progress = self._topics.setdefault(topic, _Progress())
        index = progress.other_count
        progress.other_count += 1
        if progress.difference is not None:
            return
        if index >= len(progress.digests):
            progress.difference = Difference(topic, index, None, time_ns, "only in the other recording")
            return
        expected_ns = progress.times_ns[index]
        if progress.digests[index] != _digest(data):
            progress.difference = Difference(topic, index, expected_ns, time_ns, "bytes differ")
        elif self._compare_times and expected_ns != time_ns:
            kind = f"delivered {(time_ns - expected_ns) * 1e-9:+.9f} s off"
            progress.difference = Difference(topic, index, expected_ns, time_ns, kind)
        else:
            progress.equal_count += 1

    def close(self) -> None:
        """Nothing to release; taps have this method."""

    def result(self) -> RecordingComparison:
        """Return the outcome; messages that never came count as missing."""
        for grid in self._thinning.rest():
            self.add(grid.topic.ros_name, encode(grid.message), grid.time_ns)
        topics = tuple(self._outcome(name, self._topics[name]) for name in sorted(self._topics))
        differences = [t.first_difference for t in topics if t.first_difference is not None]
        return RecordingComparison(topics, min(differences, key=_time_of, default=None))

    def _is_wanted(self, topic: str) -> bool:
        return self._wanted is None or topic in self._wanted

    def _outcome(self, name: str, progress: _Progress) -> TopicComparison:
        difference, count = progress.difference, len(progress.digests)
        if difference is None and progress.other_count < count:
            index = progress.other_count
            difference = Difference(name, index, progress.times_ns[index], None, "only in the reference")
        return TopicComparison(name, count, progress.other_count, progress.equal_count, difference)


def compare_recordings(
    reference: Path, other: Path, topics: Collection[str] | None = None, *, compare_times: bool = True
) -> RecordingComparison:
    """Compare two recordings; raises BadInputError when one cannot be read."""
    comparison = ReplayComparison(read_recording(reference, topics), topics, compare_times=compare_times)
    for recorded in read_recording(other, topics):
        comparison.add(recorded.topic, recorded.data, recorded.log_time_ns)
    return comparison.result()


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=16).digest()


def _time_of(difference: Difference) -> tuple[int, str]:
    times = (difference.reference_time_ns, difference.other_time_ns)
    return min(t for t in times if t is not None), difference.topic
