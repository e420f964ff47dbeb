"""The host's end of the line to a base: one thread that reads, translates the base's clock and sorts frames to the devices that
share the line (a base and its battery). It is open while one of them is."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from ambler.core.devices import WATCHDOG_MAX, DeviceHealth, DeviceState
from ambler.core.errors import DeviceError
from ambler.drivers.device_clock import DeviceClock
from ambler.drivers.serial_frame import FAULT, INFO, VERSION, Frame, FrameKind, FrameReader, FrameWriter
from ambler.drivers.serial_line import LineBrokenError, SerialLine

ANSWER_TIMEOUT = 1.5
"""Seconds after which `open` gives up on a base that does not say who it is."""
ASK_PERIOD = 0.1
SILENCE_MAX = 1.0
"""Seconds without a valid frame after which the line counts as broken."""
_WAKE_PERIOD = 0.05

Receiver = Callable[[Frame, int], None]


class SerialLink:
    """A line at `path` with `baud`. `now_ns` is the host's clock, the executor's. A lock guards what the thread and the nodes share."""

    def __init__(self, path: Path, now_ns: Callable[[], int], baud: int) -> None:
        self.path = path
        self.now_ns = now_ns
        self._baud = baud
        self._receivers: dict[int, tuple[object, Receiver]] = {}
        self._users: list[object] = []
        self._line: SerialLine | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._answered = threading.Event()
        self._is_closing = False
        self._failure = ""
        self._reset()

    def _reset(self) -> None:
        self.clock = DeviceClock(tick_ns=1000, bits=32)
        self.reader = FrameReader()
        self._writer = FrameWriter()
        self._failure = ""
        self._unsent = 0
        self.robot_name, self.firmware, self.watchdog = "", "", WATCHDOG_MAX
        self._answered.clear()
        self._is_closing = False

    def receive(self, kind: FrameKind, user: object, receiver: Receiver) -> None:
        """From now on give frames of a kind to `receiver`, with the host's instant of their arrival, in the thread of the line."""
        self._receivers[kind] = (user, receiver)

    def open(self, user: object) -> None:
        """Open the line for a device unless it is open; a broken one is opened again. Raises DeviceError."""
        if self._failure:
            self._hang_up()
        if self._line is None:
            self._reset()
            try:
                self._begin()
            except DeviceError as error:
                self._failure = str(error)
                self._hang_up()
                raise
        if user not in self._users:
            self._users.append(user)

    def close(self, user: object) -> None:
        """The device needs the line no more; the last one closes it."""
        if user in self._users:
            self._users.remove(user)
        if not self._users:
            self._hang_up()

    def send(self, kind: FrameKind, payload: bytes = b"") -> None:
        """Send a frame if the line takes it; counts it otherwise. Never waits, never raises."""
        with self._lock:
            if self._line is None or self._failure:
                return
            try:
                if not self._line.write(self._writer.encode(kind, self.now_ns() // 1000, payload)):
                    self._unsent += 1
            except LineBrokenError as error:
                self._failure = f"{self.path} broke: {error.strerror or error}"

    def health(self, user: object, messages: int, dropped: int) -> DeviceHealth:
        """Return how the line does for one of its devices."""
        if user not in self._users:
            return DeviceHealth(DeviceState.CLOSED)
        state = DeviceState.FAILED if self._failure else DeviceState.OPEN
        lost = dropped + self.reader.lost + self._unsent
        return DeviceHealth(
            state, self._failure or self.clock.text, messages, lost, self.clock.jumps, self.clock.offset
        )

    def is_open(self, user: object) -> bool:
        """Say whether frames reach this device."""
        return user in self._users and self._line is not None and not self._failure

    def _begin(self) -> None:
        self._line = SerialLine(self.path, self._baud)
        self._thread = threading.Thread(target=self._listen, args=(self._line,), name=str(self.path), daemon=True)
        self._thread.start()
        for _ in range(round(ANSWER_TIMEOUT / ASK_PERIOD)):
            self.send(FrameKind.REQUEST_INFO)
            if self._answered.wait(ASK_PERIOD) or self._failure:
                break
        if self._failure:
            raise DeviceError(self._failure)
        if not self._answered.is_set():
            raise DeviceError(f"nothing at {self.path} answers as a base does ({self._baud} baud)")

    def _hang_up(self) -> None:
        self._is_closing = True
        if self._thread is not None:
            self._thread.join()
        with self._lock:
            if self._line is not None:
                self._line.close()
            self._line = self._thread = None

    def _listen(self, line: SerialLine) -> None:
        """The thread: until the line breaks, falls silent, or is closed."""
        last_ns = self.now_ns()
        while not self._is_closing and not self._failure:
            try:
                line.wait(_WAKE_PERIOD)
                frames = self.reader.feed(line.read())
            except LineBrokenError as error:
                self._failure = f"{self.path} broke: {error.strerror or error}"
                return
            now_ns = self.now_ns()
            for frame in frames:
                last_ns = now_ns
                self._take(frame, now_ns)
            if now_ns - last_ns > SILENCE_MAX * 1e9 and self._answered.is_set():
                self._failure = f"nothing valid came from {self.path} for {SILENCE_MAX:g} s"

    def _take(self, frame: Frame, arrival_ns: int) -> None:
        if frame.version != VERSION:
            self._failure = f"{self.path} speaks version {frame.version} of the frame, not {VERSION}"
            return
        if frame.kind == FrameKind.INFO and len(frame.payload) == INFO.size:
            self._introduce(frame.payload)
        elif frame.kind == FrameKind.FAULT and len(frame.payload) >= FAULT.size:
            code, text = FAULT.unpack_from(frame.payload)[0], frame.payload[FAULT.size :].decode(errors="replace")
            self._failure = f"the base reports fault {code}: {text}"
        elif self._answered.is_set():
            self.clock.observe(frame.sent_us, arrival_ns)
            user, receiver = self._receivers.get(frame.kind, (None, None))
            if receiver is not None and user in self._users:
                receiver(frame, arrival_ns)

    def _introduce(self, payload: bytes) -> None:
        watchdog_ms, name, firmware = INFO.unpack(payload)
        if not 0 < watchdog_ms <= 1000 * WATCHDOG_MAX:
            self._failure = (
                f"the watchdog of {self.path} is {watchdog_ms} ms; at most {1000 * WATCHDOG_MAX:.0f} ms are allowed"
            )
            return
        self.watchdog = watchdog_ms * 1e-3
        self.robot_name, self.firmware = (raw.rstrip(b"\x00").decode(errors="replace") for raw in (name, firmware))
        self._answered.set()
