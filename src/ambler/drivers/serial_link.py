"""The host's end of the line to a base: translates the base's clock and sorts frames to the devices that share the line (a base and
its battery)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ambler.core.devices import WATCHDOG_MAX
from ambler.drivers.device_clock import DeviceClock
from ambler.drivers.serial_frame import FAULT, INFO, VERSION, Frame, FrameKind, FrameReader, FrameWriter
from ambler.drivers.serial_line import SerialLine
from ambler.drivers.shared_link import WAKE_PERIOD, SharedLink

Receiver = Callable[[Frame, int], None]


class SerialLink(SharedLink):
    """A line at `path` with `baud`."""

    def __init__(self, path: Path, now_ns: Callable[[], int], baud: int) -> None:
        super().__init__(str(path), now_ns)
        self._path, self._baud = path, baud
        self._expected = f"a base does ({baud} baud)"
        self._receivers: dict[int, tuple[object, Receiver]] = {}
        self._forget()

    def receive(self, kind: FrameKind, user: object, receiver: Receiver) -> None:
        """From now on give frames of a kind to `receiver`, with the host's instant of their arrival, in the thread of the line."""
        self._receivers[kind] = (user, receiver)

    def send(self, kind: FrameKind, payload: bytes = b"") -> None:
        """Send a frame if the line takes it. Never waits, never raises."""
        self.transmit(lambda: self._writer.encode(kind, self.now_ns() // 1000, payload))

    def _forget(self) -> None:
        self.reader, self._writer = FrameReader(), FrameWriter()
        self.robot_name, self.firmware, self.watchdog = "", "", WATCHDOG_MAX

    def _new_clock(self) -> DeviceClock:
        return DeviceClock(tick_ns=1000, bits=32)

    def _connect(self) -> None:
        self._forget()
        self._line = SerialLine(self._path, self._baud)

    def _disconnect(self) -> None:
        self._line.close()

    def _ask_who(self) -> None:
        self.send(FrameKind.REQUEST_INFO)

    def _write(self, data: bytes) -> bool:
        return self._line.write(data)

    def _turn(self) -> bool:
        self._line.wait(WAKE_PERIOD)
        frames = self.reader.feed(self._line.read())
        arrival_ns = self.now_ns()
        for frame in frames:
            self._take(frame, arrival_ns)
        return bool(frames)

    def _take(self, frame: Frame, arrival_ns: int) -> None:
        if frame.version != VERSION:
            self.failure = f"{self.place} speaks version {frame.version} of the frame, not {VERSION}"
        elif frame.kind == FrameKind.INFO and len(frame.payload) == INFO.size:
            self._introduce(frame.payload)
        elif frame.kind == FrameKind.FAULT and len(frame.payload) >= FAULT.size:
            code, text = FAULT.unpack_from(frame.payload)[0], frame.payload[FAULT.size :].decode(errors="replace")
            self.failure = f"the base reports fault {code}: {text}"
        elif self._answered.is_set():
            self.clock.observe(frame.sent_us, arrival_ns)
            user, receiver = self._receivers.get(frame.kind, (None, None))
            if receiver is not None and user in self._users:
                receiver(frame, arrival_ns)

    def _introduce(self, payload: bytes) -> None:
        watchdog_ms, name, firmware = INFO.unpack(payload)
        most_ms = round(1000 * WATCHDOG_MAX)
        if not 0 < watchdog_ms <= most_ms:
            self.failure = f"the watchdog of {self.place} is {watchdog_ms} ms; at most {most_ms} ms are allowed"
            return
        self.watchdog = watchdog_ms * 1e-3
        self.robot_name, self.firmware = (raw.rstrip(b"\x00").decode(errors="replace") for raw in (name, firmware))
        self._answered.set()
