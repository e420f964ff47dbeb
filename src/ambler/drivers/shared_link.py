"""A connection that several devices share: it is open while one of them is, has one thread that listens, and fails for all at once."""

from __future__ import annotations

import abc
import threading
from collections.abc import Callable

from ambler.core.devices import DeviceHealth, DeviceState
from ambler.core.errors import DeviceError
from ambler.drivers.device_clock import DeviceClock

ANSWER_TIMEOUT = 1.5
"""Seconds after which `open` gives up on an other end that does not say who it is."""
ASK_PERIOD = 0.1
SILENCE_MAX = 1.0
"""Seconds without anything valid after which the connection counts as broken."""
WAKE_PERIOD = 0.05


class LinkBrokenError(OSError):
    """The other end is gone: hung up, unplugged, closed."""


class SharedLink(abc.ABC):
    """The life of a connection, called `place` in every text. `now_ns` is the host's clock, the executor's. The thread calls `_turn`
    until it raises LinkBrokenError, nothing valid comes any more, or `failure` is set; `_lock` guards sending."""

    def __init__(self, place: str, now_ns: Callable[[], int]) -> None:
        self.place = place
        self.now_ns = now_ns
        self.failure = ""
        self.clock = self._new_clock()
        self.unsent = 0
        """What the connection did not take at once, and lost."""
        self._users: list[object] = []
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._answered = threading.Event()
        self._is_closing = False
        self._heard_ns = 0

    def open(self, user: object) -> None:
        """Connect for a device unless it is done; a broken connection is made anew. Raises DeviceError."""
        if self.failure or self._thread is None:
            self._hang_up()
            try:
                self._begin()
            except DeviceError as error:
                self.failure = str(error)
                self._hang_up()
                raise
        if user not in self._users:
            self._users.append(user)

    def close(self, user: object) -> None:
        """The device needs the connection no more; the last one closes it."""
        if user in self._users:
            self._users.remove(user)
        if not self._users:
            self._hang_up()
            self.failure = ""

    def is_open(self, user: object) -> bool:
        """Say whether this device is connected."""
        return user in self._users and self._thread is not None and not self.failure

    def health(self, user: object, messages: int, lost: int) -> DeviceHealth:
        """Return how the connection does for one of its devices."""
        if user not in self._users:
            return DeviceHealth(DeviceState.CLOSED)
        state = DeviceState.FAILED if self.failure else DeviceState.OPEN
        text, clock = self.failure or self.clock.text, self.clock
        return DeviceHealth(state, text, messages, lost + self.unsent, clock.jumps, clock.offset)

    def transmit(self, make: Callable[[], bytes]) -> None:
        """Send what `make` returns if the connection takes it, and count it otherwise. Never waits, never raises."""
        with self._lock:
            if self._thread is None or self.failure:
                return
            try:
                self.unsent += not self._write(make())
            except LinkBrokenError as error:
                self.failure = f"{self.place} broke: {error}"

    def _begin(self) -> None:
        self.failure, self.unsent, self.clock = "", 0, self._new_clock()
        self._answered.clear()
        self._is_closing = False
        self._connect()
        self._heard_ns = self.now_ns()
        self._thread = threading.Thread(target=self._listen, name=self.place, daemon=True)
        self._thread.start()
        for _ in range(round(ANSWER_TIMEOUT / ASK_PERIOD)):
            self._ask_who()
            if self._answered.wait(ASK_PERIOD) or self.failure:
                break
        if self.failure:
            raise DeviceError(self.failure)
        if not self._answered.is_set():
            raise DeviceError(f"nothing at {self.place} answers as {self._expected}")

    def _hang_up(self) -> None:
        if self._thread is None:
            return
        self._is_closing = True
        self._thread.join()
        with self._lock:
            self._thread = None
            self._disconnect()

    def _listen(self) -> None:
        while not self._is_closing and not self.failure:
            try:
                if self._turn():
                    self._heard_ns = self.now_ns()
            except LinkBrokenError as error:
                self.failure = f"{self.place} broke: {error}"
            except Exception as error:  # noqa: BLE001  (a thread that ended without a word would leave its devices open, and silent)
                self.failure = f"what came from {self.place} cannot be read: {error!r}"
            if self._answered.is_set() and self.now_ns() - self._heard_ns > SILENCE_MAX * 1e9:
                self.failure = self.failure or f"nothing valid came from {self.place} for {SILENCE_MAX:g} s"

    _expected = "expected"

    @abc.abstractmethod
    def _new_clock(self) -> DeviceClock:
        """Return the clock of an other end of which nothing is known."""

    @abc.abstractmethod
    def _connect(self) -> None:
        """Make the connection and forget the last one; raises DeviceError."""

    @abc.abstractmethod
    def _disconnect(self) -> None:
        """Give the connection back."""

    @abc.abstractmethod
    def _ask_who(self) -> None:
        """Ask the other end who it is; `_answered` is set when it has said so."""

    @abc.abstractmethod
    def _turn(self) -> bool:
        """Wait at most WAKE_PERIOD, take what came; returns whether anything valid did. Raises LinkBrokenError."""

    @abc.abstractmethod
    def _write(self, data: bytes) -> bool:
        """Hand bytes over without waiting; returns False when not all were taken. Raises LinkBrokenError."""
