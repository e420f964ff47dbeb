"""Records everything that the bus delivers, ground truth included: a tap of the executor, not a node."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ambler.core.messages import Message
from ambler.runtime.topics import Topic
from ambler.wire.mcap_file import McapRecorder


class Recorder:
    """Writes each delivered message once, under its ROS name, at its time of delivery."""

    def __init__(self, folder: Path) -> None:
        self._mcap = McapRecorder(folder)

    @property
    def folder(self) -> Path:
        """The folder of the recording."""
        return self._mcap.folder

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""
        return self._mcap.message_count

    def on_message(self, topic: Topic[Any], message: Message, time_ns: int, writer: str = "") -> None:
        """Write one message; `time_ns` is the executor's time of delivery, `writer` the node that published it."""
        is_latched = topic.delivery == "latched"
        self._mcap.write(topic.ros_name, message, time_ns, is_latched=is_latched, writer=writer)

    def close(self) -> None:
        """Finish the recording."""
        self._mcap.close()
