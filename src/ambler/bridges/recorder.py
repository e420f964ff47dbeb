"""Records everything that the bus of one stack delivers but bulk, and of large grids some (`GridThinning`), ground truth included: a tap of the executor, not a node.

Messages are encoded and written on a thread of the recorder's own, in the order in which they came. In lockstep a full queue makes
the run wait and nothing is lost; live (`is_lossy`) what does not fit is left out and counted. A recorder that fails stops recording,
says so once, and never touches the run. Messages of /tf hold the newest of every edge so far, as in the live view: a viewer that jumps
to an instant restores one message of a topic, and must find the robot on the map in it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ambler.core.messages import Message
from ambler.runtime.bus import whole
from ambler.runtime.conveyor import Conveyor
from ambler.runtime.grid_thinning import GridThinning
from ambler.runtime.topics import TRANSFORMS, Topic
from ambler.wire.mcap_file import McapRecorder

CAPACITY = 4096
_PATIENCE = 20.0
_PERIOD = 0.05  # one look at fifty messages takes less than five at ten: a thread that wakes finds its caches cold
_LOCKSTEP_PERIOD = 0.2  # nobody waits for a look: the longer the bunches, the less the run is disturbed
_Delivered = tuple[Topic[Any], Message, int, str]


class Recorder:
    """Writes each delivered message once, under its ROS name, at its time of delivery. `tell(code, text)` hears what goes wrong, from a
    thread of the recorder: the `note` of an executor's troubles.

    Raises BadInputError when the folder already holds a recording, OSError when it cannot be made.
    """

    def __init__(
        self,
        folder: Path,
        tell: Callable[[str, str], None] | None = None,
        *,
        is_lossy: bool = False,
        capacity: int = CAPACITY,
    ) -> None:
        self.failure: str | None = None
        self.drops: dict[str, int] = {}
        self._mcap = McapRecorder(folder)
        self._tell = tell
        self._tree: Message | None = None
        self._thinning = GridThinning()
        self._is_closed = False
        period = _PERIOD if is_lossy else _LOCKSTEP_PERIOD
        self._conveyor: Conveyor[_Delivered | None] = Conveyor(
            "recorder", self._write, capacity, self._fail, is_lossy=is_lossy, period=period
        )

    @property
    def folder(self) -> Path:
        """The folder of the recording."""
        return self._mcap.folder

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""
        return self._mcap.message_count

    def on_message(self, topic: Topic[Any], message: Message, time_ns: int, writer: str = "") -> None:
        """Take one message; `time_ns` is the executor's time of delivery, `writer` the node that published it."""
        if not topic.is_bulk and self._thinning.takes(topic, message, time_ns, writer):
            self._put((topic, message, time_ns, writer))

    def flush(self) -> None:
        """Wait until every message so far is written."""
        self._conveyor.flush()

    def _put(self, delivered: _Delivered) -> None:
        if self.failure is None and not self._conveyor.put(delivered):
            name = delivered[0].ros_name
            self.drops[name] = self.drops.get(name, 0) + 1

    def close(self) -> None:
        """Write what waits and finish the recording; calling it again does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        for grid in self._thinning.rest():
            self._put((grid.topic, grid.message, grid.time_ns, grid.writer))
        if not self._conveyor.close(_PATIENCE, None) and self.failure is None:
            self._fail(f"the disk did not take it within {_PATIENCE:.0f} s")
        if self.drops and self._tell is not None:
            lost = ", ".join(f"{count} of {name}" for name, count in sorted(self.drops.items()))
            self._tell("RECORDING_INCOMPLETE", f"the recording lacks messages that the disk was too slow for: {lost}")

    def _write(self, delivered: _Delivered | None) -> None:
        if delivered is None:
            self._mcap.close()
        elif self.failure is None:
            topic, message, time_ns, writer = delivered
            if topic == TRANSFORMS:
                message = self._tree = whole(self._tree, message)
            is_latched = topic.delivery == "latched"
            self._mcap.write(topic.ros_name, message, time_ns, is_latched=is_latched, writer=writer)

    def _fail(self, text: str) -> None:
        is_first = self.failure is None
        self.failure = self.failure or text
        if is_first and self._tell is not None:
            self._tell("RECORDING_FAILED", f"the recording {self.folder} ends here: {text}")
